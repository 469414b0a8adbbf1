//! Renders rolling-shutter sequences with exact truth and judges the rectifier on them.
//!
//! | module | what it holds |
//! |---|---|
//! | [`scene`] | what a camera sees; knows nothing of the library under test |
//! | [`sequence`] | named sequences and their settings |
//! | [`truth`] | where each pixel belongs, and where it is seen next |
//! | [`metrics`] | how far a rectified frame is from the truth |
//! | [`product`] | the library under test, called as any program would |
//! | [`speed`] | how long the library takes for a frame |
//! | [`video`] | frames to files |

pub mod metrics;
pub mod product;
pub mod scene;
pub mod sequence;
pub mod speed;
pub mod truth;
pub mod video;
