// SPDX-License-Identifier: MIT OR Apache-2.0

//! The normal equations of a pair against differences of its residuals.

use super::*;
use crate::correspond::Correspondence;
use crate::cpu::CpuLevel;
use crate::motion::generators::GENERATORS;
use crate::solve::continuous::data::{FramePair, Match, ScanAxis, Track};
use crate::solve::continuous::trajectory::{KnotDensity, Splines, Trajectory, ratio};
use nalgebra::{Matrix2, Vector2};

const RADIUS: f64 = 320.0;
const NOISE: f64 = 0.5;
const STEP: f64 = 1e-4;

/// A camera's path, shutter and κ, as numbers that can be varied.
#[derive(Clone)]
struct Setting {
    path: Splines,
    by_rows: bool,
    readout: f64,
    density: KnotDensity,
}

impl Setting {
    /// Up to a pixel a frame of everything: the slopes are those of small motions.
    fn new(by_rows: bool, readout: f64, density: KnotDensity) -> Self {
        let blocks = 10;
        let mut path = Splines::still(-2, blocks, 0.35);
        for j in 0..GENERATORS {
            for knot in path.knots(j) {
                let place = path.place(j, knot) as usize;
                let time = knot as f64 / ratio(j) as f64;
                path.coefficients[place] = 0.4 * (1.3 * time + 0.7 * j as f64).sin() + 0.2 * time;
            }
        }
        Self { path, by_rows, readout, density }
    }

    /// Calls back with the estimate at which a pair is evaluated.
    fn evaluate<T>(&self, with: impl FnOnce(&Evaluator<'_>) -> T) -> T {
        let trajectory = &Trajectory::of(self.path.clone(), self.density, RADIUS, [-1.0, 5.0]);
        let length = if self.by_rows { 1.5 } else { 2.0 };
        let scan_axis = ScanAxis { by_rows: self.by_rows, length };
        let (cpu, gamma) = (CpuLevel::detect(), self.readout);
        with(&Evaluator { cpu, trajectory, scan_axis, gamma, noise: NOISE })
    }

    /// The residuals of a pair with its tracks, and its normal equations.
    fn sums(&self, pair: &FramePair) -> (PairResiduals, Normal) {
        let (mut residuals, mut normal) = (PairResiduals::default(), Normal::default());
        self.evaluate(|evaluator| {
            evaluator.residuals(pair, true, &mut residuals);
            normal.estimate_variances(&residuals, evaluator.noise);
            evaluator.normal(&residuals, &mut normal);
        });
        (residuals, normal)
    }

    /// Residuals in pixels.
    fn residuals(&self, pair: &FramePair) -> Vec<Vector2<f64>> {
        self.evaluate(|evaluator| {
            let residual = |m: &Match| {
                let [from, to] = evaluator.blocks(pair.stamps, m);
                (m.to - evaluator.trajectory.homographies.carry(m.from, from, to)) * RADIUS
            };
            pair.matches.iter().map(residual).collect()
        })
    }

    /// A pair whose residuals are known in closed form, up to `most` pixels.
    fn pair(&self, most: f64) -> FramePair {
        let nodes = (0..300).map(|node| (node % 20, node / 20));
        let from = nodes.map(|(i, j)| Vector2::new(-0.95 + 0.1 * i as f64, -0.7 + 0.1 * j as f64));
        let pixel = |point: Vector2<f64>| point * RADIUS;
        let found: Vec<Correspondence> = from
            .map(|from| Correspondence {
                from: pixel(from),
                to: pixel(from),
                texture: 1.0,
                residual: 0.0,
                covariance: Matrix2::zeros(),
            })
            .collect();
        let mut pair = FramePair::new(&found, Vector2::zeros(), RADIUS, [0.2, 1.2], None).unwrap();
        self.evaluate(|evaluator| {
            for (k, m) in pair.matches.clone().iter().enumerate() {
                let off = Vector2::new((k as f64 * 1.7).sin(), (k as f64 * 2.9).cos()) * (most / RADIUS);
                let mut to = m.from;
                for _ in 0..20 {
                    let [before, after] = evaluator
                        .blocks(pair.stamps, &Match { from: m.from, to, covariance: Matrix2::zeros() });
                    to = evaluator.trajectory.homographies.carry(m.from, before, after) + off;
                }
                pair.matches[k].to = to;
            }
        });
        pair
    }

    /// The setting with `by` added to a direction in the space of unknowns.
    fn moved(&self, direction: Direction, by: f64) -> Self {
        let mut moved = self.clone();
        match direction {
            Direction::Path(seed) => {
                let steps = self.wobble(seed);
                moved.path.coefficients.iter_mut().zip(steps).for_each(|(value, step)| *value += by * step);
            }
            Direction::Readout => moved.readout += by,
            Direction::Kappa => moved.path.kappa += by,
        }
        moved
    }

    /// A change of all coefficients, up to about a cycle in two blocks.
    fn wobble(&self, seed: usize) -> Vec<f64> {
        let mut wobble = vec![0.0; self.path.coefficients.len()];
        for j in 0..GENERATORS {
            for knot in self.path.knots(j) {
                let time = knot as f64 / ratio(j) as f64;
                wobble[self.path.place(j, knot) as usize] =
                    ((2.0 + seed as f64) * time + (j * j) as f64).sin();
            }
        }
        wobble
    }

    /// Derivative of the predicted displacements along a direction.
    fn jacobian(&self, pair: &FramePair, direction: Direction) -> Vec<Vector2<f64>> {
        let [less, more] = [-STEP, STEP].map(|by| self.moved(direction, by).residuals(pair));
        less.iter().zip(&more).map(|(less, more)| (less - more) / (2.0 * STEP)).collect()
    }
}

#[derive(Clone, Copy, Debug)]
enum Direction {
    Path(usize),
    Readout,
    Kappa,
}

const DIRECTIONS: [Direction; 4] =
    [Direction::Path(0), Direction::Path(1), Direction::Readout, Direction::Kappa];

/// Product of the normal equations' matrix with two directions, and of their right side with one.
fn forms(setting: &Setting, normal: &Normal, a: Direction, b: Direction) -> (f64, f64) {
    let equations = &normal.equations;
    let own = |seed: usize| -> Vec<f64> {
        let wobble = setting.wobble(seed);
        equations.places.iter().map(|place| wobble[*place]).collect()
    };
    let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    let index = |direction: Direction| usize::from(matches!(direction, Direction::Kappa));
    let matrix = match (a, b) {
        (Direction::Path(a), Direction::Path(b)) => {
            let (a, b) = (own(a), own(b));
            let cells = (0..a.len()).flat_map(|i| (0..a.len()).map(move |j| (i, j)));
            cells.map(|(i, j)| a[i] * equations.entry(i, j) * b[j]).sum()
        }
        (Direction::Path(seed), other) | (other, Direction::Path(seed)) => {
            dot(&equations.sides[1 + index(other)], &own(seed))
        }
        (a, b) => normal.shared[(index(a), index(b))],
    };
    let right = match a {
        Direction::Path(seed) => dot(&equations.sides[0], &own(seed)),
        other => normal.shared_right[index(other)],
    };
    (matrix, right)
}

#[test]
fn the_normal_equations_are_those_of_the_residuals() {
    for (by_rows, readout, density) in [
        (true, 0.8, KnotDensity::Usual),
        (false, -0.6, KnotDensity::Usual),
        (true, 0.6, KnotDensity::Vibrating),
    ] {
        let setting = Setting::new(by_rows, readout, density);
        let pair = setting.pair(1.0);
        let (evaluated, normal) = setting.sums(&pair);
        let residuals = setting.residuals(&pair);
        // Student's t with four degrees of freedom: weight (4 + 2)/(4 + r²/σ²)/σ², a pair counting as 25,
        // times the probability that a match shows the scene.
        let variance = evaluated.sigma * evaluated.sigma;
        let weight = |r: &Vector2<f64>| {
            let square = r.norm_squared() / variance;
            let scene = Mixture::<4>::new(0.9, variance.recip(), evaluated.others).inlier_probability(square);
            25.0 / 300.0 / variance * 6.0 / (4.0 + square) * scene
        };
        let sum = |a: &[Vector2<f64>], b: &[Vector2<f64>]| -> f64 {
            residuals.iter().zip(a.iter().zip(b)).map(|(r, (a, b))| weight(r) * a.dot(b)).sum()
        };
        for a in DIRECTIONS {
            let along = setting.jacobian(&pair, a);
            let size = sum(&along, &along).sqrt();
            let norm = sum(&residuals, &residuals).sqrt();
            for b in DIRECTIONS {
                let other = setting.jacobian(&pair, b);
                let scale = size * sum(&other, &other).sqrt();
                let (matrix, _) = forms(&setting, &normal, a, b);
                let off = (matrix - sum(&along, &other)) / scale;
                // Slopes are rounded to the middle of a band and to half a step of the flow.
                assert!(off.abs() < 0.04, "{by_rows} {readout} {density:?}: {a:?} {b:?} {off}");
            }
            let (_, right) = forms(&setting, &normal, a, a);
            let off = (right - sum(&along, &residuals)) / (size * norm);
            assert!(off.abs() < 0.02, "{by_rows} {readout} {density:?}: {a:?} {off}");
        }
    }
}

#[test]
fn all_instructions_add_up_the_same() {
    let setting = Setting::new(true, 0.8, KnotDensity::Usual);
    let (residuals, normal) = setting.sums(&setting.pair(1.0));
    let found: Vec<Vec<f64>> = CpuLevel::supported()
        .map(|cpu| {
            let mut normal = normal.clone();
            setting.evaluate(|evaluator| Evaluator { cpu, ..*evaluator }.normal(&residuals, &mut normal));
            let size = normal.equations.places.len();
            let entries = (0..size * size).map(|k| normal.equations.entry(k / size, k % size));
            let sides = normal.equations.sides.iter().flatten().copied();
            entries.chain(sides).chain(normal.shared.iter().chain(&normal.shared_right).copied()).collect()
        })
        .collect();
    // Sums of products are rounded once or twice.
    let largest = found[0].iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    let is_same = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-12 * largest;
    assert!(largest > 0.0);
    for two in found.windows(2) {
        assert!(two[0].len() == two[1].len() && two[0].iter().zip(&two[1]).all(is_same));
    }
}

#[test]
fn the_normal_equations_of_tracks_are_those_of_innovations() {
    let setting = Setting::new(true, 0.8, KnotDensity::Usual);
    let mut pair = setting.pair(0.01);
    // The points came to where they set out from where the path has them one frame before.
    setting.evaluate(|evaluator| {
        for index in 0..pair.matches.len() {
            let to = pair.matches[index].from;
            let (mut before, stamps) = (Match { from: to, to, covariance: Matrix2::zeros() }, [-0.8, 0.2]);
            for _ in 0..20 {
                let [start, end] = evaluator.blocks(stamps, &before);
                before.from = evaluator.trajectory.homographies.carry(to, end, start);
            }
            pair.tracks[index] = Some(Track { before, stamps, is_dominant: true });
        }
    });
    let (mut residuals, mut normal) = setting.sums(&pair);
    let variances = ResidualVariances { noise: 0.25, depth: 0.25 };
    setting.evaluate(|evaluator| {
        // Residuals are too small for the parallax to be estimated.
        evaluator.residuals_before(&pair, &mut residuals);
        normal.variances = variances;
        evaluator.normal(&residuals, &mut normal);
    });
    let innovations: Vec<Innovation> = residuals
        .matches
        .iter()
        .zip(&residuals.before)
        .map(|(own, before)| variances.innovation(own, before.as_ref()))
        .collect();
    assert!(innovations.iter().any(|new| new.gain.norm() > 0.2), "the residual before counts");
    let mut old = pair.clone();
    old.matches = pair.tracks.iter().flatten().map(|track| track.before).collect();
    old.stamps = [-0.8, 0.2];
    let slopes = |direction: Direction| -> Vec<Vector2<f64>> {
        let both = setting.jacobian(&pair, direction).into_iter().zip(setting.jacobian(&old, direction));
        both.zip(&innovations).map(|((now, before), new)| now - new.gain * before).collect()
    };
    let weighted = |a: &[Vector2<f64>], b: &[Vector2<f64>]| -> f64 {
        // Residuals are about zero: 6/4 of Student's t, a pair counting as 25.
        let probable = |new: &Innovation, own: &MatchResidual| {
            let scale = new.weight.determinant().sqrt() * own.whitening.determinant();
            let scene = own.prior * scale * (1.0 + new.square() / 4.0).powi(-3);
            scene / (scene + (1.0 - own.prior) / residuals.others)
        };
        let weighted =
            innovations.iter().zip(&residuals.matches).map(|(new, own)| new.weight * probable(new, own));
        let terms = a.iter().zip(b).zip(weighted).map(|((a, b), weight)| a.dot(&(weight * b)));
        25.0 / 300.0 * 1.5 * terms.sum::<f64>()
    };
    for a in DIRECTIONS {
        let along = slopes(a);
        for b in DIRECTIONS {
            let other = slopes(b);
            let scale = (weighted(&along, &along) * weighted(&other, &other)).sqrt();
            let (matrix, _) = forms(&setting, &normal, a, b);
            let off = (matrix - weighted(&along, &other)) / scale;
            assert!(off.abs() < 0.04, "{a:?} {b:?} {off}");
        }
        let errors: Vec<Vector2<f64>> = innovations.iter().map(|new| new.error).collect();
        let (_, right) = forms(&setting, &normal, a, a);
        let scale = (weighted(&along, &along) * weighted(&errors, &errors)).sqrt();
        let off = (right - weighted(&along, &errors)) / scale;
        assert!(off.abs() < 0.02, "{a:?} {off}");
    }
}

#[test]
fn sigma_is_that_of_a_coordinate_and_outliers_are_counted() {
    let setting = Setting::new(true, 0.7, KnotDensity::Usual);
    let mut pair = setting.pair(1.0);
    // Squares of residuals are sin² + cos² with a median of 1: variance 1/(2 ln 2).
    let (residuals, _) = setting.sums(&pair);
    assert!((residuals.sigma - 0.849).abs() < 0.03 && residuals.inliers == 300, "{}", residuals.sigma);
    for m in pair.matches.iter_mut().step_by(3) {
        m.to.x += 0.2;
    }
    let (residuals, _) = setting.sums(&pair);
    assert!(residuals.sigma < 1.3 && residuals.inliers == 200, "{} {}", residuals.sigma, residuals.inliers);
}

#[test]
fn thinned_out_matches_are_counted_all_the_same() {
    let at = |k: usize| Vector2::new((k % 40) as f64 * 16.0, (k / 40) as f64 * 12.0);
    let found = |count: usize| -> Vec<Correspondence> {
        let found = |k| Correspondence {
            from: at(k),
            to: at(k),
            texture: 1.0,
            residual: 0.0,
            covariance: Matrix2::zeros(),
        };
        (0..count).map(found).collect()
    };
    let pair = |count| FramePair::new(&found(count), Vector2::new(319.5, 239.5), RADIUS, [0.0, 1.0], None);
    assert!(pair(15).is_none() && pair(16).is_some());
    let many = pair(1600).unwrap();
    assert_eq!((many.matches.len(), many.count()), (400, 1600));
    assert_eq!(many.moved(), 0.0);
    let mut still = Setting::new(true, 0.7, KnotDensity::Usual);
    still.path.coefficients.fill(0.0);
    let (residuals, _) = still.sums(&many);
    assert_eq!((residuals.inliers, residuals.sigma), (1600, NOISE));
}

#[test]
fn a_place_along_the_axis_is_its_line_s_share_of_the_readout() {
    // Pixel row 0 of 480 lies at −239.5 pixels from the centre.
    let rows = ScanAxis { by_rows: true, length: 480.0 / RADIUS };
    let columns = ScanAxis { by_rows: false, length: 640.0 / RADIUS };
    let first = Vector2::new(-319.5, -239.5) / RADIUS;
    assert!(
        (rows.place(first) - 0.5 / 480.0).abs() < 1e-12 && (columns.place(first) - 0.5 / 640.0).abs() < 1e-12
    );
    assert_eq!(rows.place(Vector2::zeros()), 0.5);
}

#[test]
fn to_fit_two_thirds_of_the_matches_well_is_likelier_than_to_fit_all_badly() {
    let log = |distance: f64, sigma: f64| {
        Mixture::<FREEDOM>::new(0.9, sigma.powi(-2), 100.0).log_density((distance / sigma).powi(2))
    };
    // Two thirds of them within 0.2 px, the others 20 px off; or all of them 3 px off.
    let two_thirds = (2.0 * log(0.2, 0.2) + log(20.0, 0.2)) / 3.0;
    assert!(two_thirds > log(3.0, 3.0) + 0.5, "{two_thirds}");
}
