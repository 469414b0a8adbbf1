// SPDX-License-Identifier: MIT OR Apache-2.0

//! The motion path of one frame through its readout.

use super::sampled::PATH_STEPS;
use super::{ResidualField, SampledPath, Twist};
use nalgebra::{Matrix3, Vector2};
use std::sync::Arc;

/// The image motion during one frame's readout, as a function of the elapsed share; cheap to clone.
///
/// In the paper a frame rotates uniformly about a fixed centre: one twist. A [`SampledPath`] is an arbitrary
/// motion by homographies. A [`ResidualField`] adds the local motion of parts of the picture.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionPath {
    global: Global,
    residual: Option<Arc<ResidualField>>,
}

/// The global motion of the picture.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Global {
    Uniform { twist: Twist, readout_time: f64 },
    Sampled(Arc<SampledPath>),
}

/// The motion of a path between two shares of the readout; common to all points exposed at the same
/// share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntervalMotion {
    /// The global motion, scaled so that its last element is 1.
    motion: Matrix3<f64>,
    /// The elapsed share of the readout; negative backwards.
    elapsed: f64,
}

/// Least homogeneous coordinate w of a projected point: beyond the horizon, where w = 0, it would
/// reappear on the other side of the picture.
const MIN_W: f64 = 1.0 / 16.0;

impl MotionPath {
    /// A frame that does not move.
    pub const STILL: Self = Self::uniform(Twist::ZERO, 0.0);

    /// The paper's model: one constant twist during a readout of `readout_time` seconds.
    #[must_use]
    pub const fn uniform(twist: Twist, readout_time: f64) -> Self {
        Self { global: Global::Uniform { twist, readout_time }, residual: None }
    }

    /// The same path with a residual field added.
    #[must_use]
    pub fn with_residual(self, field: ResidualField) -> Self {
        Self { residual: Some(Arc::new(field)), ..self }
    }

    /// The residual field, if there is one.
    #[must_use]
    pub fn residual(&self) -> Option<&ResidualField> {
        self.residual.as_deref()
    }

    /// The global motion.
    pub(super) fn global(&self) -> &Global {
        &self.global
    }

    /// The same path in pixels that are smaller by these factors along x and y.
    pub(super) fn scaled(&self, factors: [f64; 2]) -> Self {
        let global = match &self.global {
            Global::Uniform { twist, readout_time } if factors[0] == factors[1] => {
                let twist = Twist { velocity: twist.velocity * factors[0], ..*twist };
                Global::Uniform { twist, readout_time: *readout_time }
            }
            Global::Uniform { twist, readout_time } => {
                let motions: Vec<_> = (0..=PATH_STEPS)
                    .map(|index| {
                        let share = index as f64 / PATH_STEPS as f64;
                        twist.after(-share * readout_time).to_homogeneous()
                    })
                    .collect();
                match SampledPath::new(&motions, *readout_time) {
                    Ok(path) => Global::Sampled(Arc::new(path.scaled(factors))),
                    Err(_) => self.global.clone(),
                }
            }
            Global::Sampled(path) => Global::Sampled(Arc::new(path.scaled(factors))),
        };
        let residual = self.residual.as_ref().map(|field| Arc::new(field.scaled(factors)));
        Self { global, residual }
    }

    /// The same path in a frame turned clockwise by a quarter: a point at (x, y) comes to (−y, x).
    pub(super) fn turned(&self) -> Self {
        let global = match &self.global {
            Global::Uniform { twist, readout_time } => {
                let velocity = Vector2::new(-twist.velocity.y, twist.velocity.x);
                Global::Uniform { twist: Twist { velocity, ..*twist }, readout_time: *readout_time }
            }
            Global::Sampled(path) => Global::Sampled(Arc::new(path.turned())),
        };
        let residual = self.residual.as_ref().map(|field| Arc::new(field.turned()));
        Self { global, residual }
    }

    /// The position at share `to` of the point that the frame shows at `point` (centred pixels),
    /// exposed at share `from` of the readout.
    ///
    /// A twist rotates it by (to − from)·T·ω, the map of 25.11; a sampled path maps it by
    /// H(to)⁻¹·H(from); a residual field adds (to − from)·v(point). The field is defined at the
    /// positions where the *frame* shows points, so `from` must be the share at which the frame exposed
    /// `point`; without a field any two shares are valid. A field has no unique inverse: at occlusions,
    /// a position at `to` has more than one origin. The warp inverts the map of the whole frame and
    /// resolves this there.
    #[must_use]
    pub fn carry(&self, point: Vector2<f64>, from: f64, to: f64) -> Vector2<f64> {
        self.carry_by(&self.over(from, to), point)
    }

    /// The motion between two shares, precomputed for all points exposed at share `from`: see
    /// [`carry`](Self::carry).
    #[must_use]
    pub fn over(&self, from: f64, to: f64) -> IntervalMotion {
        let motion = match &self.global {
            Global::Uniform { twist, readout_time } => {
                twist.after((to - from) * readout_time).to_homogeneous()
            }
            Global::Sampled(path) => path.between(from, to),
        };
        IntervalMotion { motion, elapsed: to - from }
    }

    /// The homography of an interval, that of the global motion.
    pub(crate) fn global_over(&self, from: f64, to: f64) -> Matrix3<f64> {
        self.over(from, to).motion
    }

    /// Moves the point that the frame shows at `point` (centred pixels) by an interval.
    #[must_use]
    pub fn carry_by(&self, interval: &IntervalMotion, point: Vector2<f64>) -> Vector2<f64> {
        self.carry_with(interval, point, |field| field.velocity(point))
    }

    /// As [`carry_by`](Self::carry_by), for a point with the x of a [`ResidualField::column`], which is not read
    /// without a field.
    #[inline(always)]
    pub(crate) fn carry_in(
        &self,
        interval: &IntervalMotion,
        point: Vector2<f64>,
        column: &[Vector2<f64>],
    ) -> Vector2<f64> {
        self.carry_with(
            interval,
            point,
            #[inline(always)]
            |field| field.velocity_in(column, point.y),
        )
    }

    /// As [`carry_by`](Self::carry_by), given the velocity of the field at the point.
    #[inline(always)]
    fn carry_with(
        &self,
        interval: &IntervalMotion,
        point: Vector2<f64>,
        velocity: impl FnOnce(&ResidualField) -> Vector2<f64>,
    ) -> Vector2<f64> {
        let moved = project(&interval.motion, point);
        match &self.residual {
            Some(field) => moved + velocity(field) * interval.elapsed,
            None => moved,
        }
    }

    /// Whether no point moves during the readout.
    pub fn is_still(&self) -> bool {
        let global = match &self.global {
            Global::Uniform { twist, readout_time } => *twist == Twist::ZERO || *readout_time == 0.0,
            Global::Sampled(path) => path.is_still(),
        };
        global && self.residual().is_none_or(ResidualField::is_zero)
    }

    /// The twist with the same total rotation and shift of the image centre over the readout as this
    /// path, without the residual field; for a uniform path, its own twist.
    #[must_use]
    pub fn mean_twist(&self) -> Twist {
        match &self.global {
            Global::Uniform { twist, .. } => *twist,
            Global::Sampled(path) => path.mean_twist(),
        }
    }
}

impl From<SampledPath> for MotionPath {
    fn from(path: SampledPath) -> Self {
        Self { global: Global::Sampled(Arc::new(path)), residual: None }
    }
}

/// Applies a homography to a point.
#[inline(always)]
pub(crate) fn project(motion: &Matrix3<f64>, point: Vector2<f64>) -> Vector2<f64> {
    let row = |i: usize| motion[(i, 0)] * point.x + motion[(i, 1)] * point.y + motion[(i, 2)];
    Vector2::new(row(0), row(1)) / row(2).max(MIN_W)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::ResidualMesh;

    #[test]
    fn a_uniform_path_is_the_motion_of_its_twist() {
        let twist = Twist::new(1.3, 240.0, -70.0);
        let path = MotionPath::uniform(twist, 0.02);
        let point = Vector2::new(-310.0, 125.0);
        assert_eq!(path.carry(point, 0.2, 0.9), twist.after((0.9 - 0.2) * 0.02).apply(point));
        assert_eq!(path.mean_twist(), twist);
    }

    #[test]
    fn the_residual_field_is_added_in_proportion_to_time() {
        // v = (8 + x/10, −4) px a readout, on nodes 20 px apart from (−40, −40) on.
        let mesh = ResidualMesh { columns: 5, rows: 5, origin: [-40.0; 2], spacing: [20.0; 2] };
        let velocity = |node: usize| [8.0 + ((node % 5) as f32 * 20.0 - 40.0) / 10.0, -4.0];
        let field = ResidualField::new(mesh, (0..25).map(velocity).collect()).unwrap();
        let path = MotionPath::uniform(Twist::new(0.0, 100.0, 0.0), 0.02).with_residual(field);
        // 2 px a readout of the twist and 8.5 of the field, over half a readout.
        let moved = path.carry(Vector2::new(5.0, 7.0), 0.25, 0.75);
        assert!((moved - Vector2::new(5.0 + 0.5 * (2.0 + 8.5), 7.0 - 0.5 * 4.0)).norm() < 1e-6);
    }

    #[test]
    fn a_path_is_still_if_no_point_moves() {
        let mesh = ResidualMesh { columns: 1, rows: 1, origin: [0.0; 2], spacing: [8.0; 2] };
        let beside =
            |v: f32| MotionPath::STILL.with_residual(ResidualField::new(mesh, vec![[v; 2]]).unwrap());
        assert!(MotionPath::STILL.is_still() && beside(0.0).is_still() && !beside(0.1).is_still());
        let twist = Twist::new(0.0, 1.0, 0.0);
        assert!(MotionPath::uniform(twist, 0.0).is_still() && !MotionPath::uniform(twist, 0.1).is_still());
    }

    #[test]
    fn nothing_comes_back_from_beyond_the_horizon() {
        let tilt = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1e-2, 0.0, 1.0);
        assert_eq!(project(&tilt, Vector2::new(100.0, 40.0)), Vector2::new(50.0, 20.0));
        for x in [-90.0, -100.0, -1e4] {
            let moved = project(&tilt, Vector2::new(x, 0.0));
            assert!(moved.x.is_finite() && moved.x < x, "{x} goes to {moved}");
        }
    }

    #[test]
    fn abrupt_samples_give_finite_positions() {
        // Half a turn from one sample to the next: homographies interpolated between them are near-singular.
        let motions = [0, 1, 2, 3, 4, 5, 6, 7, 8].map(|index| {
            let (sin, cos) = (std::f64::consts::PI * f64::from(index)).sin_cos();
            nalgebra::matrix![cos, -sin, 0.0; sin, cos, 0.0; 0.0, 0.0, 1.0]
        });
        let path = MotionPath::from(SampledPath::new(&motions, 0.02).unwrap());
        for from in (-20..=120).map(|k| k as f64 / 100.0).chain([f64::NAN, f64::INFINITY, -1e300]) {
            let moved = path.carry(Vector2::new(100.0, 50.0), from, 0.53);
            assert!(moved.iter().all(|value| value.is_finite()), "{from}: {moved}");
        }
    }
}
