//! Correspondences of a window → a motion path for each frame.
