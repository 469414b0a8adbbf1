// SPDX-License-Identifier: MIT OR Apache-2.0

//! Renders rolling-shutter sequences with exact truth.
//!
//! Apart from `eval`, which judges by it, because tests of the element and scripts need rendered video and nothing else: this
//! builds without metrics, reports and the methods of others.
//!
//! | module | what it holds |
//! |---|---|
//! | [`scene`] | what a camera sees; knows nothing of the library under test |
//! | [`sequence`] | named sequences and their settings |
//! | [`truth`] | where each pixel belongs, and where it is seen next |
//! | [`stats`] | displacement over a set of samples |
//! | [`footage`] | a sequence in memory: frames, timestamps, truth |
//! | [`cache`] | footage kept on disk |
//! | [`video`] | frames to files |
//! | [`media`] | coded video: any clip to frames, frames through H.264 |
//! | [`changes`] | what a command line may change of a sequence |

pub mod cache;
pub mod changes;
pub mod footage;
pub mod media;
pub mod scene;
pub mod sequence;
pub mod stats;
pub mod truth;
pub mod video;
