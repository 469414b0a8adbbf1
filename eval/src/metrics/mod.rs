// SPDX-License-Identifier: MIT OR Apache-2.0

//! How far a rectified frame is from the truth, and how a clip without truth fares.
//!
//! | needs | module | what it measures |
//! |---|---|---|
//! | displacement truth | [`displacement`] | pixels left |
//! | displacement truth | [`floor`] | pixels that a model must leave |
//! | displacement truth | [`ripple`] | what is applied beside a smooth change from line to line |
//! | no displacement at all | [`harm`] | pixels added |
//! | a global frame | [`colour`] | the paper's colour distance, PSNR, SSIM |
//! | the true shutter | [`readout`] | error of the readout ratio |
//! | nothing | [`wobble`] | what depends on the row between successive frames |
//! | nothing | [`jitter`] | unsteadiness of the correction, and of the content |
//!
//! [`resample`] makes the rectified picture; [`homography`] is what [`wobble`] takes away.

pub mod colour;
pub mod displacement;
pub mod floor;
pub mod harm;
pub mod homography;
pub mod jitter;
pub mod readout;
pub mod resample;
pub mod ripple;
pub mod wobble;
