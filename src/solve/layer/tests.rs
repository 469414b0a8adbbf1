//! The layer against motions written down in closed form.

use super::*;
use crate::readout::{ReadoutDirection, ReadoutTime};

const PERIOD: f64 = 0.04;
const READOUT: f64 = 0.03;

fn readout(time: f64) -> Readout {
    Readout::new(640, 480, ReadoutDirection::TopToBottom, ReadoutTime::Seconds(time), PERIOD)
}

/// The middles of `columns` × `rows` cells.
fn grid(columns: usize, rows: usize) -> impl Iterator<Item = Vector2<f64>> {
    let cell = Vector2::new(640.0 / columns as f64, 480.0 / rows as f64);
    (0..columns * rows).map(move |index| {
        let place = Vector2::new((index % columns) as f64 + 0.5, (index / columns) as f64 + 0.5);
        place.component_mul(&cell).add_scalar(-0.5)
    })
}

/// Where a neighbour sees points that move from `at`, exposed at t, to `at` + `moved`(at, t, t′) at t′.
fn seen(
    points: impl Iterator<Item = Vector2<f64>>,
    interval: f64,
    moved: impl Fn(Vector2<f64>, f64, f64) -> Vector2<f64>,
) -> Vec<Correspondence> {
    let readout = readout(READOUT);
    let see = |at: Vector2<f64>| {
        let mut there = at;
        for _ in 0..30 {
            let time = interval + readout.offset(there.x, there.y);
            there = at + moved(at, readout.offset(at.x, at.y), time);
        }
        let (from, to) = if interval > 0.0 { (at, there) } else { (there, at) };
        Correspondence { from, to, texture: 1000.0, residual: 0.0 }
    };
    points.map(see).collect()
}

/// The frame pixel of a node by its index.
fn place(mesh: &VelocityMesh, index: usize) -> Vector2<f64> {
    Vector2::new((index % mesh.columns) as f64, (index / mesh.columns) as f64) * mesh.spacing
}

/// The layer over a global path that stands still.
fn solved(
    cells: (usize, usize),
    moved: impl Fn(Vector2<f64>, f64, f64) -> Vector2<f64> + Copy,
) -> VelocityMesh {
    let [before, after] = [-PERIOD, PERIOD].map(|interval| seen(grid(cells.0, cells.1), interval, moved));
    let neighbours = [
        Neighbour { correspondences: &before, interval: -PERIOD },
        Neighbour { correspondences: &after, interval: PERIOD },
    ];
    Layer::new(640, 480, 1.0).solve(&readout(READOUT), &neighbours, |point, _, _| point).clone()
}

#[test]
fn a_uniform_velocity_is_found_everywhere() {
    let velocity = Vector2::new(200.0, -90.0);
    let mesh = solved((32, 24), |_, from, to| velocity * (to - from));
    assert_eq!((mesh.columns, mesh.rows, mesh.velocities.len()), (81, 61, 81 * 61));
    for found in &mesh.velocities {
        assert!((found.cast() - velocity * READOUT).norm() < 1e-2, "{found}");
    }
}

#[test]
fn an_edge_stays_an_edge() {
    let velocity = |at: Vector2<f64>| Vector2::new(if at.x < 320.0 { 0.0 } else { 400.0 }, 0.0);
    let mesh = solved((80, 60), |at, from, to| velocity(at) * (to - from));
    for (index, found) in mesh.velocities.iter().enumerate() {
        let at = place(&mesh, index);
        if (at.x - 320.0).abs() > mesh.spacing {
            assert!((found.cast() - velocity(at) * READOUT).norm() < 0.15, "{at} {found}");
        }
    }
}

#[test]
fn acceleration_counts_from_the_exposure_to_the_middle() {
    let acceleration = Vector2::new(4000.0, 0.0);
    let mesh = solved((32, 24), |_, from, to| acceleration * (to * to - from * from) / 2.0);
    for (index, found) in mesh.velocities.iter().enumerate() {
        let exposed = readout(READOUT).offset(0.0, place(&mesh, index).y);
        let expected = acceleration * (exposed + READOUT / 2.0) / 2.0;
        // A plain mean of both neighbours is wrong by 0.9 in the first row and the last.
        assert!((found.cast() - expected * READOUT).norm() < 0.2, "{found} {expected}");
    }
}

#[test]
fn what_is_only_noise_is_damped() {
    let noise = |at: Vector2<f64>, to: f64| {
        let phase = at.x * 12.9898 + at.y * 78.233 + to * 1e4;
        Vector2::new((phase.sin() * 43_758.545).fract(), (phase.cos() * 24_634.634).fract()) * 0.2
    };
    let mesh = solved((32, 24), |at, _, to| noise(at, to.signum()));
    let power = mesh.velocities.iter().map(|v| f64::from(v.norm_squared())).sum::<f64>();
    let rms = (power / mesh.velocities.len() as f64).sqrt();
    // Each of the two coordinates has a standard deviation of 0.2/√3 px in PERIOD.
    let single = 0.2 * (2.0f64 / 3.0).sqrt() * READOUT / PERIOD;
    assert!(rms < 0.4 * single, "{rms} of {single}");
}

#[test]
fn what_is_left_is_what_path_and_layer_do_not_explain() {
    let parted = |at: Vector2<f64>| Vector2::new(if at.x < 320.0 { 0.0 } else { 400.0 }, 0.0);
    let [before, together] = [-PERIOD, PERIOD]
        .map(|interval| seen(grid(32, 24), interval, |at, from, to| parted(at) * (to - from)));
    let scattered = seen(grid(32, 24), PERIOD, |at, _, _| {
        let phase = at.x * 12.9898 + at.y * 78.233;
        Vector2::new((phase.sin() * 43_758.545).fract(), (phase.cos() * 24_634.634).fract()) * 40.0
    });
    let mut layer = Layer::new(640, 480, 1.0);
    let mut left = |neighbours: &[Neighbour<'_>]| {
        layer.solve(&readout(READOUT), neighbours, |point, _, _| point);
        layer.left()
    };
    let before = Neighbour { correspondences: &before, interval: -PERIOD };
    let after = |correspondences| Neighbour { correspondences, interval: PERIOD };
    // A coordinate of a path that stands still is up to 16 px wrong.
    assert!(left(&[before, after(&together)]) < 0.05);
    assert!(left(&[before, after(&scattered)]) > 10.0);
    assert_eq!(left(&[]), f64::INFINITY);
}

#[test]
fn it_fades_where_nothing_was_found() {
    let velocity = Vector2::new(400.0, 0.0);
    let after = seen(grid(32, 24).filter(|at| at.x < 300.0), PERIOD, |_, from, to| velocity * (to - from));
    let neighbours = [Neighbour { correspondences: &after, interval: PERIOD }];
    let mut layer = Layer::new(640, 480, 1.0);
    let mesh = layer.solve(&readout(READOUT), &neighbours, |point, _, _| point);
    let at = |x: usize| f64::from(mesh.velocities[30 * mesh.columns + x / 8].x);
    assert!((at(200) - 12.0).abs() < 1e-2);
    assert!(at(320) > at(328) && at(328) > 0.0);
    assert_eq!(at(480), 0.0);
}

#[test]
fn nonsense_leaves_zeros() {
    let nowhere = Vector2::new(f64::NAN, 1e300);
    let broken = Correspondence { from: nowhere, to: nowhere, texture: 1.0, residual: 0.0 };
    let mut layer = Layer::new(640, 480, 1.0);
    let good = seen(grid(32, 24), PERIOD, |_, from, to| Vector2::new(100.0, 0.0) * (to - from));
    let after = Neighbour { correspondences: &good, interval: PERIOD };
    for (time, neighbours) in [
        (READOUT, vec![]),
        (READOUT, vec![Neighbour { correspondences: &[broken], interval: PERIOD }]),
        (READOUT, vec![Neighbour { interval: 0.0, ..after }]),
        (READOUT, vec![Neighbour { interval: f64::NAN, ..after }]),
        (0.0, vec![after]),
    ] {
        let mesh = layer.solve(&readout(time), &neighbours, |point, _, _| point);
        assert!(mesh.velocities.iter().all(|velocity| *velocity == Vector2::zeros()));
    }
}

#[test]
fn what_is_no_measurement_changes_nothing() {
    let moved = |_: Vector2<f64>, from: f64, to: f64| Vector2::new(90.0, -30.0) * (to - from);
    let after = seen(grid(32, 24), PERIOD, moved);
    let solve = |correspondences: &[Correspondence]| {
        let neighbours = [Neighbour { correspondences, interval: PERIOD }];
        let mut layer = Layer::new(640, 480, 1.0);
        let mesh = layer.solve(&readout(READOUT), &neighbours, |point, _, _| point).clone();
        (mesh.velocities, layer.left())
    };
    let sound = solve(&after);
    let spoil: [fn(&mut Correspondence); 5] = [
        |broken| broken.residual = f32::NAN,
        |broken| broken.texture = f32::INFINITY,
        |broken| broken.to.x = f64::NAN,
        |broken| broken.to.y = f64::NEG_INFINITY,
        |broken| broken.to.x = 1e200,
    ];
    for spoil in spoil {
        let mut broken = after.clone();
        broken.extend(after.iter().step_by(9).map(|sound| {
            let mut broken = *sound;
            spoil(&mut broken);
            broken
        }));
        assert!(solve(&broken) == sound);
    }
}
