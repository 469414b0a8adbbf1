// SPDX-License-Identifier: MIT OR Apache-2.0

//! The pairs of a window, linearised about a path.
//!
//! A pair keeps its residuals, robust weights and normal equations while the path stays near that about which it
//! was linearised. With N, g the normal equations there and δ the change since, of the path's coefficients, γ and
//! κ, the right side is g − N·δ and the log likelihood ℓ + gᵀδ − ½·δᵀNδ. So most pairs of a window are those
//! of the window before, and a step evaluates only those whose displacements it has changed.

use super::normal::Normal;
use super::pair_residuals::PairResiduals;
use super::residual::Evaluator;
use super::shared::{SHARED, Shared};
use crate::parallel::*;
use crate::solve::continuous::data::FramePair;
use nalgebra::{SVector, Vector2};

/// A pair is linearised anew if its displacements (root mean square) have changed by more than this share of a
/// coordinate's standard deviation: with a thousand matches, as much as one deviation of the motion between its
/// frames. The error of the linearisation is of second order, but robust weights are kept, too.
const MAX_CHANGE: f64 = 0.03;

/// What a pair was linearised for, other than the path.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Inputs {
    stamps: [f64; 2],
    /// End of the first match, as timestamps may repeat.
    first: Option<Vector2<f64>>,
    /// Whether the path covers the pair before.
    tracks: bool,
}

/// A pair, linearised about a path.
#[derive(Clone, Debug, Default)]
pub struct EvaluatedPair {
    /// There.
    pub residuals: PairResiduals,
    pub normal: Normal,
    /// `None` before it was linearised.
    inputs: Option<Inputs>,
    /// The path's coefficients there, in the order of the equations.
    coefficients: Vec<f64>,
    /// γ and κ there.
    shared: Shared<f64>,
    /// First block of the path to which the indices of the equations belong.
    base: i64,
    /// δ.
    change: Change,
    /// ℓ, once computed.
    log_likelihood: Option<f64>,
}

/// A change of the path, and the normal equations after it.
#[derive(Clone, Debug, Default)]
struct Change {
    coefficients: Vec<f64>,
    shared: SVector<f64, SHARED>,
    /// Right sides of the equations.
    right: Vec<f64>,
    shared_right: SVector<f64, SHARED>,
}

impl Change {
    /// Makes this no change.
    fn clear(&mut self, normal: &Normal) {
        self.coefficients.clear();
        self.coefficients.resize(normal.equations.places.len(), 0.0);
        self.shared = SVector::zeros();
        self.right.clone_from(&normal.equations.sides[0]);
        self.shared_right = normal.shared_right;
    }

    /// δᵀ·(g − g′), `normal` having the right side g, and g′ being that after the change.
    fn dot(&self, right: impl Fn(f64, f64) -> f64, normal: &Normal) -> f64 {
        let path = self.coefficients.iter().zip(normal.equations.sides[0].iter().zip(&self.right));
        let shared = self.shared.iter().zip(normal.shared_right.iter().zip(&self.shared_right));
        path.chain(shared).map(|(change, (old, new))| change * right(*old, *new)).sum()
    }
}

impl EvaluatedPair {
    /// Sets the change to that from where it was linearised to an estimate; whether it is then near enough.
    fn change_to(&mut self, evaluator: &Evaluator<'_>) -> bool {
        let path = &evaluator.trajectory.splines;
        let Self { normal, change, .. } = self;
        change.coefficients.clear();
        let places = normal.equations.places.iter().zip(&self.coefficients);
        change.coefficients.extend(places.map(|(place, value)| path.coefficients[*place] - value));
        let shared = evaluator.shared().zip(self.shared).map(|(now, then)| now - then);
        change.shared = shared.into_array().into();
        change.shared_right =
            normal.expand(evaluator.cpu, &change.coefficients, &change.shared, &mut change.right);
        let square = change.dot(|old, new| old - new, normal);
        normal.deviations(square) <= MAX_CHANGE
    }

    /// Makes an estimate the one about which it is linearised.
    fn linearise(&mut self, evaluator: &Evaluator<'_>) {
        let path = &evaluator.trajectory.splines;
        evaluator.normal(&self.residuals, &mut self.normal);
        self.coefficients.clear();
        self.coefficients.extend(self.normal.equations.places.iter().map(|place| path.coefficients[*place]));
        (self.shared, self.log_likelihood) = (evaluator.shared(), None);
        self.change.clear(&self.normal);
    }

    /// Right side of the equations of the path.
    pub fn right(&self) -> &[f64] {
        &self.change.right
    }

    /// Right side of the equations of γ and κ.
    pub fn shared_right(&self) -> &SVector<f64, SHARED> {
        &self.change.shared_right
    }

    /// Log likelihood of the innovations, up to a constant, for the number of independent matches.
    pub fn log_likelihood(&mut self) -> f64 {
        let Self { normal, residuals, change, .. } = self;
        let then = *self.log_likelihood.get_or_insert_with(|| normal.log_likelihood(residuals));
        then + 0.5 * change.dot(|old, new| old + new, normal)
    }
}

/// Linearises successive pairs about a path, but for those that are linearised about one near it.
pub fn evaluate(evaluated: &mut Vec<EvaluatedPair>, pairs: &[&FramePair], evaluator: &Evaluator<'_>) {
    let splines = &evaluator.trajectory.splines;
    let wanted = |(index, pair): (usize, &&FramePair)| Inputs {
        stamps: pair.stamps,
        first: pair.matches.first().map(|m| m.to),
        tracks: index > 0,
    };
    let wanted: Vec<Inputs> = pairs.iter().enumerate().map(wanted).collect();
    for one in evaluated.iter_mut() {
        if !one.normal.equations.shift(splines.base - one.base, splines) {
            one.inputs = None;
        }
        one.base = splines.base;
    }
    // Each wanted pair to its place, the others behind.
    evaluated.resize_with(pairs.len().max(evaluated.len()), EvaluatedPair::default);
    for (index, wanted) in wanted.iter().enumerate() {
        if let Some(found) = evaluated[index..].iter().position(|one| one.inputs == Some(*wanted)) {
            evaluated.swap(index, index + found);
        }
    }
    evaluated.truncate(pairs.len());
    let is_far = |(one, wanted): (&mut EvaluatedPair, &Inputs)| {
        one.inputs != Some(*wanted) || !one.change_to(evaluator)
    };
    let mut is_far: Vec<bool> = evaluated.iter_mut().zip(&wanted).map(is_far).collect();
    // The first pair has no tracks to separate noise from parallax: it takes the second's variances.
    if let [first, second, ..] = is_far.as_mut_slice() {
        *first |= *second;
    }
    evaluated.par_iter_mut().zip(pairs).zip(&wanted).zip(&is_far).for_each(
        |(((one, pair), wanted), is_far)| {
            if *is_far {
                evaluator.residuals(pair, wanted.tracks, &mut one.residuals);
                one.normal.estimate_variances(&one.residuals, evaluator.noise);
                (one.inputs, one.base) = (Some(*wanted), splines.base);
            }
        },
    );
    if let [first, second, ..] = evaluated.as_mut_slice() {
        first.normal.variances = second.normal.variances;
    }
    evaluated.par_iter_mut().zip(&is_far).for_each(|(one, is_far)| {
        if *is_far {
            one.linearise(evaluator);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::correspond::Correspondence;
    use crate::cpu::CpuLevel;
    use crate::motion::generators::GENERATORS;
    use crate::solve::continuous::data::ScanAxis;
    use crate::solve::continuous::trajectory::{KnotDensity, Splines, Trajectory, ratio};
    use nalgebra::Matrix2;

    const RADIUS: f64 = 320.0;

    /// A path over 9 blocks that goes to and fro by this many pixels, the same for the same instants.
    fn path(base: i64, pixels: f64) -> Splines {
        let mut path = Splines::still(base, 9, 0.3);
        for j in 0..GENERATORS {
            for knot in path.knots(j) {
                let place = path.place(j, knot) as usize;
                path.coefficients[place] = pixels * (knot as f64 / ratio(j) as f64 + j as f64).sin();
            }
        }
        path
    }

    /// A hundred points that move by up to two pixels.
    fn pair(stamp: f64) -> FramePair {
        let found: Vec<Correspondence> = (0..100)
            .map(|k| {
                let from = Vector2::new(-300.0 + 60.0 * (k % 10) as f64, -225.0 + 45.0 * (k / 10) as f64);
                let phase = k as f64 + stamp;
                let to = from + Vector2::new((1.7 * phase).sin(), (2.9 * phase).cos()) * 2.0;
                Correspondence { from, to, texture: 1.0, residual: 0.0, covariance: Matrix2::zeros() }
            })
            .collect();
        FramePair::new(&found, Vector2::zeros(), RADIUS, [stamp, stamp + 1.0], None).unwrap()
    }

    fn evaluate_against(evaluated: &mut Vec<EvaluatedPair>, pairs: &[&FramePair], path: &Splines) {
        evaluate_with(0.1, evaluated, pairs, path);
    }

    fn evaluate_with(noise: f64, evaluated: &mut Vec<EvaluatedPair>, pairs: &[&FramePair], path: &Splines) {
        let blocks = [path.base as f64, path.base as f64 + 6.0];
        let trajectory = &Trajectory::of(path.clone(), KnotDensity::Usual, RADIUS, blocks);
        let scan_axis = ScanAxis { by_rows: true, length: 1.5 };
        let evaluator = Evaluator { cpu: CpuLevel::detect(), trajectory, scan_axis, gamma: 0.7, noise };
        evaluate(evaluated, pairs, &evaluator);
    }

    /// Place and value of all entries of a pair's matrix, and its σ.
    fn sums(evaluated: &EvaluatedPair) -> (Vec<usize>, Vec<f64>, f64) {
        let equations = &evaluated.normal.equations;
        let size = equations.places.len();
        let entries = (0..size * size).map(|k| equations.entry(k / size, k % size)).collect();
        (equations.places.clone(), entries, evaluated.residuals.sigma)
    }

    fn assert_same(evaluated: &[EvaluatedPair], fresh: &[EvaluatedPair]) {
        assert_eq!(evaluated.len(), fresh.len());
        for (evaluated, fresh) in evaluated.iter().map(sums).zip(fresh.iter().map(sums)) {
            assert_eq!(evaluated.0, fresh.0);
            let largest = fresh.1.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
            assert!(
                evaluated.1.iter().zip(&fresh.1).all(|(a, b)| (a - b).abs() < 1e-9 * largest)
                    && largest > 0.0
            );
            assert!((evaluated.2 - fresh.2).abs() < 1e-9);
        }
    }

    #[test]
    fn the_next_window_keeps_the_pairs_in_common() {
        let pairs: Vec<FramePair> = [0.0, 1.0, 2.0, 3.0, 4.0].map(pair).into();
        let windows: [Vec<&FramePair>; 2] = [pairs[..4].iter().collect(), pairs[1..].iter().collect()];
        let (mut evaluated, mut fresh) = (Vec::new(), Vec::new());
        evaluate_against(&mut evaluated, &windows[0], &path(-1, 2.0));
        evaluate_against(&mut evaluated, &windows[1], &path(0, 2.0));
        evaluate_against(&mut fresh, &windows[1], &path(0, 2.0));
        assert_same(&evaluated, &fresh);
    }

    #[test]
    fn pairs_are_linearised_anew_where_the_path_is_far() {
        let pairs: Vec<FramePair> = [0.0, 1.0, 2.0].map(pair).into();
        let pairs: Vec<&FramePair> = pairs.iter().collect();
        let (mut evaluated, mut fresh) = (Vec::new(), Vec::new());
        evaluate_against(&mut evaluated, &pairs, &path(-1, 2.0));
        evaluate_against(&mut fresh, &pairs, &path(-1, 5.0));
        evaluate_against(&mut evaluated, &pairs, &path(-1, 5.0));
        assert_same(&evaluated, &fresh);
    }

    #[test]
    fn near_it_the_right_side_and_the_likelihood_follow_the_path() {
        let pairs: Vec<FramePair> = [0.0, 1.0, 2.0].map(pair).into();
        let pairs: Vec<&FramePair> = pairs.iter().collect();
        let (mut kept, mut fresh) = (Vec::new(), Vec::new());
        // Far above all residuals, so that their robust weights are the same.
        let noise = 50.0;
        evaluate_with(noise, &mut kept, &pairs, &path(-1, 2.0));
        let before = kept.clone();
        evaluate_with(noise, &mut kept, &pairs, &path(-1, 2.2));
        evaluate_with(noise, &mut fresh, &pairs, &path(-1, 2.2));
        for ((kept, fresh), mut before) in kept.iter_mut().zip(&mut fresh).zip(before) {
            assert_eq!(sums(kept), sums(&before), "it is kept");
            let off = |one: &EvaluatedPair| -> f64 {
                let square = |(a, b): (&f64, &f64)| (a - b) * (a - b);
                one.right().iter().zip(fresh.right()).map(square).sum::<f64>().sqrt()
            };
            assert!(off(kept) < 0.05 * off(&before), "{} {}", off(kept), off(&before));
            let [now, then, truth] = [kept, &mut before, fresh].map(EvaluatedPair::log_likelihood);
            assert!((now - truth).abs() < 0.05 * (then - truth).abs(), "{now} {then} {truth}");
        }
    }
}
