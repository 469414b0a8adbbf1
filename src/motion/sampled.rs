// SPDX-License-Identifier: MIT OR Apache-2.0

//! A global motion path given by sampled homographies.

use super::Twist;
use nalgebra::{Matrix3, Vector2};
use thiserror::Error;

/// Steps by which a path of another form is sampled.
pub(crate) const PATH_STEPS: usize = 32;

/// The motion of the whole picture through one readout, by homographies at equal steps of the
/// elapsed share.
///
/// Between samples the elements of the homographies are interpolated by Hermite cubics whose slopes
/// are differences of fourth order over five samples. With h the phase from one sample to the next, the
/// error for an oscillation of amplitude A is A·(h⁴/384 + 0.1·h⁵/30), in the first and last two steps
/// A·(h⁴/384 + 0.15·h⁵/5): for 2.5 cycles a readout and 32 steps, 2.4·10⁻⁴ and 10⁻³ of A. Outside the
/// readout the path is extrapolated with its velocity at the end.
#[derive(Clone, Debug, PartialEq)]
pub struct SampledPath {
    /// At share i/N, scaled so that the last element is 1.
    motions: Vec<Matrix3<f64>>,
    /// Derivatives at the samples, per sample step.
    slopes: Vec<Matrix3<f64>>,
    readout_time: f64,
}

/// Why samples are not a valid path.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum PathError {
    /// Fewer than five samples.
    #[error("a path takes at least five samples, not {0}")]
    TooFew(usize),
    /// A homography that is singular, mirrors the picture, maps its centre to infinity, or has an element
    /// that is not finite.
    #[error("sample {0} of the path cannot be undone")]
    Singular(usize),
    /// A readout time that is negative or not finite.
    #[error("the readout time must be finite and not negative")]
    ReadoutTime,
}

/// Least determinant of a homography whose last element is 1; a magnification by z has z².
const MIN_DETERMINANT: f64 = 1e-4;

impl SampledPath {
    /// A path from homographies at the shares 0, 1/N, …, 1 of a readout of `readout_time` seconds.
    ///
    /// Each maps the points (centred pixels) exposed at its share to their positions at one common
    /// instant; the scale of each homography is arbitrary.
    pub fn new(homographies: &[Matrix3<f64>], readout_time: f64) -> Result<Self, PathError> {
        if homographies.len() < 5 {
            return Err(PathError::TooFew(homographies.len()));
        }
        if !(readout_time.is_finite() && readout_time >= 0.0) {
            return Err(PathError::ReadoutTime);
        }
        let scaled = |(index, motion)| normalised(motion).ok_or(PathError::Singular(index));
        let motions = homographies.iter().enumerate().map(scaled).collect::<Result<Vec<_>, _>>()?;
        let slopes = (0..motions.len()).map(|index| slope(&motions, index)).collect();
        Ok(Self { motions, slopes, readout_time })
    }

    /// The homographies at the samples, scaled so that the last element is 1.
    pub(super) fn motions(&self) -> &[Matrix3<f64>] {
        &self.motions
    }

    /// Readout time in seconds.
    pub(super) fn readout_time(&self) -> f64 {
        self.readout_time
    }

    /// The same path in pixels that are smaller by these factors along x and y.
    pub(super) fn scaled(&self, factors: [f64; 2]) -> Self {
        let all = |motions: &[Matrix3<f64>]| motions.iter().map(|motion| scaled(motion, factors)).collect();
        Self { motions: all(&self.motions), slopes: all(&self.slopes), readout_time: self.readout_time }
    }

    /// The same path in a frame turned clockwise by a quarter.
    pub(super) fn turned(&self) -> Self {
        let all = |motions: &[Matrix3<f64>]| motions.iter().map(turned).collect();
        Self { motions: all(&self.motions), slopes: all(&self.slopes), readout_time: self.readout_time }
    }

    /// The homography that maps points exposed at `share` to the common instant.
    fn at(&self, share: f64) -> Matrix3<f64> {
        let steps = self.motions.len() - 1;
        let at = share * steps as f64;
        let inside = at.clamp(0.0, steps as f64);
        // NaN becomes 0 here.
        let node = (inside as usize).min(steps - 1);
        let t = inside - node as f64;
        let u = 1.0 - t;
        let (from, to) = (&self.motions[node], &self.motions[node + 1]);
        let (start, end) = (&self.slopes[node], &self.slopes[node + 1]);
        let curve = from * (u * u * (1.0 + 2.0 * t)) + to * (t * t * (3.0 - 2.0 * t));
        let curve = curve + start * (t * u * u) - end * (t * t * u);
        match at - inside {
            0.0 => curve,
            before if before < 0.0 => curve + start * before,
            after => curve + end * after,
        }
    }

    /// H(to)⁻¹·H(from): maps points at share `from` to their positions at share `to`. The identity
    /// where an interpolated homography is singular.
    pub(super) fn between(&self, from: f64, to: f64) -> Matrix3<f64> {
        let back = self.at(to).try_inverse();
        let motion = back.and_then(|back| normalised(&(back * self.at(from))));
        motion.unwrap_or_else(Matrix3::identity)
    }

    /// Whether no point moves during the readout.
    pub(super) fn is_still(&self) -> bool {
        self.readout_time == 0.0 || self.motions.windows(2).all(|pair| pair[0] == pair[1])
    }

    /// The twist with the same rotation and shift of the image centre over the readout as the path.
    pub(super) fn mean_twist(&self) -> Twist {
        if self.readout_time == 0.0 {
            return Twist::ZERO;
        }
        let motion = self.between(0.0, 1.0);
        let shift = Vector2::new(motion[(0, 2)], motion[(1, 2)]);
        // The derivative of the projection at the centre, where w = 1; its nearest rotation.
        let slope = |i: usize, j: usize| motion[(i, j)] - shift[i] * motion[(2, j)];
        let angle = (slope(1, 0) - slope(0, 1)).atan2(slope(0, 0) + slope(1, 1));
        Twist::between(angle, shift, self.readout_time)
    }
}

/// A homography in units that are smaller by the factors x and y: S·H·S⁻¹ with S = diag(x, y, 1), linear in H.
pub(crate) fn scaled(motion: &Matrix3<f64>, [x, y]: [f64; 2]) -> Matrix3<f64> {
    let factors = [x, y, 1.0];
    Matrix3::from_fn(|row, column| motion[(row, column)] * factors[row] / factors[column])
}

/// R·H·R⁻¹ with R: (x, y) → (−y, x), linear in H.
pub(super) fn turned(motion: &Matrix3<f64>) -> Matrix3<f64> {
    let turn = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    turn * motion * turn.transpose()
}

/// The homography scaled so that its last element is 1; `None` if it is invalid: see [`PathError::Singular`].
pub(super) fn normalised(motion: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let scaled = motion / motion[(2, 2)];
    let is_valid = scaled.iter().all(|element| element.is_finite()) && scaled.determinant() > MIN_DETERMINANT;
    is_valid.then_some(scaled)
}

/// The fourth-order derivative at one of at least five samples: from the two samples on either
/// side, at the ends from the nearest five.
fn slope(motions: &[Matrix3<f64>], index: usize) -> Matrix3<f64> {
    const WEIGHTS: [[f64; 5]; 5] = [
        [-25.0, 48.0, -36.0, 16.0, -3.0],
        [-3.0, -10.0, 18.0, -6.0, 1.0],
        [1.0, -8.0, 0.0, 8.0, -1.0],
        [-1.0, 6.0, -18.0, 10.0, 3.0],
        [3.0, -16.0, 36.0, -48.0, 25.0],
    ];
    let first = index.saturating_sub(2).min(motions.len() - 5);
    let terms = WEIGHTS[index - first].iter().zip(&motions[first..]);
    terms.fold(Matrix3::zeros(), |sum, (weight, motion)| sum + motion * *weight) / 12.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::matrix;
    use std::f64::consts::TAU;

    fn sampled(steps: usize, motion: impl Fn(f64) -> Matrix3<f64>) -> SampledPath {
        let motions: Vec<_> = (0..=steps).map(|index| motion(index as f64 / steps as f64)).collect();
        SampledPath::new(&motions, 0.02).unwrap()
    }

    /// Where a point seen at share `from` is at share `to`.
    fn carry(path: &SampledPath, point: Vector2<f64>, from: f64, to: f64) -> Vector2<f64> {
        let moved = path.between(from, to) * point.push(1.0);
        moved.xy() / moved.z
    }

    /// Maps points at `share` to their positions at share 0: opposite to the direction of motion.
    fn translation(x: f64, y: f64) -> Matrix3<f64> {
        matrix![1.0, 0.0, -x; 0.0, 1.0, -y; 0.0, 0.0, 1.0]
    }

    #[test]
    fn a_vibration_is_interpolated() {
        // 2.5 cycles a readout, 10 px to each side.
        for phase in [0.0, 1.0, 2.0] {
            let at = |share: f64| 10.0 * (TAU * 2.5 * share + phase).sin();
            let path = sampled(32, |share| translation(at(share), -0.5 * at(share)));
            let point = Vector2::new(300.0, -200.0);
            for (from, to) in (0..=400).map(|k| (k as f64 / 400.0, 0.5)).chain([(0.013, 0.987), (0.9, 0.1)]) {
                let moved = at(to) - at(from);
                let error = carry(&path, point, from, to) - point - Vector2::new(moved, -0.5 * moved);
                // At most 10⁻³ of the amplitude at the ends of the readout.
                let limit = if from.min(1.0 - from) < 2.0 / 32.0 { 0.0115 } else { 0.0055 };
                assert!(error.norm() < limit, "{phase} {from}: {error}");
            }
        }
    }

    #[test]
    fn a_roll_and_a_pan_compose() {
        // A camera of focal length f that rolls about its axis and then pans, exactly: K·R·K⁻¹.
        let (f, pan, roll) = (900.0, 0.03, 0.05);
        let at = |share: f64| {
            let ((s, c), (sr, cr)) = ((pan * share).sin_cos(), (roll * share).sin_cos());
            let turn = matrix![c, 0.0, s; 0.0, 1.0, 0.0; -s, 0.0, c];
            let turn = turn * matrix![cr, -sr, 0.0; sr, cr, 0.0; 0.0, 0.0, 1.0];
            let k = Matrix3::from_diagonal(&nalgebra::vector![f, f, 1.0]);
            k * turn * k.try_inverse().unwrap() * (3.0 - share)
        };
        let path = sampled(32, at);
        for (from, to) in [(0.03, 0.5), (0.77, 0.2), (0.999, 0.001)] {
            let point = Vector2::new(-610.0, 340.0);
            let seen = at(from) * point.push(1.0);
            let truth = at(to).try_inverse().unwrap() * seen;
            let error = carry(&path, point, from, to) - truth.xy() / truth.z;
            assert!(error.norm() < 1e-5, "{from} to {to}: {error}");
            let back = carry(&path, carry(&path, point, from, to), to, from);
            assert!((back - point).norm() < 1e-9);
        }
    }

    #[test]
    fn the_path_is_extrapolated_outside_the_readout() {
        let path = sampled(8, |share| translation(40.0 * share, 8.0 * share * share));
        // From share 0 on with (40, 0), from share 1 on with (40, 16).
        for (share, truth) in [(-0.25, [-10.0, 0.0]), (1.5, [60.0, 8.0 + 8.0])] {
            let moved = carry(&path, Vector2::zeros(), 0.0, share);
            assert!((moved - Vector2::from(truth)).norm() < 1e-9, "{share}: {moved}");
        }
    }

    #[test]
    fn the_mean_twist_of_a_uniform_motion_is_its_twist() {
        for twist in [Twist::new(2.0, -300.0, 90.0), Twist::new(0.0, 40.0, 10.0), Twist::new(-30.0, 1.0, 2.0)]
        {
            let path = sampled(32, |share| {
                let back = twist.after(-share * 0.02);
                back.rotation().to_homogeneous()
                    + matrix![0.0, 0.0, back.shift.x; 0.0, 0.0, back.shift.y; 0.0, 0.0, 0.0]
            });
            let mean = path.mean_twist();
            assert!((mean.to_vector() - twist.to_vector()).norm() < 1e-6, "{mean:?} for {twist:?}");
        }
    }

    #[test]
    fn singular_homographies_are_refused() {
        let with = |bad: Matrix3<f64>| {
            let mut motions = [Matrix3::identity(); 6];
            motions[3] = bad;
            SampledPath::new(&motions, 0.02).map(|_| ())
        };
        assert_eq!(with(Matrix3::identity() * -3.0), Ok(()));
        let mut nan = Matrix3::identity();
        nan[(0, 2)] = f64::NAN;
        let mirrored = Matrix3::from_diagonal(&nalgebra::vector![-1.0, 1.0, 1.0]);
        let to_infinity = matrix![1.0, 0.0, 0.0; 0.0, 0.0, 1.0; 0.0, -1.0, 0.0];
        let flat = matrix![1.0, 2.0, 0.0; 2.0, 4.0, 0.0; 0.0, 0.0, 1.0];
        for bad in [nan, mirrored, to_infinity, flat, Matrix3::zeros(), Matrix3::repeat(f64::MAX)] {
            assert_eq!(with(bad), Err(PathError::Singular(3)), "{bad}");
        }
        let identity = [Matrix3::identity(); 5];
        assert_eq!(SampledPath::new(&identity[..4], 0.02), Err(PathError::TooFew(4)));
        for time in [-1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(SampledPath::new(&identity, time), Err(PathError::ReadoutTime));
        }
        assert!(SampledPath::new(&identity, 0.02).unwrap().is_still());
    }
}
