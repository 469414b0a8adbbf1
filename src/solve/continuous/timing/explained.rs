// SPDX-License-Identifier: MIT OR Apache-2.0

//! The share of the changes of the lean that the shifts between the frames do not explain.
//!
//! Of each coordinate, weighted by the inverse variance,
//!
//! > l′ − l = γ·(v′ − v) + b·s + noise,
//!
//! where b·s stands for parallax: a scene whose depth varies along the scan axis is sheared in proportion to the shift, so s
//! is 1, the shift and the stretch of the lines. With b eliminated, γ is limited to ±1. The median of the variances is added
//! to each, as the three degrees of freedom of a pair's do not determine it.

use super::lean_change::LeanChange;
use super::velocity::velocities;
use crate::robust::median::median;
use nalgebra::{SMatrix, SVector, Vector2, Vector3, Vector4};
use std::f64::consts::{PI, TAU};
use std::ops::Range;

/// Mean square of the changes over their variance, from which on they are no parallax and no noise: of rendered scenes
/// with much parallax and of still ones up to 15, of a walk between near walls up to 70, of shaken ones 80 to 28,000.
const MIN_SIGNAL: f64 = 30.0;
/// Root mean square of the changes of the curvature over those of the lean. With |γ| ≤ 1 a motion below half a cycle a
/// frame has π at most; above, frames are too rare to know its velocity.
const MAX_BEND: f64 = PI;
/// Cycles a frame of a motion from which on its velocity is not known from the shifts: the spline has nine tenths of it here, six at
/// 0.4, and above ½ the shifts are aliased.
const FAST: f64 = 0.3;
/// Limits of the root mean square of the changes of the shift over those of the lean where frames are as recorded: sin(πf)/(πf·|γ|)
/// of a motion of f cycles a frame, from ¾ of a cycle with |γ| = 1 to 0.3 with 0.2. With less a stabiliser has taken the
/// shifts out, with more the frames hardly lean.
const SHIFT_OVER_LEAN: Range<f64> = 0.3..4.3;
/// Least share of the changes that parallax could not explain as well: where the shift turns in a circle, its change is
/// proportional to its other coordinate and 0.01 at most is left; of shake 0.15 and more.
const MIN_UNSHARED: f64 = 0.1;
/// Standard deviations of the γ of the changes by which another one must differ to be excluded. Of rendered clips with a rolling
/// shutter up to 6, where the camera follows a person among much parallax; where depth that varies along the scan axis, or an object
/// that sways or turns, looks like a readout, mostly 10 to 100.
const EXCLUDED: f64 = 8.0;
/// Blocks of pairs of the jackknife.
const BLOCKS: usize = 5;

/// How the changes of the lean agree with the shifts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Explained {
    /// Share of the mean square of the changes that is not explained, 0 to 1.
    pub unexplained: f64,
    /// Mean square over their variance of the changes without what parallax explains, and its share of that of
    /// the whole changes.
    pub signal: f64,
    pub unshared: f64,
    /// Root mean square of the changes of curvature over those of the lean.
    pub bend: f64,
    /// Whether the picture moves to and fro so fast that its velocity does not follow from the shifts.
    pub is_fast: bool,
    /// Number of changes.
    pub count: usize,
    sums: Sums,
}

impl Explained {
    /// Share of the mean square of the changes that is not explained with this γ; above 1 if it has the wrong sign.
    pub fn unexplained_with(&self, gamma: f64) -> f64 {
        self.sums.unexplained_with(gamma)
    }

    /// Whether the changes are certain enough, and slow enough, to be compared with the shifts, and no parallax.
    pub fn is_telling(&self) -> bool {
        self.signal > MIN_SIGNAL && self.unshared > MIN_UNSHARED && self.bend < MAX_BEND
    }

    /// Log likelihood ratio in nats over another explanation of the same changes, of normal errors of unknown
    /// variance.
    pub fn log_likelihood_over(&self, other: &Self) -> f64 {
        // Each pair has two changes.
        self.count as f64 * (other.unexplained / self.unexplained).ln()
    }
}

/// Number of pairs from which the agreement of the changes with the shifts is judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pairs {
    /// Enough to separate parallax from γ.
    Many,
    /// Three at least, too few for that: parallax is neglected, and the first and the last one are left out.
    Few,
}

/// The changes of lean and velocity in a pair.
#[derive(Clone, Copy, Debug)]
struct Change<'a> {
    lean: &'a LeanChange,
    velocity: Vector2<f64>,
}

/// The changes in successive pairs.
struct Changes<'a> {
    pairs: Vec<Change<'a>>,
    /// Variance that is added to that of each lean, and number of those whose own is finite.
    usual: f64,
    known: usize,
}

impl<'a> Changes<'a> {
    /// Of those pairs that count; `None` if there are too few pairs, or stamps.
    fn of(pairs: &'a [LeanChange], stamps: &[f64], noise: f64, counted: Range<usize>) -> Option<Self> {
        let shifts: Vec<Vector2<f64>> = pairs.iter().map(|pair| pair.shift).collect();
        let velocities = velocities(&shifts, stamps);
        let velocities = velocities.get(counted.start..=counted.end)?.windows(2).map(|two| two[1] - two[0]);
        let pairs = pairs.get(counted)?;
        let variances = pairs.iter().flat_map(|pair| [pair.variance.x, pair.variance.y]);
        let mut variances: Vec<f64> = variances.filter(|v| v.is_finite()).collect();
        let usual = median(&mut variances).max(noise);
        let pairs = pairs.iter().zip(velocities).map(|(lean, velocity)| Change { lean, velocity }).collect();
        Some(Self { pairs, usual, known: variances.len() })
    }

    /// Sums over both coordinates, with some terms of each eliminated; `None` if these are not finite.
    fn sums<const TERMS: usize>(
        &self,
        terms: impl Fn(&LeanChange, usize) -> SVector<f64, TERMS>,
    ) -> Option<Sums> {
        let [across, along] = [0, 1].map(|coordinate| self.coordinate_sums(coordinate, &terms));
        Some(across? + along?)
    }

    fn coordinate_sums<const TERMS: usize>(
        &self,
        coordinate: usize,
        terms: &impl Fn(&LeanChange, usize) -> SVector<f64, TERMS>,
    ) -> Option<Sums> {
        let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
        let [mut by_change, mut by_velocity] = [SVector::<f64, TERMS>::zeros(); 2];
        let mut sums = Sums::default();
        for Change { lean, velocity } in &self.pairs {
            let weight = 1.0 / (lean.variance[coordinate] + self.usual);
            let [change, velocity] = [lean.change[coordinate], velocity[coordinate]];
            let terms = terms(lean, coordinate);
            normal += terms * terms.transpose() * weight;
            by_change += terms * (change * weight);
            by_velocity += terms * (velocity * weight);
            sums.change += change * change * weight;
            sums.cross += change * velocity * weight;
            sums.velocity += velocity * velocity * weight;
        }
        // A ridge, as of a still picture all terms but the first are 0.
        let ridge = f64::EPSILON * normal.trace();
        let solved = (normal + SMatrix::identity() * ridge).cholesky()?;
        let [of_change, of_velocity] = [solved.solve(&by_change), solved.solve(&by_velocity)];
        Some(Sums {
            freedom: self.pairs.len().saturating_sub(TERMS),
            whole: sums.change,
            change: sums.change - by_change.dot(&of_change),
            cross: sums.cross - by_change.dot(&of_velocity),
            velocity: sums.velocity - by_velocity.dot(&of_velocity),
        })
    }

    /// Sums over both coordinates, with the parallax of the same coordinate's shift eliminated: with that of both, nothing is left of a
    /// shift that turns in a circle.
    fn sums_by_own_shift(&self) -> Option<Sums> {
        self.sums(|pair, coordinate| Vector3::new(1.0, pair.shift[coordinate], pair.stretch))
    }

    /// By how many standard deviations the γ of the changes differs from one that leaves more of them unexplained than γ = 0 does; 0 from
    /// another one. `None` if nothing is known.
    fn deviations(&self, gamma: f64) -> Option<f64> {
        let sums = self.sums_by_own_shift()?;
        if sums.unexplained_with(gamma) <= 1.0 {
            return Some(0.0);
        }
        let variance = sums.gamma_variance() + self.jackknife_variance()?;
        Some((gamma - sums.likely_gamma()).abs() / variance.sqrt())
    }

    /// Whether the picture moves to and fro too fast for its velocity to be known from the shifts: the changes of the lean alternate as
    /// those of such a motion, whose mean product with the next one is cos(2πf) times their mean square, and those of the shift are as
    /// large as they must be.
    fn is_fast(&self) -> bool {
        let [mut product, mut leans, mut shifts] = [0.0; 3];
        for two in self.pairs.windows(2) {
            let [before, after] = [two[0].lean, two[1].lean];
            for coordinate in 0..2 {
                let weight = 1.0 / (before.variance[coordinate] + after.variance[coordinate] + self.usual);
                let [from, to] = [before.change[coordinate], after.change[coordinate]];
                product += weight * from * to;
                leans += weight * 0.5 * (from * from + to * to);
                shifts += weight * (after.shift[coordinate] - before.shift[coordinate]).powi(2);
            }
        }
        product < (TAU * FAST).cos() * leans && SHIFT_OVER_LEAN.contains(&(shifts / leans).sqrt())
    }

    /// Without those of these pairs.
    fn without(&self, left_out: Range<usize>) -> Self {
        let kept = self.pairs.iter().enumerate().filter(|(index, _)| !left_out.contains(index));
        Self { pairs: kept.map(|(_, pair)| *pair).collect(), ..*self }
    }

    /// Variance of γ by the jackknife over blocks of successive pairs (H. R. Künsch, *The jackknife and the bootstrap for general
    /// stationary observations*, 1989): by how much it depends on a few of them, whose errors are correlated. Where the shared motion
    /// goes over to another surface, one pair's velocity may count for more than those of all others.
    fn jackknife_variance(&self) -> Option<f64> {
        let count = self.pairs.len();
        let blocks = BLOCKS.min(count);
        let without = |block: usize| {
            let rest = self.without(block * count / blocks..(block + 1) * count / blocks);
            Some(rest.sums_by_own_shift()?.gamma())
        };
        let found: Vec<f64> = (0..blocks).map(without).collect::<Option<_>>()?;
        let mean = found.iter().sum::<f64>() / blocks as f64;
        let squares: f64 = found.iter().map(|gamma| (gamma - mean).powi(2)).sum();
        Some(squares * (blocks as f64 - 1.0) / blocks as f64)
    }
}

/// All pairs but the first and the last one, as the velocities at the ends have a neighbour on one side only.
fn inner(pairs: &[LeanChange]) -> Option<Range<usize>> {
    pairs.len().checked_sub(1).map(|last| 1..last)
}

/// The agreement of successive pairs whose frames have these stamps, one more than pairs; `noise` is the least variance
/// of a change in squared radii. `None` if nothing is known.
pub fn explained(pairs: &[LeanChange], stamps: &[f64], noise: f64, number: Pairs) -> Option<Explained> {
    let counted = match number {
        Pairs::Many => 0..pairs.len(),
        Pairs::Few => inner(pairs)?,
    };
    let changes = Changes::of(pairs, stamps, noise, counted)?;
    let sums = match number {
        Pairs::Many => changes.sums(|pair, _| Vector4::new(1.0, pair.shift.x, pair.shift.y, pair.stretch))?,
        Pairs::Few => changes.sums(|_, _| SVector::<f64, 0>::zeros())?,
    };
    let is_fast = changes.is_fast();
    let Changes { pairs, known, .. } = changes;
    let squares = |of: fn(&LeanChange) -> f64| pairs.iter().map(|pair| of(pair.lean).powi(2)).sum::<f64>();
    let found = Explained {
        unexplained: sums.unexplained_with(sums.likely_gamma()),
        signal: sums.change / known as f64,
        unshared: sums.change / sums.whole,
        bend: (squares(|pair| pair.bend) / squares(|pair| pair.change.x)).sqrt(),
        is_fast,
        count: pairs.len(),
        sums,
    };
    (found.unexplained.is_finite() && found.bend.is_finite()).then_some(found)
}

/// Whether a γ is excluded: it leaves more of the changes unexplained than γ = 0 does, and is far from the one that the changes have by
/// least squares. Never where the velocity does not follow from the shifts.
pub fn excludes(pairs: &[LeanChange], stamps: &[f64], noise: f64, gamma: f64) -> bool {
    let changes = inner(pairs).and_then(|counted| Changes::of(pairs, stamps, noise, counted));
    let slow = changes.filter(|changes| !changes.is_fast());
    slow.and_then(|changes| changes.deviations(gamma)).is_some_and(|deviations| deviations > EXCLUDED)
}

/// Sums of squares and products of changes of lean and velocity without what parallax explains, weighted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sums {
    /// Degrees of freedom: changes less the terms that are eliminated.
    freedom: usize,
    /// Of the changes with what parallax explains.
    whole: f64,
    change: f64,
    cross: f64,
    velocity: f64,
}

impl Sums {
    /// γ by least squares.
    fn gamma(&self) -> f64 {
        self.cross / self.velocity
    }

    /// The γ within ±1 that leaves least unexplained.
    fn likely_gamma(&self) -> f64 {
        self.gamma().clamp(-1.0, 1.0)
    }

    /// Variance of γ, by the scatter about it where that is more than the changes' own variance.
    fn gamma_variance(&self) -> f64 {
        let scatter = self.unexplained_with(self.gamma()) * self.change / self.freedom.max(1) as f64;
        scatter.max(1.0) / self.velocity
    }

    fn unexplained_with(&self, gamma: f64) -> f64 {
        (self.change - 2.0 * gamma * self.cross + gamma * gamma * self.velocity) / self.change
    }
}

impl std::ops::Add for Sums {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            freedom: self.freedom + other.freedom,
            whole: self.whole + other.whole,
            change: self.change + other.change,
            cross: self.cross + other.cross,
            velocity: self.velocity + other.velocity,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::random::Random;

    const COUNT: usize = 24;
    const NOISE: f64 = 1e-10;
    /// Standard deviation of a change.
    const ERROR: f64 = 3e-4;

    /// Pairs of frames that are exposed at these times, whose picture moves with this velocity, and their lean.
    fn pairs_at(
        stamps: &[f64],
        velocity: impl Fn(f64) -> Vector2<f64>,
        lean: impl Fn(f64) -> Vector2<f64>,
    ) -> Vec<LeanChange> {
        let mut random = Random(5);
        let pair = |frames: &[f64]| {
            let [from, to] = [frames[0], frames[1]];
            let error = Vector2::new(random.normal(), random.normal()) * ERROR;
            // Simpson's rule.
            let mean = (velocity(from) + velocity((from + to) / 2.0) * 4.0 + velocity(to)) / 6.0;
            LeanChange {
                change: lean(to) - lean(from) + error,
                variance: Vector2::repeat(ERROR * ERROR),
                shift: mean * (to - from),
                stretch: 0.0,
                roll: 0.0,
                bend: 0.0,
                curvature: Vector2::zeros(),
            }
        };
        stamps.windows(2).map(pair).collect()
    }

    fn pairs(velocity: impl Fn(f64) -> Vector2<f64>, lean: impl Fn(f64) -> Vector2<f64>) -> Vec<LeanChange> {
        pairs_at(&stamps(), velocity, lean)
    }

    fn swing(t: f64) -> Vector2<f64> {
        Vector2::new((TAU * 0.11 * t).sin() + 0.5 * (TAU * 0.05 * t).cos(), (TAU * 0.13 * t + 1.0).sin())
            * 0.02
    }

    fn stamps() -> Vec<f64> {
        (0..=COUNT).map(|index| index as f64).collect()
    }

    #[test]
    fn the_lean_of_frames_as_recorded_follows_from_their_shifts() {
        let recorded = pairs(swing, |t| swing(t) * -0.7);
        let found = explained(&recorded, &stamps(), NOISE, Pairs::Many).unwrap();
        assert!(found.is_telling() && found.unexplained < 0.05, "{found:?}");
        let with = [-0.7, 0.0, 0.7].map(|gamma| found.unexplained_with(gamma));
        for (found, expected) in with.into_iter().zip([0.0, 1.0, 4.0]) {
            assert!((found - expected).abs() < 0.2, "{with:?}");
        }
        assert!(!excludes(&recorded, &stamps(), NOISE, -0.7));
    }

    #[test]
    fn the_lean_of_steadied_frames_does_not() {
        let found = explained(&pairs(|t| swing(t) * 0.05, |t| swing(t) * 0.7), &stamps(), NOISE, Pairs::Many)
            .unwrap();
        assert!(found.is_telling() && found.unexplained > 0.7, "{found:?}");
    }

    #[test]
    fn fast_motions_are_told_from_steadied_frames() {
        // On both sides of half a cycle a frame: on one side alone, the lean follows from the shifts with a γ of the other sign.
        let swings = |t: f64, [low, high]: [f64; 2]| (TAU * low * t).cos() + (TAU * high * t).sin();
        let fast = |t: f64| Vector2::new(swings(t, [0.41, 0.63]), swings(t, [0.37, 0.58])) * 0.02;
        let of = |shift: f64, velocity: &dyn Fn(f64) -> Vector2<f64>| {
            let pairs = pairs(|t| velocity(t) * shift, |t| velocity(t) * 0.7);
            explained(&pairs, &stamps(), NOISE, Pairs::Many).unwrap()
        };
        let recorded = of(1.0, &fast);
        assert!(recorded.is_fast && recorded.unexplained > 0.6, "{recorded:?}");
        assert!(!of(0.05, &fast).is_fast && !of(0.05, &swing).is_fast && !of(1.0, &swing).is_fast);
    }

    #[test]
    fn few_pairs_say_so_too() {
        let (recorded, steadied) =
            (pairs(swing, |t| swing(t) * -0.7), pairs(|t| swing(t) * 0.05, |t| swing(t) * 0.7));
        for first in 0..8 {
            for count in 3..8 {
                let of = |pairs: &[LeanChange]| {
                    explained(
                        &pairs[first..first + count],
                        &stamps()[first..=first + count],
                        NOISE,
                        Pairs::Few,
                    )
                };
                let [recorded, steadied] = [of(&recorded).unwrap(), of(&steadied).unwrap()];
                assert!(recorded.unexplained < 0.3, "{first}, {count}: {recorded:?}");
                assert!(
                    steadied.is_telling() && steadied.unexplained > 0.7,
                    "{first}, {count}: {steadied:?}"
                );
            }
        }
        assert_eq!(explained(&recorded[..2], &stamps()[..3], NOISE, Pairs::Few), None);
    }

    #[test]
    fn eight_pairs_exclude_a_readout_that_frames_do_not_lean_by() {
        let recorded = pairs(swing, |t| swing(t) * -0.7);
        // A scene that leans by itself, a third as far as by that readout.
        let swaying = pairs(swing, |t| Vector2::new((TAU * 0.19 * t).sin(), (TAU * 0.23 * t).cos()) * 0.005);
        for first in 0..COUNT - 8 {
            let excluded = |pairs: &[LeanChange], gamma: f64| {
                excludes(&pairs[first..first + 8], &stamps()[first..=first + 8], NOISE, gamma)
            };
            assert!(!excluded(&recorded, -0.7) && excluded(&recorded, 0.7), "{first}");
            assert!(!excluded(&swaying, 0.0), "{first}");
        }
        assert!(excludes(&swaying, &stamps(), NOISE, 0.7));
        assert!(!excludes(&recorded[..1], &stamps()[..2], NOISE, 0.7));
    }

    #[test]
    fn a_few_shifts_of_another_surface_exclude_no_readout() {
        let mut pairs = pairs(swing, |t| swing(t) * -0.7);
        for near in [9, 10, 17] {
            pairs[near].shift *= 5.0;
        }
        let changes = Changes::of(&pairs, &stamps(), NOISE, inner(&pairs).unwrap()).unwrap();
        let sums = changes.sums_by_own_shift().unwrap();
        assert!(
            (sums.gamma() + 0.7).abs() > EXCLUDED * sums.gamma_variance().sqrt(),
            "by their scatter alone"
        );
        assert!(!excludes(&pairs, &stamps(), NOISE, -0.7));
    }

    #[test]
    fn the_right_stamps_explain_more() {
        // Of the frames at 0, 1, 3, 4, 6, … every third is missing.
        let exposed: Vec<f64> = (0..=COUNT).map(|index| (index + index / 2) as f64).collect();
        let seen = pairs_at(&exposed, swing, |t| swing(t) * 0.7);
        let [right, wrong] =
            [exposed, stamps()].map(|stamps| explained(&seen, &stamps, NOISE, Pairs::Many).unwrap());
        assert!(right.unexplained < 0.1 && right.log_likelihood_over(&wrong) > 20.0, "{right:?}, {wrong:?}");
    }

    #[test]
    fn parallax_noise_and_fast_motions_say_nothing() {
        // The change of a shift that turns in a circle is proportional to its other coordinate.
        let circle = |t: f64| Vector2::new((TAU * t / 12.0).cos(), (TAU * t / 12.0).sin()) * 0.02;
        let pairs_in_circle = pairs(circle, |t| circle(t) * 0.7);
        let circular = explained(&pairs_in_circle, &stamps(), NOISE, Pairs::Many).unwrap();
        assert!(!circular.is_telling() && circular.unshared < 0.1, "{circular:?}");
        assert!(!excludes(&pairs_in_circle, &stamps(), NOISE, 0.7));
        // Where depth varies along the scan axis, the lean changes in proportion to the shift, of which it is the integral.
        let depth = |t: f64| {
            let place = |t: f64| Vector2::new(-(TAU * 0.11 * t).cos() / 0.11, -(TAU * 0.13 * t).cos() / 0.13);
            place(t) * (0.01 / TAU)
        };
        let velocity = |t: f64| Vector2::new((TAU * 0.11 * t).sin(), (TAU * 0.13 * t).sin()) * 0.02;
        let pairs_with_depth = pairs(velocity, depth);
        let parallax = explained(&pairs_with_depth, &stamps(), NOISE, Pairs::Many).unwrap();
        assert!(!parallax.is_telling() && parallax.unshared < 0.1, "{parallax:?}");
        let excluded = [0.0, 0.5].map(|gamma| excludes(&pairs_with_depth, &stamps(), NOISE, gamma));
        assert_eq!(excluded, [false, true], "frames with a readout would lean");
        let slight = explained(&pairs(swing, |t| swing(t) * 0.02), &stamps(), NOISE, Pairs::Many).unwrap();
        assert!(!slight.is_telling() && slight.signal < 30.0, "{slight:?}");
        let mut fast = pairs(swing, |t| swing(t) * 0.7);
        fast.iter_mut().for_each(|pair| pair.bend = 0.1);
        assert!(!explained(&fast, &stamps(), NOISE, Pairs::Many).unwrap().is_telling());
    }

    #[test]
    fn nothing_is_said_of_a_still_picture() {
        let still = |_| Vector2::zeros();
        let mut pairs = pairs(still, still);
        pairs.iter_mut().for_each(|pair| pair.variance = Vector2::repeat(f64::INFINITY));
        assert_eq!(explained(&pairs, &stamps(), NOISE, Pairs::Many), None);
    }
}
