// SPDX-License-Identifier: MIT OR Apache-2.0

//! The tests of the element, as one program: each more would be linked with all of GStreamer again.

mod buffers;
mod camera;
mod clip;
#[path = "../common/mod.rs"]
mod common;
mod editing;
mod examples;
mod formats;
mod hostile;
mod inserting;
mod latency;
mod layout;
mod padded;
mod phone;
mod pixels;
mod presets;
mod promises;
mod stream;
