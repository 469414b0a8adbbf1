// SPDX-License-Identifier: MIT OR Apache-2.0

//! Judges the rectifier, on sequences that `render` makes and on recorded clips, beside the methods in `baselines`.
//!
//! Apart from the library, because a user of that needs none of it: a tool for those who change it.
//!
//! | module | what it holds |
//! |---|---|
//! | [`systems`] | the library under test, and the systems it is compared with |
//! | [`metrics`] | how far a rectified frame is from the truth |
//! | [`report`] | runs everything and writes tables, charts and stills |
//! | [`dense`] | how far the library's dense flow is from the exact one |
//! | [`readout`] | how well the library finds the readout from the picture alone |
//! | [`blind`], [`recorded`] | how often it finds a wrong one |
//! | [`shutter`] | what a user says of a camera's shutter |
//! | [`effort`] | what each effort leaves and takes |
//! | [`two_frames`] | what is left where there are only two frames |
//! | [`pairs`] | two-frame clips with a global-shutter truth, as data sets have them |
//! | [`clip`] | a real clip without truth |
//! | [`steady`] | how steady the library makes a picture, beside vid.stab |
//! | [`speed`] | how long the library takes for a frame |

pub mod blind;
pub mod clip;
pub mod dense;
pub mod effort;
pub mod metrics;
pub mod pairs;
pub mod readout;
pub mod recorded;
pub mod report;
pub mod shutter;
pub mod speed;
pub mod steady;
pub mod systems;
pub mod two_frames;
