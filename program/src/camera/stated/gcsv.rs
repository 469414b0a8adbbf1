// SPDX-License-Identifier: MIT OR Apache-2.0

//! A gyroscope's log beside a clip, in Gyroflow's format (docs.gyroflow.xyz, "GCSV Format"): `clip.gcsv` of `clip.mp4`.

use super::statement::{Stated, StatedReadout, text};
use rsrectify::readout::ReadoutDirection;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// The header is shorter.
const LARGEST_HEADER: u64 = 16 << 10;

/// What a log beside a clip states.
pub fn beside(clip: &Path) -> Option<Stated> {
    let mut log =
        ["gcsv", "GCSV"].into_iter().find_map(|ending| File::open(clip.with_extension(ending)).ok())?;
    let mut header = Vec::new();
    log.by_ref().take(LARGEST_HEADER).read_to_end(&mut header).ok()?;
    by_header(&String::from_utf8_lossy(&header))
}

fn by_header(log: &str) -> Option<Stated> {
    let mut lines = log.lines();
    if !["GYROFLOW IMU LOG", "CAMERA IMU LOG"].contains(&lines.next()?.trim()) {
        return None;
    }
    let pairs = lines.map_while(|line| {
        // The names of the columns end the header.
        if line.starts_with("t,") { None } else { line.split_once(',') }
    });
    let pairs: Vec<(&str, &str)> = pairs.map(|(name, value)| (name.trim(), value.trim())).collect();
    let get = |wanted: &str| pairs.iter().find(|(name, _)| *name == wanted).map(|(_, value)| *value);
    // What `rsrectify track` has found in the picture would count twice.
    if get("vendor") == Some("rsrectify") {
        return None;
    }
    let readout =
        StatedReadout::entered(get("frame_readout_time")?.parse().ok()?, "GCSV frame_readout_time")?;
    let direction = match get("frame_readout_direction") {
        Some("0") => Some(ReadoutDirection::TopToBottom),
        Some("1") => Some(ReadoutDirection::BottomToTop),
        Some("2") => Some(ReadoutDirection::LeftToRight),
        Some("3") => Some(ReadoutDirection::RightToLeft),
        _ => None,
    };
    let maker = get("vendor").and_then(|vendor| text(vendor.as_bytes()));
    Some(Stated { maker, readout: Some(StatedReadout { direction, ..readout }), ..Stated::default() })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example of the format's documentation.
    const LOG: &str = "GYROFLOW IMU LOG\nversion,1.3\nid,custom_logger_name\norientation,YxZ\nvendor,potatocam\n\
        lens_info,wide\nframe_readout_time,15.23\nframe_readout_direction,1\ntscale,0.001\nt,gx,gy,gz\n0,39,86,183\n";

    #[test]
    fn the_header_of_a_log_is_read() {
        let readout = by_header(LOG).unwrap().readout.unwrap();
        assert_eq!((readout.milliseconds, readout.direction), (15.23, Some(ReadoutDirection::BottomToTop)));
        assert!(by_header(&LOG.replace('\n', "\r\n")).is_some());
        // Not a log, none stated, a number that is none.
        for other in ["", "a,b", &LOG.replace("frame_readout_time", "x"), &LOG.replace("15.23", "fast")] {
            assert_eq!(by_header(other), None);
        }
    }

    #[test]
    fn a_log_by_this_program_is_no_evidence() {
        assert_eq!(by_header(&LOG.replace("potatocam", "rsrectify")), None);
    }
}
