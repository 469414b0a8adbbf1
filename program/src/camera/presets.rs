// SPDX-License-Identifier: MIT OR Apache-2.0

//! Presets of the element: what is expected of known cameras, as GStreamer reads it.

use super::catalogue::Camera;
use crate::property_values::{Direction, name_of};
use std::fmt;

/// All cameras as a file of presets.
pub struct Presets<'a>(pub &'a [Camera]);

impl fmt::Display for Presets<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "# Readouts of known cameras, as what is expected, not ordered: written by `rsrectify cameras --presets`."
        )?;
        writeln!(f, "# The source of each one is in its comment.")?;
        writeln!(f, "[_presets_]\nelement-name=GstRsRectify\nversion={}", env!("CARGO_PKG_VERSION"))?;
        for camera in self.0 {
            for mode in &camera.modes {
                let nanoseconds = |milliseconds: f64| (milliseconds * 1e6).round();
                writeln!(f, "\n[{} {}]", camera.name(), mode.name())?;
                writeln!(f, "_meta/comment={}", mode.source())?;
                writeln!(f, "expected-readout-time={}", nanoseconds(mode.milliseconds()))?;
                writeln!(f, "expected-readout-deviation={}", nanoseconds(mode.deviation()))?;
                writeln!(f, "expected-readout-direction={}", name_of(&Direction::from(mode.direction())))?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_in_the_repository_is_what_the_tables_say() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../gst-plugin/presets/GstRsRectify.prs");
        // A package of this crate alone has no such file.
        let Ok(file) = std::fs::read_to_string(file) else { return };
        let cameras = super::super::catalogue::cameras().unwrap();
        assert_eq!(file, Presets(&cameras).to_string(), "scripts/presets writes it anew");
    }
}
