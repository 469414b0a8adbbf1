// SPDX-License-Identifier: MIT OR Apache-2.0

//! Colours in the headers of ProRes frames (SMPTE RDD 36): the encoder leaves them open.

use crate::colour::Colour;

/// Where the name of a frame is, and its three code points, behind its size and half of its header.
const NAME: std::ops::Range<usize> = 4..8;
const COLOURS: std::ops::Range<usize> = 22..25;

/// A frame that states colours; `None` of what is no frame.
pub fn stated(frame: &[u8], colour: Colour) -> Option<Vec<u8>> {
    if frame.get(NAME)? != b"icpf" {
        return None;
    }
    let mut frame = frame.to_vec();
    frame.get_mut(COLOURS)?.copy_from_slice(&[colour.primaries, colour.transfer, colour.matrix]);
    Some(frame)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_state_colours_and_nothing_else_is_changed() {
        let mut frame = vec![7; 40];
        frame[NAME].copy_from_slice(b"icpf");
        let colour = Colour { primaries: 9, transfer: 18, matrix: 9, full_range: None };
        let stated = super::stated(&frame, colour).unwrap();
        assert_eq!(stated[COLOURS], [9, 18, 9]);
        assert_eq!((&stated[..22], &stated[25..]), (&frame[..22], &frame[25..]));
        assert_eq!(super::stated(&frame[..24], colour), None);
        assert_eq!(super::stated(&[7; 40], colour), None);
    }
}
