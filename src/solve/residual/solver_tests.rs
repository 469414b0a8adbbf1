// SPDX-License-Identifier: MIT OR Apache-2.0

//! The residual field against motions in closed form.

use super::super::path::Still;
use super::*;

use crate::flow::Cell;
use crate::readout::{ReadoutDirection, ReadoutTime};
use crate::solve::random::Random;
use nalgebra::{Matrix3, Vector2};

/// An invalid path.
struct InvalidPath;

impl Path for InvalidPath {
    fn until(&self, _: f64) -> Matrix3<f64> {
        Matrix3::identity() * f64::NAN
    }

    fn back(&self, _: f64) -> Matrix3<f64> {
        Matrix3::zeros()
    }
}

const PERIOD: f64 = 0.04;
const READOUT: f64 = 0.03;
const COLUMNS: usize = 80;
const SIDE: f64 = 8.0;

fn readout() -> Readout {
    Readout::new(640, 480, ReadoutDirection::TopToBottom, ReadoutTime::Seconds(READOUT), PERIOD).unwrap()
}

/// The flow to a neighbour of points that move from `at`, exposed at t, by `moved`(at, t, t′) until t′;
/// confidence and information of each cell from `known`.
fn flow(
    interval: f64,
    moved: impl Fn(Vector2<f64>, f64, f64) -> Vector2<f64>,
    known: impl Fn(Vector2<f64>) -> (f32, [f32; 3]),
) -> FlowField {
    let readout = readout();
    let cell = |index: usize| {
        let at = place(index);
        let mut there = at;
        for _ in 0..30 {
            let time = interval + readout.offset(there.x, there.y);
            there = at + moved(at, readout.offset(at.x, at.y), time);
        }
        let (confidence, information) = known(at);
        Cell { flow: (there - at).cast::<f32>().into(), confidence, information }
    };
    FlowField::new(COLUMNS, SIDE, (0..COLUMNS * 60).map(cell).collect()).unwrap()
}

/// The centre of a cell by its index.
fn place(index: usize) -> Vector2<f64> {
    Vector2::new((index % COLUMNS) as f64 + 0.5, (index / COLUMNS) as f64 + 0.5) * SIDE
        - Vector2::new(0.5, 0.5)
}

const SURE: (f32, [f32; 3]) = (1.0, [50.0, 0.0, 50.0]);

/// The field over a still global path, from both neighbours.
fn solved(
    moved: impl Fn(Vector2<f64>, f64, f64) -> Vector2<f64> + Copy,
    known: impl Fn(Vector2<f64>) -> (f32, [f32; 3]) + Copy,
) -> (CellVelocities, Vec<Region>) {
    let [before, after] = [-PERIOD, PERIOD].map(|interval| flow(interval, moved, known));
    let flows =
        [FrameFlow { field: &before, interval: -PERIOD }, FrameFlow { field: &after, interval: PERIOD }];
    let mut solver = ResidualSolver::default();
    let cells = solver.solve(&readout(), &flows, &Still).clone();
    (cells, solver.regions().to_vec())
}

fn worst(cells: &CellVelocities, truth: impl Fn(Vector2<f64>) -> Option<Vector2<f64>>) -> f64 {
    let errors = cells.velocities.iter().enumerate().filter_map(|(index, [x, y])| {
        Some((Vector2::new(f64::from(*x), f64::from(*y)) - truth(place(index))?).norm())
    });
    errors.fold(0.0, f64::max)
}

#[test]
fn a_uniform_velocity_is_found_everywhere() {
    let velocity = Vector2::new(200.0, -90.0);
    let (cells, regions) = solved(|_, from, to| velocity * (to - from), |_| SURE);
    assert_eq!((cells.columns, cells.rows, cells.side), (COLUMNS, 60, SIDE));
    let error = worst(&cells, |_| Some(velocity * READOUT));
    assert!(error < 0.02, "{error}");
    assert_eq!(regions.len(), REGIONS[0] * REGIONS[1]);
    for region in regions {
        assert!((region.velocity - velocity * READOUT).norm() < 0.02 && region.error < 0.02, "{region:?}");
    }
}

#[test]
fn contradicting_neighbours_raise_the_expected_error() {
    // In the left half points reverse in the middle of the three frames: the two flows measure v and −v.
    let velocity = Vector2::new(300.0, 0.0);
    let moved = |at: Vector2<f64>, from: f64, to: f64| {
        if at.x < 320.0 { velocity * (to - from).abs() } else { velocity * (to - from) }
    };
    let (_, regions) = solved(moved, |_| SURE);
    let [columns, rows] = REGIONS;
    for (index, region) in regions.iter().enumerate() {
        // Measurements of v and −v have residuals of v each, for the time until the middle of the readout.
        let late = ((index / columns) as f64 + 0.5) / rows as f64 - 0.5;
        let wrong = (velocity.x * READOUT * late).powi(2);
        if index % columns < columns / 2 {
            assert!(
                region.error > 0.7 * wrong && region.error < 1.5 * wrong + 1.0,
                "{index}: {region:?} {wrong}"
            );
        } else {
            assert!(region.error < 0.1, "{index}: {region:?}");
        }
    }
}

#[test]
fn a_depth_edge_is_kept() {
    let velocity = |at: Vector2<f64>| Vector2::new(if at.x < 320.0 { 0.0 } else { 400.0 }, 0.0);
    let (cells, _) = solved(|at, from, to| velocity(at) * (to - from), |_| SURE);
    let error = worst(&cells, |at| Some(velocity(at) * READOUT));
    assert!(error < 0.4, "{error}");
}

#[test]
fn a_constant_acceleration_is_measured() {
    // x(t) = ½·a·t² about the middle of the readout, where the point is shown.
    let middle = 0.5 * READOUT;
    let along = |t: f64| 0.5 * 9000.0 * (t - middle).powi(2);
    let (cells, _) = solved(|_, from, to| Vector2::new(along(to) - along(from), 0.0), |_| SURE);
    let readout = readout();
    let error = worst(&cells, |at| {
        let from = readout.offset(at.x, at.y);
        // Near the middle the velocity is a displacement over a very short time.
        let apart = middle - from;
        (apart.abs() > 0.1 * READOUT)
            .then(|| Vector2::new((along(middle) - along(from)) / apart * READOUT, 0.0))
    });
    assert!(error < 0.2, "{error}");
}

#[test]
fn unmeasured_cells_follow_their_neighbours_and_the_path() {
    let velocity = Vector2::new(100.0, 0.0);
    // In the left half an outlier of no confidence; a hole of six cells in the right half.
    let moved = |at: Vector2<f64>, from: f64, to: f64| {
        if at.x < 320.0 { Vector2::new(0.0, 900.0) * (to - from) } else { velocity * (to - from) }
    };
    let is_hole = |at: Vector2<f64>| (at - Vector2::new(480.0, 240.0)).amax() < 24.0;
    let known = |at: Vector2<f64>| if at.x < 320.0 || is_hole(at) { (0.0, [0.0; 3]) } else { SURE };
    let (cells, _) = solved(moved, known);
    let right = worst(&cells, |at| (at.x > 330.0).then(|| velocity * READOUT));
    // A hole is filled from its neighbours.
    assert!(right < 1.0, "{right}");
    // Half a frame from all measurements the steps have half the variance of the velocities: the path counts a third.
    let [x, y] = cells.velocities[30 * COLUMNS];
    assert!((x - 2.0).abs() < 0.1 && y.abs() < 0.1, "{x} {y}");
    assert!(cells.velocities.iter().all(|[_, y]| y.abs() < 0.1));
}

#[test]
fn along_an_edge_the_path_decides() {
    // The flow jumps along horizontal boards, whose gradients are vertical.
    let moved = |at: Vector2<f64>, from: f64, to: f64| {
        let along = if (at.x / 40.0) as i64 % 2 == 0 { 150.0 } else { -150.0 };
        Vector2::new(along, 30.0) * (to - from)
    };
    let (cells, _) = solved(moved, |_| (1.0, [0.0, 0.0, 50.0]));
    assert!(cells.velocities.iter().all(|[x, y]| x.abs() < 1e-3 && (y - 0.9).abs() < 0.05));
}

#[test]
fn the_variance_of_velocities_is_found_beneath_that_of_their_measurement() {
    let mut random = Random(3);
    let mut normal = |deviation: f64| (deviation * random.normal()) as f32;
    for deviation in [0.3, 2.0] {
        // Some are measured along one axis only.
        let mut measured = |deviations: [f64; 2]| {
            let [xx, yy] = deviations.map(|one| (one * one).recip() as f32);
            VelocityEstimate::new([xx, 0.0, yy], deviations.map(|one| normal(deviation) + normal(one)))
        };
        let cells: Vec<VelocityEstimate> = (0..1000)
            .flat_map(|_| [measured([0.2, 1e4]), measured([2.0, 0.5]), measured([0.3, 0.3])])
            .collect();
        let found = f64::from(variance(CpuLevel::detect(), &cells)).sqrt();
        assert!((found / deviation - 1.0).abs() < 0.06, "{found} instead of {deviation}");
    }
}

#[test]
fn without_flow_there_is_no_field() {
    let mut solver = ResidualSolver::default();
    let empty = FlowField::default();
    let none = [FrameFlow { field: &empty, interval: PERIOD }];
    assert!(solver.solve(&readout(), &none, &Still).velocities.is_empty());
    assert!(solver.regions().is_empty());
    assert!(solver.solve(&readout(), &[], &Still).velocities.is_empty());
    // An invalid path gives zero, not NaN.
    let wild = flow(PERIOD, |_, _, _| Vector2::new(f64::NAN, 1e300), |_| SURE);
    let flows = [FrameFlow { field: &wild, interval: PERIOD }];
    let cells = solver.solve(&readout(), &flows, &InvalidPath);
    assert!(cells.velocities.iter().flatten().all(|value| *value == 0.0));
}

#[test]
fn a_vibration_explained_by_the_path_leaves_no_residual() {
    /// An oscillation of 2.3 cycles per readout.
    struct Vibration;

    fn shift(time: f64) -> f64 {
        7.0 * (2.3 * std::f64::consts::TAU * time / READOUT).sin()
    }

    impl Path for Vibration {
        fn until(&self, time: f64) -> Matrix3<f64> {
            Matrix3::new_translation(&Vector2::new(shift(time), 0.0))
        }

        fn back(&self, time: f64) -> Matrix3<f64> {
            Matrix3::new_translation(&Vector2::new(-shift(time), 0.0))
        }
    }

    let moved = |_: Vector2<f64>, from: f64, to: f64| Vector2::new(shift(to) - shift(from), 0.0);
    let after = flow(PERIOD, moved, |_| SURE);
    let flows = [FrameFlow { field: &after, interval: PERIOD }];
    let mut solver = ResidualSolver::default();
    let cells = solver.solve(&readout(), &flows, &Vibration);
    assert!(cells.velocities.iter().all(|[x, y]| x.hypot(*y) < 0.02));
}

#[test]
fn a_very_short_readout_has_a_very_small_error() {
    // Information across an edge only, each neighbour some 10⁴ readouts away: the information in the other
    // direction is lost to rounding in f32.
    let readout =
        Readout::new(640, 480, ReadoutDirection::TopToBottom, ReadoutTime::Seconds(8e-5 * PERIOD), PERIOD);
    let still = flow(PERIOD, |_, _, _| Vector2::zeros(), |_| (1.0, [3000.0, 9000.0, 27000.0]));
    let flows = [FrameFlow { field: &still, interval: PERIOD }];
    let mut solver = ResidualSolver::default();
    solver.solve(&readout.unwrap(), &flows, &Still);
    let worst = solver.regions().iter().map(|region| region.error).fold(0.0, f64::max);
    assert!(worst < 0.01, "{worst} px²");
}
