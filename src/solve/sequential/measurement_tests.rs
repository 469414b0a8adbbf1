// SPDX-License-Identifier: MIT OR Apache-2.0

//! The sparse minimiser against closed forms and against a dense Levenberg–Marquardt of another make.

use super::*;
use crate::robust::loss::{GemanMcClure, Squares};
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn};
use proptest::prelude::*;

/// Points over a 640 × 480 picture, each at its own time, moved by `twist`.
fn exact_matches(twist: Twist) -> Vec<TimedMatch> {
    (0..60)
        .map(|i| {
            let from = Vector2::new(f64::from(i * 97 % 640) - 320.0, f64::from(i * 61 % 480) - 240.0);
            let time = 0.01 + 0.0008 * f64::from(i * 29 % 60);
            TimedMatch { from, to: twist.after(time).apply(from), time }
        })
        .collect()
}

/// Deterministic deviations of some `size` pixels.
fn disturb(matches: &mut [TimedMatch], size: f64) {
    for (i, m) in matches.iter_mut().enumerate() {
        let phase = i as f64;
        m.from += Vector2::new((12.9 * phase).sin(), (78.2 * phase).cos()) * size;
        m.to += Vector2::new((37.7 * phase).cos(), (93.9 * phase).sin()) * size;
    }
}

fn minimise(matches: &[TimedMatch], start: Twist, loss: impl Loss) -> (Twist, f64) {
    let mut minimiser = Minimiser::default();
    let twist = minimiser.minimise(matches, start, loss).unwrap();
    (twist, total_cost(matches, minimiser.corrected(), twist, loss))
}

fn assert_close(a: Twist, b: Twist, tolerance: f64) {
    let difference = (a.to_vector() - b.to_vector()).component_mul(&Vector3::new(300.0, 1.0, 1.0));
    assert!(difference.norm() < tolerance, "{a:?} is not {b:?}");
}

/// 25.4 with all unknowns in one vector: the twist, then every corrected point.
struct Dense {
    matches: Vec<TimedMatch>,
    unknowns: DVector<f64>,
}

impl Dense {
    fn twist(&self) -> Twist {
        Twist::new(self.unknowns[0], self.unknowns[1], self.unknowns[2])
    }

    fn point(&self, i: usize) -> Vector2<f64> {
        Vector2::new(self.unknowns[3 + 2 * i], self.unknowns[4 + 2 * i])
    }
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Dense {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, x: &DVector<f64>) {
        self.unknowns.copy_from(x);
    }

    fn params(&self) -> DVector<f64> {
        self.unknowns.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let mut residuals = DVector::zeros(4 * self.matches.len());
        for (i, m) in self.matches.iter().enumerate() {
            let o = self.point(i);
            residuals.fixed_rows_mut::<2>(4 * i).copy_from(&(o - m.from));
            residuals.fixed_rows_mut::<2>(4 * i + 2).copy_from(&(self.twist().after(m.time).apply(o) - m.to));
        }
        Some(residuals)
    }

    /// By differences: nothing of the sparse code's derivatives is used here.
    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let mut jacobian = DMatrix::zeros(4 * self.matches.len(), self.unknowns.len());
        for column in 0..self.unknowns.len() {
            let step = if column == 0 { 1e-6 } else { 1e-4 };
            let at = |sign: f64| {
                let mut moved = Dense { matches: self.matches.clone(), unknowns: self.unknowns.clone() };
                moved.unknowns[column] += sign * step;
                moved.residuals().unwrap()
            };
            jacobian.set_column(column, &((at(1.0) - at(-1.0)) / (2.0 * step)));
        }
        Some(jacobian)
    }
}

#[test]
fn equals_a_dense_minimiser() {
    for truth in [Twist::new(1.5, 300.0, -200.0), Twist::new(0.0, 0.0, 40.0), Twist::new(-6.0, 900.0, 0.0)] {
        let mut matches = exact_matches(truth);
        disturb(&mut matches, 1.5);
        let start = Twist::from_vector(truth.to_vector() * 0.7 + Vector3::new(0.1, 20.0, -20.0));
        let mut unknowns = DVector::zeros(3 + 2 * matches.len());
        unknowns.fixed_rows_mut::<3>(0).copy_from(&start.to_vector());
        for (i, m) in matches.iter().enumerate() {
            unknowns.fixed_rows_mut::<2>(3 + 2 * i).copy_from(&m.from);
        }
        let (dense, report) =
            LevenbergMarquardt::new().minimize(Dense { matches: matches.clone(), unknowns });
        assert!(report.termination.was_successful(), "{report:?}");
        let (sparse, cost) = minimise(&matches, start, Squares);
        assert_close(sparse, dense.twist(), 1e-3);
        assert!((cost - 2.0 * report.objective_function).abs() < 1e-6 * cost, "{cost} {report:?}");
    }
}

#[test]
fn recovers_an_exact_motion() {
    for truth in [Twist::ZERO, Twist::new(0.0, 800.0, -500.0), Twist::new(4.0, -1000.0, 2000.0)] {
        let (found, cost) = minimise(&exact_matches(truth), Twist::ZERO, Squares);
        assert_close(found, truth, 1e-5);
        assert!(cost < 1e-9, "{cost}");
    }
}

/// With one time for all, a translation that is left over half each of two corrected points: E is
/// half of the squared distance, and the twist that of the closed-form rigid alignment.
#[test]
fn equals_rigid_alignment_at_equal_times() {
    let mut matches = exact_matches(Twist::new(2.0, 100.0, 50.0));
    for m in &mut matches {
        m.time = 0.04;
        m.to = Twist::new(2.0, 100.0, 50.0).after(0.04).apply(m.from);
    }
    disturb(&mut matches, 2.0);
    let count = matches.len() as f64;
    let mean = |f: fn(&TimedMatch) -> Vector2<f64>| matches.iter().map(f).sum::<Vector2<f64>>() / count;
    let (from, to) = (mean(|m| m.from), mean(|m| m.to));
    let (dot, cross) = matches.iter().fold((0.0, 0.0), |(dot, cross), m| {
        let (a, b) = (m.from - from, m.to - to);
        (dot + a.dot(&b), cross + a.perp(&b))
    });
    let angle = cross.atan2(dot);
    let rotation = Matrix2::new(angle.cos(), -angle.sin(), angle.sin(), angle.cos());
    let shift = to - rotation * from;
    let expected: f64 = matches.iter().map(|m| (m.to - rotation * m.from - shift).norm_squared() / 2.0).sum();

    let (found, cost) = minimise(&matches, Twist::ZERO, Squares);
    assert!((found.omega * 0.04 - angle).abs() < 1e-7);
    assert!((found.after(0.04).shift - shift).norm() < 1e-4);
    assert!((cost - expected).abs() < 1e-7 * expected, "{cost} {expected}");
    let by_twist: f64 = matches.iter().map(|m| m.error(found)).sum();
    assert!((by_twist - cost).abs() < 1e-7 * cost, "{by_twist} {cost}");
}

#[test]
fn undetermined_matches_give_nothing() {
    let mut minimiser = Minimiser::default();
    assert_eq!(minimiser.minimise(&[], Twist::ZERO, Squares), None);
    let no_time: Vec<_> =
        exact_matches(Twist::ZERO).into_iter().map(|m| TimedMatch { time: 0.0, ..m }).collect();
    assert_eq!(minimiser.minimise(&no_time, Twist::ZERO, Squares), None);
    let not_finite =
        vec![TimedMatch { from: Vector2::new(f64::NAN, 0.0), to: Vector2::zeros(), time: 0.1 }; 20];
    assert_eq!(minimiser.minimise(&not_finite, Twist::ZERO, Squares), None);
}

proptest! {
    /// The minimum is one: no twist nearby has a lower robust cost.
    #[test]
    fn no_neighbour_is_better(omega in -3.0..3.0, vx in -900.0..900.0, vy in -900.0..900.0, size in 0.1..3.0) {
        let truth = Twist::new(omega, vx, vy);
        let mut matches = exact_matches(truth);
        disturb(&mut matches, size);
        let loss = GemanMcClure(36.0 * size * size);
        let mut minimiser = Minimiser::default();
        let found = minimiser.minimise(&matches, truth, loss).unwrap();
        let cost = |twist: Twist| matches.iter().map(|m| loss.rho(m.error(twist))).sum::<f64>();
        for step in [Vector3::new(1e-3, 0.0, 0.0), Vector3::new(0.0, 0.3, 0.0), Vector3::new(0.0, 0.0, 0.3)] {
            for sign in [-1.0, 1.0] {
                prop_assert!(cost(found) <= cost(Twist::from_vector(found.to_vector() + step * sign)) + 1e-9);
            }
        }
    }
}
