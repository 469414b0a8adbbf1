// SPDX-License-Identifier: MIT OR Apache-2.0

//! Renders rolling-shutter sequences with exact truth and judges the rectifier on them.
//!
//! | module | what it holds |
//! |---|---|
//! | [`scene`] | what a camera sees; knows nothing of the library under test |
//! | [`sequence`] | named sequences and their settings |
//! | [`truth`] | where each pixel belongs, and where it is seen next |
//! | [`footage`] | a sequence in memory: frames, timestamps, truth |
//! | [`cache`] | footage kept on disk |
//! | [`correspondences`] | where the correspondences come from that every method is given |
//! | [`dense`] | how far the library's dense flow is from the exact one |
//! | [`flow`] | dense optical flow, one of the sources |
//! | [`methods`] | the systems that are compared, among them the library under test |
//! | [`metrics`] | how far a rectified frame is from the truth |
//! | [`report`] | runs everything and writes tables, charts and stills |
//! | [`readout`] | how well the library finds the readout from the picture alone |
//! | [`shutter`] | what a user says of a camera's shutter |
//! | [`effort`] | what each effort leaves and takes |
//! | [`pairs`] | two-frame clips with a global-shutter truth, as data sets have them |
//! | [`clip`] | a real clip without truth |
//! | [`steady`] | how steady the library makes a picture, beside vid.stab |
//! | [`speed`] | how long the library takes for a frame |
//! | [`video`] | frames to files |
//! | [`media`] | coded video: any clip to frames, frames through H.264 |

pub mod blind;
pub mod cache;
pub mod clip;
pub mod correspondences;
pub mod dense;
pub mod effort;
pub mod flow;
pub mod footage;
pub mod media;
pub mod methods;
pub mod metrics;
pub mod pairs;
pub mod readout;
pub mod recorded;
pub mod report;
pub mod scene;
pub mod sequence;
pub mod shutter;
pub mod speed;
pub mod steady;
pub mod truth;
pub mod two_frames;
pub mod video;
