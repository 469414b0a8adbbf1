// SPDX-License-Identifier: MIT OR Apache-2.0

//! How far an estimate of the readout is from the truth.

use nalgebra::Vector2;
use rsrectify::readout::Readout;

/// The signed readout ratio γ = T / frame period (seconds): negative where the readout runs from the
/// bottom or from the right.
pub fn signed_ratio(readout: &Readout, period: f64) -> f64 {
    let ratio = readout.time() / period;
    if readout.direction().is_reversed() { -ratio } else { ratio }
}

/// The distance of two readouts in frame periods: |γ − γ′| with signed γ where both read rows, or
/// both columns.
///
/// Otherwise √(γ² + γ′²): the readout is a time that grows across the picture, a vector along the
/// axis read. So a global shutter (γ = 0) has no axis to be mistaken.
pub fn error(estimate: &Readout, truth: &Readout, period: f64) -> f64 {
    (gradient(estimate, period) - gradient(truth, period)).norm()
}

/// The growth of exposure time over the frame's width and over its height, in frame periods.
fn gradient(readout: &Readout, period: f64) -> Vector2<f64> {
    let ratio = signed_ratio(readout, period);
    if readout.direction().is_by_rows() { Vector2::new(0.0, ratio) } else { Vector2::new(ratio, 0.0) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rsrectify::readout::{ReadoutDirection, ReadoutTime};

    const PERIOD: f64 = 0.04;

    fn readout(direction: ReadoutDirection, ratio: f64) -> Readout {
        Readout::new(640, 480, direction, ReadoutTime::Seconds(ratio * PERIOD), PERIOD).unwrap()
    }

    #[test]
    fn worked_by_hand() {
        use ReadoutDirection::{BottomToTop, LeftToRight, RightToLeft, TopToBottom};
        for ((first, a), (second, b), expected) in [
            ((TopToBottom, 0.42), (TopToBottom, 0.5), 0.08),
            ((TopToBottom, 0.3), (BottomToTop, 0.2), 0.5),
            ((RightToLeft, 1.0), (LeftToRight, 1.0), 2.0),
            ((TopToBottom, 0.6), (RightToLeft, 0.8), 1.0),
            ((LeftToRight, 0.0), (BottomToTop, 0.85), 0.85),
        ] {
            let found = error(&readout(first, a), &readout(second, b), PERIOD);
            assert!((found - expected).abs() < 1e-12, "{first:?} {a}, {second:?} {b}: {found}");
        }
        assert!((signed_ratio(&readout(BottomToTop, 0.85), PERIOD) + 0.85).abs() < 1e-12);
    }
}
