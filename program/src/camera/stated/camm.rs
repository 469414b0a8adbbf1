// SPDX-License-Identifier: MIT OR Apache-2.0

//! Camera motion metadata (developers.google.com/streetview/publish/camm-spec): samples of the format `camm`.

use super::statement::{Stated, StatedReadout};
use crate::boxes::array;

/// Packets among which one about a frame is looked for: gyroscopes write some hundred a second.
pub const MOST: usize = 512;
/// Bytes of a packet that are read.
pub const LENGTH: u64 = 12;
/// The type of a packet about a frame: the exposure time of a pixel, and the time from the first row to the last, in nanoseconds.
const FRAME: u16 = 1;

/// What a packet states.
pub fn by_packet(packet: &[u8]) -> Option<Stated> {
    let kind = u16::from_le_bytes(array(packet, 2)?);
    let skew = i32::from_le_bytes(array(packet, 8)?);
    if kind != FRAME {
        return None;
    }
    let readout = StatedReadout::new(f64::from(skew) * 1e-6, "CAMM rolling_shutter_skew_time")?;
    Some(Stated { readout: Some(readout), ..Stated::default() })
}

#[cfg(test)]
pub mod tests {
    use super::*;

    pub fn packet(kind: u16, words: &[i32]) -> Vec<u8> {
        let words = words.iter().flat_map(|word| word.to_le_bytes());
        [0, 0].into_iter().chain(kind.to_le_bytes()).chain(words).collect()
    }

    #[test]
    fn the_packet_of_a_frame_states_its_skew() {
        let stated = by_packet(&packet(1, &[1_000_000, 16_600_000])).unwrap();
        assert!((stated.readout.unwrap().milliseconds - 16.6).abs() < 1e-9);
        for other in [packet(2, &[0, 0, 0]), packet(1, &[0, -5]), packet(1, &[0]), Vec::new()] {
            assert_eq!(by_packet(&other), None);
        }
    }
}
