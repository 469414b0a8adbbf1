//! The smoothed path at one frame: a local line through the paths of the frames around it.

use super::logarithm::Coordinates;

/// Half the support of the kernel in standard deviations: (1 − u²)² on −1 … 1 has the variance 1/7.
pub const SUPPORT: f64 = 2.645_751_311_064_590_7;

/// The pose of a frame, seen from another.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// Seconds after that frame.
    pub time: f64,
    /// Sum of the motions of the scene from that frame to this one.
    pub path: Coordinates,
}

/// Share of the local line's slope that is believed, where frames lie on one side only: with all of it a shake at the last
/// frames is continued, with none of it a pan is followed late.
const SLOPE: f64 = 0.5;

/// The smoothed path at time 0 from the poses of frames around, with the standard deviation `deviation` in seconds; where the
/// frame itself stands at 0.
///
/// It is the weighted least-squares line at 0; where the poses lie on both sides alike, it is their weighted mean.
pub fn smoothed(poses: &[Pose], deviation: f64) -> Coordinates {
    let half = SUPPORT * deviation;
    let [mut m0, mut m1, mut m2] = [0.0; 3];
    let [mut p0, mut p1] = [Coordinates::zeros(); 2];
    for Pose { time, path } in poses {
        let u = time / half;
        // No for NaN, of a width of 0.
        if u.abs() < 1.0 {
            let weight = (1.0 - u * u) * (1.0 - u * u);
            m0 += weight;
            m1 += weight * u;
            m2 += weight * u * u;
            p0 += path * weight;
            p1 += path * (weight * u);
        }
    }
    if m0 == 0.0 {
        return Coordinates::zeros();
    }
    let (mean, middle) = (p0 / m0, m1 / m0);
    let spread = m2 - m1 * middle;
    if spread <= f64::EPSILON {
        return mean;
    }
    let slope = (p1 - mean * m1) / spread;
    mean - slope * (middle * SLOPE)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn poses(times: impl Iterator<Item = i32>, path: impl Fn(f64) -> f64) -> Vec<Pose> {
        let pose = |k: i32| {
            let time = f64::from(k) / 30.0;
            Pose { time, path: Coordinates::repeat(path(time)) }
        };
        times.map(pose).collect()
    }

    #[test]
    fn the_deviation_is_that_of_the_weights() {
        // The smoothed square of time is the variance.
        let found = smoothed(&poses(-60..=60, |t| t * t), 0.4)[0];
        assert!((found - 0.16).abs() < 1e-3, "{found}");
    }

    #[test]
    fn a_steady_pan_is_followed_exactly() {
        let found = smoothed(&poses(-60..=60, |t| 5.0 * t), 0.4)[0];
        assert!(found.abs() < 1e-12, "{found}");
    }

    #[test]
    fn shake_is_smoothed_away() {
        let found = smoothed(&poses(-60..=60, |t| (18.0 * t).cos()), 0.4)[0];
        assert!(found.abs() < 0.01, "{found}");
    }

    #[test]
    fn without_width_or_neighbours_the_frame_stays() {
        for (poses, deviation) in [(poses(-9..=9, |t| t + t * t), 0.0), (Vec::new(), 0.4)] {
            assert_eq!(smoothed(&poses, deviation), Coordinates::zeros());
        }
    }
}
