// SPDX-License-Identifier: MIT OR Apache-2.0

//! The VapourSynth filter `rsrectify.Apply`: a clip and its motion file → the rectified clip.
//!
//! | module | |
//! |---|---|
//! | `filter` | what VapourSynth calls: arguments, requests of frames |
//! | `frames` | one frame: which motion it has, its planes rectified; the only unsafe code of ours |

mod filter;
mod frames;

use filter::Apply;
use vapoursynth4_rs::declare_plugin;

declare_plugin!(
    c"rsrectify.apply",
    c"rsrectify",
    c"Takes rolling-shutter distortion out of clips, by a motion file",
    (0, 1),
    vapoursynth4_rs::VAPOURSYNTH_API_VERSION,
    0,
    (Apply, None)
);
