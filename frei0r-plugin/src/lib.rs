// SPDX-License-Identifier: MIT OR Apache-2.0

//! The frei0r filter "Rolling shutter rectifier", for editors and ffmpeg.
//!
//! A frei0r filter is given one frame and must return one: it cannot look ahead. So it applies the motion that `rsrectify track
//! --motion` has found, which is read from a file by the frame's time.
//!
//! | module | |
//! |---|---|
//! | `abi` | the C interface, version 1.2: the only unsafe code |
//! | `parameters` | the filter's parameters, named as the properties of the GStreamer element |
//! | `clock` | the host's time → the clip's |
//! | `filter` | one filter in a host: a frame and its time → the rectified frame |

mod abi;
mod clock;
mod filter;
mod parameters;

pub use filter::Filter;
pub use parameters::{Kind, PARAMETERS, Parameter};
