// SPDX-License-Identifier: MIT OR Apache-2.0

//! What keeps the shown window inside the picture: the least that has to be added to a plan.
//!
//! Each point of a frame's edges limits how the frame may be placed; where it comes in too far by b, ρ·b² is added to what the
//! plan makes least. A change of the plan is then the plan's own plus a correction ε, which has the plan's equations with the
//! right side 0 and the limits that are met:
//!
//! > Σ |ε|²·h + μ·Σ |ε̈|²·h + ρ·Σ b²·h → least, b = b₀ − n·ε > 0,
//!
//! n what each coordinate moves the point outwards. It is solved by Newton's method: which limits are met is taken from the
//! solution before, until they stay the same. It starts from those which the guess of the plan meets, so that often one solution
//! is enough.
//!
//! The correction makes room as a camera does that turns: by shift, with the tilt that belongs to it, and roll. Of a zoom it
//! makes little use: it would take from the picture what the window is to keep. Shears and other tilts are left as the plan has them.

use super::band::{Row, solve};
use super::logarithm::Coordinates;
use super::plan::PlanRow;
use nalgebra::{SMatrix, SVector};

/// Seconds τ in which the path turns around at a limit: ρ = μ/τ⁴. It is shorter than a shake that is seen, a frame or two. From
/// 0.025 to 0.04 s the jitter of shaken sequences is the same within 2 % in the mean. With half of it, Newton's method takes more
/// solutions than there are, with twice of it the path gives way beyond what the margin allows: 20 % and 8 % more jitter.
const TURN: f64 = 0.032;
/// How readily room is made by a zoom, relative to a shift that moves the points of the picture as far. With twice of it, there is
/// 8 % less jitter in the mean, but the window is narrower by up to 7 % in the mean of a sequence instead of 3 %; with half of it, 20 %
/// more jitter, nearly all where the path of the scene zooms.
const ZOOM: f64 = 0.02;
/// Tilt with a shift by one radius that is the most to be believed, that of a field of view of 110°: 1/f² with the focal length
/// in radii.
const MOST_TILT: f64 = 2.0;
/// Solutions, at most. Of the plans of shaken sequences half take one; begun with no limits, 90 frames take 16. With half of it, the jitter
/// is the same, with a quarter up to a fifth more where few later frames are known.
const SOLUTIONS: usize = 20;
/// Coordinates of a correction: shift (2), roll, zoom.
const WAYS: usize = 4;

type Part = SVector<f64, WAYS>;

/// The ways in which corrections are made, as columns of coordinates.
#[derive(Clone, Copy, Debug)]
pub struct Ways(SMatrix<f64, 8, WAYS>);

impl Ways {
    /// For the motions from frame to frame of a scene, and the height of the picture as a share of its width.
    pub fn new(motions: impl Iterator<Item = Coordinates>, aspect: f64) -> Self {
        // A turn of the camera by θ shifts by f·θ and tilts by −θ/f.
        let (mut both, mut shift) = (0.0, f64::MIN_POSITIVE);
        for motion in motions {
            both += motion[2] * motion[6] + motion[5] * motion[7];
            shift += motion[2] * motion[2] + motion[5] * motion[5];
        }
        let tilt = (both / shift).clamp(-MOST_TILT, 0.0);
        // A roll, and a zoom, by 1 move the points of the picture by this, RMS in radii.
        let moved = ((1.0 + aspect * aspect) / 3.0).sqrt();
        let (roll, zoom) = (1.0 / moved, ZOOM / moved);
        Self(SMatrix::from_columns(&[
            Coordinates::from([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, tilt, 0.0]),
            Coordinates::from([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, tilt]),
            Coordinates::from([0.0, -roll, 0.0, roll, 0.0, 0.0, 0.0, 0.0]),
            Coordinates::from([zoom, 0.0, 0.0, 0.0, zoom, 0.0, 0.0, 0.0]),
        ]))
    }
}

/// A point of a frame's edges.
#[derive(Clone, Copy, Debug)]
pub struct Limit {
    /// Index of the frame among those that are planned.
    pub frame: usize,
    /// By how much the point comes in too far where the plan is as guessed, in radii; negative where it does not.
    pub beyond: f64,
    /// How far outwards each coordinate of a change takes it.
    pub outwards: Coordinates,
}

/// A limit of a correction.
#[derive(Clone, Copy, Debug)]
struct Side {
    frame: usize,
    beyond: f64,
    outwards: Part,
    is_met: bool,
}

/// Corrects plans; reuses its buffers.
#[derive(Debug, Default)]
pub struct Bound {
    rows: Vec<Row<WAYS, 1>>,
    sides: Vec<Side>,
    found: Vec<Part>,
}

impl Bound {
    /// Adds to the changes of a plan what its limits take. `plan` are its equations, `stiffness` is μ.
    pub fn keep(
        &mut self,
        plan: &[PlanRow],
        limits: &[Limit],
        ways: &Ways,
        stiffness: f64,
        changes: &mut [Coordinates],
    ) {
        self.sides.clear();
        self.sides.extend(limits.iter().filter_map(|limit| {
            let beyond = limit.beyond - limit.outwards.dot(changes.get(limit.frame)?);
            let outwards = ways.0.tr_mul(&limit.outwards);
            Some(Side { frame: limit.frame, beyond, outwards, is_met: limit.beyond > 0.0 })
        }));
        let strength = stiffness / TURN.powi(4);
        for _ in 0..SOLUTIONS {
            self.collect(plan, strength);
            solve(&mut self.rows, &mut self.found);
            let mut is_settled = true;
            for side in &mut self.sides {
                let moved = self.found.get(side.frame).map_or(0.0, |found| side.outwards.dot(found));
                let is_met = side.beyond > moved;
                is_settled &= is_met == side.is_met;
                side.is_met = is_met;
            }
            if is_settled {
                break;
            }
        }
        for (change, found) in changes.iter_mut().zip(&self.found) {
            *change += ways.0 * found;
        }
    }

    /// Collects the equations with the limits that are met.
    fn collect(&mut self, plan: &[PlanRow], strength: f64) {
        self.rows.clear();
        let row = |row: &PlanRow| {
            Row::new(row.beside, SMatrix::from_diagonal_element(row.diagonal.x), row.interval)
        };
        self.rows.extend(plan.iter().map(row));
        for side in self.sides.iter().filter(|side| side.is_met) {
            let Some(row) = self.rows.get_mut(side.frame) else { continue };
            let weighted = side.outwards * (strength * row.interval);
            row.diagonal += weighted * side.outwards.transpose();
            row.right += weighted * side.beyond;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::plan::{Planner, Point, stiffness};
    use super::*;

    const PERIOD: f64 = 1.0 / 30.0;
    const DEVIATION: f64 = 0.5;
    /// How far the path may be from that of the scene.
    const ROOM: f64 = 0.1;

    /// A scene that moves by 0.8 along x within half a second, with a shake.
    fn scene(k: usize) -> f64 {
        0.05 * (1.1 * k as f64).sin() + 0.8 * ((k as f64 - 30.0) / 15.0).clamp(0.0, 1.0)
    }

    /// The path along x in this room.
    fn kept() -> Vec<f64> {
        let point = |k: usize| {
            let place = Coordinates::from([0.0, 0.0, scene(k), 0.0, 0.0, 0.0, 0.0, 0.0]);
            Point { time: k as f64 * PERIOD, place, offset: Coordinates::zeros() }
        };
        let points: Vec<Point> = (0..90).map(point).collect();
        let limits = (0..90).flat_map(|frame| {
            [1.0, -1.0].map(|outwards| {
                let outwards = Coordinates::from([0.0, 0.0, outwards, 0.0, 0.0, 0.0, 0.0, 0.0]);
                Limit { frame, beyond: -ROOM, outwards }
            })
        });
        let limits: Vec<Limit> = limits.collect();
        let (mut planner, mut changes) = (Planner::default(), Vec::new());
        planner.plan(&points, [None; 2], DEVIATION, &mut changes);
        let ways = Ways::new(std::iter::empty(), 0.75);
        Bound::default().keep(planner.rows(), &limits, &ways, stiffness(DEVIATION), &mut changes);
        points.iter().zip(&changes).map(|(point, change)| point.place[2] + change[2]).collect()
    }

    /// What the path makes least, but for what follows the last frame.
    fn cost(path: &[f64]) -> f64 {
        let offsets = path.iter().enumerate().map(|(k, place)| place - scene(k));
        let apart: f64 = offsets.clone().map(|offset| offset * offset).sum();
        let beyond: f64 = offsets.map(|offset| (offset.abs() - ROOM).max(0.0).powi(2)).sum();
        let second = |three: &[f64]| (three[2] - 2.0 * three[1] + three[0]) / (PERIOD * PERIOD);
        let bent: f64 = path.windows(3).map(|three| second(three).powi(2)).sum();
        apart + stiffness(DEVIATION) * (bent + beyond / TURN.powi(4))
    }

    #[test]
    fn the_path_is_the_least_within_the_limits() {
        let path = kept();
        let farthest = path.iter().enumerate().map(|(k, place)| (place - scene(k)).abs()).fold(0.0, f64::max);
        assert!(farthest > ROOM && farthest < 1.1 * ROOM, "{farthest}");
        let least = cost(&path);
        for middle in (2..84).step_by(3) {
            for width in [1.0, 4.0, 12.0] {
                for height in [-1e-4, 1e-4] {
                    let bump = |k: usize| {
                        let apart = (k as f64 - middle as f64) / width;
                        if k < 87 { height * (-apart * apart).exp() } else { 0.0 }
                    };
                    let other: Vec<f64> = path.iter().enumerate().map(|(k, place)| place + bump(k)).collect();
                    assert!(cost(&other) > least, "{middle} {width} {height}");
                }
            }
        }
    }

    #[test]
    fn a_turn_of_the_camera_tilts_as_it_shifts() {
        let motion = |x: f64, y: f64| Coordinates::from([0.0, 0.0, x, 0.0, 0.0, y, -0.25 * x, -0.25 * y]);
        let ways = Ways::new([motion(0.1, 0.02), motion(-0.03, 0.2)].into_iter(), 0.75);
        assert!((ways.0[(6, 0)] + 0.25).abs() < 1e-12 && (ways.0[(7, 1)] + 0.25).abs() < 1e-12);
        let none = Ways::new(std::iter::empty(), 0.75);
        assert!(none.0[(6, 0)].abs() < 1e-12);
    }
}
