//! What is measured: the correspondences of the pairs of frames in a window.

pub mod dominant;
pub mod matches;
pub mod overlay;
pub mod pair;
pub mod window;
