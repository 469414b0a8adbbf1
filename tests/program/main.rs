// SPDX-License-Identifier: MIT OR Apache-2.0

//! The tests of the program `rsrectify`, as one program: each more would be linked with all of GStreamer again.

mod batch;
mod camera;
mod codec;
#[path = "../common/mod.rs"]
mod common;
mod content;
mod fix;
mod images;
mod kept;
mod measure;
mod motion;
mod parts;
mod picture;
mod pipes;
mod plot;
mod real;
mod shared;
mod show;
mod streams;
mod track;
mod zoo;
