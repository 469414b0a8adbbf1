//! How much a frame must be enlarged so that its borders stay out of sight.

use super::correction::Correction;
use super::settings::WarpSettings;
use crate::motion::FrameMotion;

/// Points along each edge: as many as the warp's map has nodes along the readout, and more than a residual field has cells.
const POINTS: usize = 256;

/// The least zoom with which no border of the frame is seen when it is rectified by this motion with these settings, whose
/// own zoom does not count; at least 1, and infinite where a border crosses the picture's centre.
///
/// The outermost pixels that the interpolation needs beside the one shown count as border.
#[must_use]
pub fn least_zoom(motion: &FrameMotion, settings: &WarpSettings) -> f64 {
    let settings = WarpSettings { zoom: 1.0, ..*settings };
    if motion.is_still() || settings.strength <= 0.0 {
        return 1.0;
    }
    let taps = settings.interpolation.taps() as f64 / 2.0;
    let correction = Correction::new(motion, &settings);
    let half = correction.centre;
    let seen = half.map(|half| (half - taps).max(0.0));
    let along = |index: usize| 2.0 * index as f64 / POINTS as f64 - 1.0;
    let mut zoom: f64 = 1.0;
    for axis in [0, 1] {
        for end in [-1.0, 1.0] {
            for index in 0..=POINTS {
                let mut point = seen;
                point[axis] *= end;
                point[1 - axis] *= along(index);
                let shown = point + correction.displacement(&correction.interval_at(point), point);
                let inwards = end * shown[axis];
                let needed = if half[axis] > 0.0 { half[axis] / inwards } else { 1.0 };
                zoom = zoom.max(if inwards > 0.0 { needed } else { f64::INFINITY });
            }
        }
    }
    zoom
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::MotionPath;
    use crate::readout::Readout;
    use crate::warp::Interpolation;
    use nalgebra::Matrix3;

    #[test]
    fn a_shift_is_hidden_by_as_much_on_both_sides() {
        let motion = FrameMotion::new(Readout::global_shutter(641, 481), MotionPath::STILL);
        let settings = WarpSettings { interpolation: Interpolation::Linear, ..WarpSettings::default() };
        assert_eq!(least_zoom(&motion, &settings), 1.0);
        let shift = Matrix3::new(1.0, 0.0, 19.0, 0.0, 1.0, -4.0, 0.0, 0.0, 1.0);
        let motion = motion.with_placement(Some(shift));
        // 19 px and the row beside: 20 of 320.
        assert!((least_zoom(&motion, &settings) - 320.0 / 300.0).abs() < 1e-9);
        let half = WarpSettings { strength: 0.5, ..settings };
        assert!((least_zoom(&motion, &half) - 320.0 / 309.5).abs() < 1e-9);
        let far = Matrix3::new(1.0, 0.0, 400.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
        assert_eq!(least_zoom(&motion.with_placement(Some(far)), &settings), f64::INFINITY);
    }
}
