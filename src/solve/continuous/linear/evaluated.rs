//! The pairs of a window, evaluated against the path.
//!
//! The residuals and normal equations of a pair are kept while their inputs are the same. After the evidence
//! of a window was computed, the window of the next frame finds all but its first and last pairs evaluated.

use super::normal::Normal;
use super::pair_residuals::PairResiduals;
use super::residual::Evaluator;
use crate::parallel::*;
use crate::solve::continuous::data::FramePair;
use nalgebra::Vector2;

/// The inputs of the normal equations of a pair, other than the path's coefficients.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Inputs {
    stamps: [f64; 2],
    /// End of the first match, as timestamps may repeat.
    first: Option<Vector2<f64>>,
    gamma: f64,
    kappa: f64,
    /// Whether the path covers the pair before.
    tracks: bool,
}

/// A pair evaluated against the path.
#[derive(Clone, Debug, Default)]
pub struct EvaluatedPair {
    pub residuals: PairResiduals,
    pub normal: Normal,
    /// `None` once the path has changed.
    inputs: Option<Inputs>,
    /// First block of the path when this was evaluated.
    base: i64,
}

/// Invalidates all, as the path has changed.
pub fn invalidate(evaluated: &mut [EvaluatedPair]) {
    evaluated.iter_mut().for_each(|evaluated| evaluated.inputs = None);
}

/// Evaluates successive pairs against a path; those whose inputs are the same are kept.
pub fn evaluate(evaluated: &mut Vec<EvaluatedPair>, pairs: &[&FramePair], evaluator: &Evaluator<'_>) {
    let splines = &evaluator.trajectory.splines;
    let wanted = |(index, pair): (usize, &&FramePair)| Inputs {
        stamps: pair.stamps,
        first: pair.matches.first().map(|m| m.to),
        gamma: evaluator.shutter.gamma,
        kappa: splines.kappa,
        tracks: index > 0,
    };
    let wanted: Vec<Inputs> = pairs.iter().enumerate().map(wanted).collect();
    for one in evaluated.iter_mut() {
        if one.base != splines.base && !one.normal.equations.shift(splines.base - one.base, splines) {
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
    let mut changed: Vec<bool> =
        evaluated.iter().zip(&wanted).map(|(one, wanted)| one.inputs != Some(*wanted)).collect();
    evaluated.par_iter_mut().zip(pairs).zip(&wanted).zip(&changed).for_each(
        |(((one, pair), wanted), is_changed)| {
            if *is_changed {
                evaluator.residuals(pair, wanted.tracks, &mut one.residuals);
                one.normal.estimate_variances(&one.residuals, evaluator.noise);
                (one.inputs, one.base) = (Some(*wanted), splines.base);
            }
        },
    );
    // The first pair has no tracks to separate noise from parallax: it takes the second's variances.
    if let ([first, second, ..], [is_changed, ..]) = (evaluated.as_mut_slice(), changed.as_mut_slice()) {
        *is_changed |= first.normal.variances != second.normal.variances;
        first.normal.variances = second.normal.variances;
    }
    evaluated.par_iter_mut().zip(&changed).for_each(|(one, is_changed)| {
        if *is_changed {
            evaluator.normal(&one.residuals, &mut one.normal);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::correspond::Correspondence;
    use crate::cpu::CpuLevel;
    use crate::motion::generators::GENERATORS;
    use crate::solve::continuous::data::{ScanAxis, Shutter};
    use crate::solve::continuous::trajectory::{BLOCK, KnotDensity, Splines, Trajectory, ratio};
    use nalgebra::Matrix2;

    const RADIUS: f64 = 320.0;

    /// A path over 9 blocks that goes to and fro by this many pixels, the same for the same instants.
    fn path(base: i64, pixels: f64) -> Splines {
        let mut path = Splines { base, coefficients: vec![0.0; 9 * BLOCK], kappa: 0.3 };
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
        let blocks = [path.base as f64, path.base as f64 + 6.0];
        let trajectory = &Trajectory::of(path.clone(), KnotDensity::Usual, RADIUS, blocks);
        let shutter = Shutter { scan_axis: ScanAxis { by_rows: true, length: 1.5 }, gamma: 0.7 };
        let evaluator = Evaluator { cpu: CpuLevel::detect(), trajectory, shutter, noise: 0.1 };
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
    fn pairs_are_kept_until_the_path_changes() {
        let pairs: Vec<FramePair> = [0.0, 1.0, 2.0].map(pair).into();
        let pairs: Vec<&FramePair> = pairs.iter().collect();
        let (mut evaluated, mut fresh) = (Vec::new(), Vec::new());
        evaluate_against(&mut evaluated, &pairs, &path(-1, 2.0));
        evaluate_against(&mut fresh, &pairs, &path(-1, 5.0));
        let before: Vec<_> = evaluated.iter().map(sums).collect();
        evaluate_against(&mut evaluated, &pairs, &path(-1, 5.0));
        assert_eq!(evaluated.iter().map(sums).collect::<Vec<_>>(), before);
        invalidate(&mut evaluated);
        evaluate_against(&mut evaluated, &pairs, &path(-1, 5.0));
        assert_same(&evaluated, &fresh);
    }
}
