// SPDX-License-Identifier: MIT OR Apache-2.0

//! The readout ratio γ from the curvature of frames, which does not depend on how they were placed.
//!
//! Within the readout the velocity changes by γ·dv/dt, so that a frame is not only leaned by l = γ·v but bent, too: the
//! second derivative of a point's displacement by its place is Q = γ·dl/dt. Both change from frame to frame,
//!
//! > Q′ − Q = γ·((dl/dt)′ − dl/dt) + noise,
//!
//! and dl/dt follows from the changes of the lean as the velocity does from shifts. A stabiliser that takes the same
//! share out of all shifts, as of an even pan, leaves leans that follow from the shifts: with a γ that is too long
//! by what it took out, |γ|/(1 − share). The curvature shows it, if less precisely than the shifts determine γ.
//!
//! As the changes of dl/dt are noisy, γ is their slope by those of the acceleration of the shifts (an instrumental variable):
//! γ = Σ ΔQ·Δa / Σ Δ(dl/dt)·Δa, of each coordinate, both weighted by their inverse variances.

use super::lean_change::LeanChange;
use super::velocity::velocities;
use nalgebra::Vector2;

/// Pairs at either end of successive ones that do not count: there the acceleration of the splines is 0, an error of which
/// 2 − √3 is left from each frame to the next.
const ENDS: usize = 2;

/// Deviations from 0 from which on a correlation is none of noise. Over 50 pairs it is 0.45 to 0.97 where a rolling shutter leans
/// the frames, 0.02 to 0.13 where parallax seems to.
const SIGNIFICANT: f64 = 3.0;

/// Estimate of γ from the curvature of all pairs so far.
#[derive(Clone, Debug, Default)]
pub struct Curvature {
    coordinates: [Sums; 2],
    /// Number after the last pair that was added.
    next: usize,
}

/// Sums of products of ΔQ, Δ(dl/dt) and Δa of one coordinate.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    count: f64,
    bend_acceleration: f64,
    lean_acceleration: f64,
    acceleration: f64,
    bend: f64,
    bend_lean: f64,
    lean: f64,
}

impl Sums {
    fn add(&mut self, bend: f64, lean: f64, acceleration: f64) {
        self.count += 1.0;
        self.bend_acceleration += bend * acceleration;
        self.lean_acceleration += lean * acceleration;
        self.acceleration += acceleration * acceleration;
        self.bend += bend * bend;
        self.bend_lean += bend * lean;
        self.lean += lean * lean;
    }

    /// γ and its inverse variance.
    fn gamma(&self) -> [f64; 2] {
        let gamma = self.bend_acceleration / self.lean_acceleration;
        let rest = self.bend - 2.0 * gamma * self.bend_lean + gamma * gamma * self.lean;
        let noise = rest * self.acceleration / (self.count - 1.0);
        [gamma, self.lean_acceleration * self.lean_acceleration / noise]
    }
}

impl Curvature {
    /// Adds those of successive pairs, the first of this number, that were not added before; their frames have these stamps,
    /// one more than pairs.
    pub fn add(&mut self, pairs: &[LeanChange], first: usize, stamps: &[f64]) {
        let of = |value: fn(&LeanChange) -> Vector2<f64>| pairs.iter().map(value).collect::<Vec<_>>();
        let rates_change = |of: &[Vector2<f64>]| changes(&velocities(of, stamps));
        let leans = rates_change(&of(|pair| pair.change));
        let accelerations = rates_change(&changes(&velocities(&of(|pair| pair.shift), stamps)));
        let last = pairs.len().saturating_sub(ENDS);
        for index in ENDS.max(self.next.saturating_sub(first))..last {
            for (coordinate, sums) in self.coordinates.iter_mut().enumerate() {
                let of = |changes: &[Vector2<f64>]| changes[index][coordinate];
                sums.add(pairs[index].curvature[coordinate], of(&leans), of(&accelerations));
            }
            self.next = first + index + 1;
        }
    }

    /// Whether the frames bend as their leans change, so that the leans are those of a rolling shutter: by the correlation of
    /// ΔQ with Δ(dl/dt), the same in both coordinates.
    pub fn shows_leans(&self) -> bool {
        let sum = |of: fn(&Sums) -> f64| self.coordinates.iter().map(of).sum::<f64>();
        // With ΔQ over its root mean square in each coordinate.
        let squares = sum(|sums| sums.bend_lean / sums.bend).powi(2) / sum(|sums| sums.lean / sums.bend);
        let squared_correlation = squares / self.coordinates.len() as f64;
        squared_correlation * sum(|sums| sums.count) > SIGNIFICANT * SIGNIFICANT
    }

    /// γ and its variance, infinite if nothing is known.
    fn gamma(&self) -> [f64; 2] {
        let known = self.coordinates.iter().map(Sums::gamma);
        let known = known.filter(|[gamma, information]| gamma.is_finite() && information.is_finite());
        let (mut sum, mut information) = (0.0, 0.0);
        known.for_each(|[gamma, own]| (sum, information) = (sum + own * gamma, information + own));
        [if information > 0.0 { sum / information } else { 0.0 }, information.recip()]
    }

    /// By how much γ as found from the shifts is too long, as a root mean square: its excess over this one, without what
    /// is expected of this one's error. A stabiliser that takes shifts out makes it too long, never too short nor of the other sign.
    pub fn excess(&self, gamma: f64) -> f64 {
        let [own, variance] = self.gamma();
        let excess = ((gamma - own) * gamma.signum()).clamp(0.0, gamma.abs());
        (excess * excess - variance).max(0.0).sqrt()
    }

    /// Whether more of that excess is no error of this one than is.
    pub fn contradicts(&self, gamma: f64) -> bool {
        self.excess(gamma).powi(2) > self.gamma()[1]
    }
}

/// From each to the next.
fn changes(of: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    of.windows(2).map(|two| two[1] - two[0]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::random::Random;
    use std::f64::consts::TAU;

    const GAMMA: f64 = 0.6;
    /// Standard deviation of a change of lean and of curvature.
    const ERROR: f64 = 2e-4;

    /// Pairs of a pan to and fro, of whose shifts this share is left.
    fn pan(left: f64) -> (Vec<LeanChange>, Vec<f64>) {
        let mut random = Random(7);
        let rate = TAU * 0.06;
        let velocity = |t: f64| Vector2::new((rate * t).sin(), 0.1 * (1.3 * rate * t).cos()) * 0.1;
        let acceleration =
            |t: f64| Vector2::new((rate * t).cos(), -0.13 * (1.3 * rate * t).sin()) * (0.1 * rate);
        let mut noisy = |value: Vector2<f64>| value + Vector2::new(random.normal(), random.normal()) * ERROR;
        let pair = |k: usize| {
            let [from, to] = [k as f64, k as f64 + 1.0];
            LeanChange {
                change: noisy((velocity(to) - velocity(from)) * GAMMA),
                variance: Vector2::repeat(ERROR * ERROR),
                shift: (velocity(from) + velocity(k as f64 + 0.5) * 4.0 + velocity(to)) * (left / 6.0),
                stretch: 0.0,
                roll: 0.0,
                bend: 0.0,
                curvature: noisy((acceleration(to) - acceleration(from)) * (GAMMA * GAMMA)),
            }
        };
        ((0..30).map(pair).collect(), (0..=30).map(f64::from).collect())
    }

    fn seen((pairs, stamps): (Vec<LeanChange>, Vec<f64>)) -> Curvature {
        let mut curvature = Curvature::default();
        // One by one, as they come.
        (16..=pairs.len()).for_each(|count| curvature.add(&pairs[..count], 0, &stamps[..=count]));
        curvature
    }

    #[test]
    fn the_curvature_knows_the_readout_of_a_stabilised_pan() {
        for left in [1.0, 0.75] {
            let curvature = seen(pan(left));
            let [gamma, variance] = curvature.gamma();
            let error = (gamma - GAMMA).abs();
            assert!(error < 0.05 && error < 3.0 * variance.sqrt(), "{left}: {gamma}, {variance}");
            let by_shifts = GAMMA / left;
            assert_eq!(curvature.contradicts(by_shifts), left < 1.0, "{left}: {gamma}, {variance}");
            assert!(left == 1.0 || curvature.excess(by_shifts) > 0.5 * (by_shifts - GAMMA));
        }
    }

    #[test]
    fn a_readout_that_is_too_short_is_not_contradicted() {
        let curvature = seen(pan(0.75));
        assert_eq!([0.0, 0.3, 0.6].map(|gamma| curvature.excess(gamma)), [0.0; 3]);
        let excess = curvature.excess(-0.2);
        assert!(excess > 0.1 && excess <= 0.2, "at most all of it is too long: {excess}");
    }

    #[test]
    fn each_pair_counts_once_and_a_still_picture_says_nothing() {
        let curvature = seen(pan(1.0));
        assert_eq!((curvature.coordinates[0].count, curvature.next), (26.0, 28));
        let (mut pairs, stamps) = pan(1.0);
        pairs.iter_mut().for_each(|pair| pair.shift = Vector2::zeros());
        let still = seen((pairs, stamps));
        assert!(still.excess(0.7) == 0.0 && !still.contradicts(0.7));
    }
}
