// SPDX-License-Identifier: MIT OR Apache-2.0

//! The path of the virtual camera: the one of least acceleration near the path of the scene.
//!
//! Over the frames that are known, with the scene's path p and the planned one V,
//!
//! > Σ |V − p|²·h + μ·Σ |V̈|²·h + (cost of what follows) → least,
//!
//! h the interval between frames, given the places of the two frames before. It is a low-pass filter of the fourth order that
//! follows a pan without lag: 1/(1 + μω⁴). Its deviation in time is that of a Gaussian which halves the same frequency, so
//! μ = (σ/1.177)⁴. What keeps the window inside the picture is added to the same equations ([`super::bound`]).
//!
//! The unknowns are the changes of a guess of V: motions do not commute, and around a guess that is nearly right they need not.
//!
//! The cost of what follows the last frame is that of the optimal control of a double integrator, in closed form from the
//! algebraic Riccati equation: with e = V − p and its rate v, √2·μ^¼·e² + 2·√μ·e·v + √2·μ^¾·v².

use super::band::{Row, solve};
use super::logarithm::Coordinates;
use nalgebra::SMatrix;

/// Product of the deviation of a Gaussian and the angular frequency that it halves: √(2·ln 2).
const HALVING: f64 = 1.177_410_022_515_474_7;
/// Least seconds between frames: times may repeat.
const LEAST_INTERVAL: f64 = 1e-3;
/// Share of the scene's mean velocity that is taken to go on after the last known frame: with all of it a shake is continued,
/// with none of it a pan is followed late.
const CONTINUED: f64 = 0.5;

/// A frame whose place is planned.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// Seconds.
    pub time: f64,
    /// Where the virtual camera is guessed to be.
    pub place: Coordinates,
    /// How far that is from the path of the scene.
    pub offset: Coordinates,
}

impl Point {
    fn path(&self) -> Coordinates {
        self.place - self.offset
    }
}

/// The equations of a frame: they are the same for all coordinates, with a right side for each.
pub type PlanRow = Row<1, 8>;

/// Makes plans; reuses its buffers.
#[derive(Debug, Default)]
pub struct Planner {
    rows: Vec<PlanRow>,
    found: Vec<SMatrix<f64, 1, 8>>,
}

impl Planner {
    /// Fills `changes` with how much the planned place of each point differs from the guess. `before` are the places of the frames
    /// before with their times, the nearest first.
    pub fn plan(
        &mut self,
        points: &[Point],
        before: [Option<(f64, Coordinates)>; 2],
        deviation: f64,
        changes: &mut Vec<Coordinates>,
    ) {
        changes.clear();
        let Some(last) = points.len().checked_sub(1) else { return };
        let mu = stiffness(deviation);
        self.rows.clear();
        self.rows.resize(points.len(), PlanRow::default());
        // Frames before have the indices −1 and −2.
        let at = |index: isize| match usize::try_from(index) {
            Ok(index) => points.get(index).map(|point| (point.time, point.place)),
            Err(_) => usize::try_from(-index - 1).ok().and_then(|back| before.get(back).copied().flatten()),
        };
        let time = |index: isize| at(index).map(|(time, _)| time);
        for (index, point) in points.iter().enumerate() {
            let own = index as isize;
            let ends = [time(own - 1).unwrap_or(point.time), time(own + 1).unwrap_or(point.time)];
            let interval = ((ends[1] - ends[0]) / 2.0).max(LEAST_INTERVAL);
            self.add(&[(own, 1.0)], interval, point.offset);
            if let Some(row) = self.rows.get_mut(index) {
                row.interval = interval;
            }
        }
        for index in -1..last as isize {
            let triple = [index - 1, index, index + 1];
            let [Some(a), Some(b), Some(c)] = triple.map(at) else { continue };
            let [first, second] = [b.0 - a.0, c.0 - b.0].map(|interval| interval.max(LEAST_INTERVAL));
            let sum = first + second;
            let [before, after] = [2.0 / (first * sum), 2.0 / (second * sum)];
            let terms = [(triple[0], before), (triple[1], -before - after), (triple[2], after)];
            let guessed = a.1 * before - b.1 * (before + after) + c.1 * after;
            self.add(&terms, mu * sum / 2.0, guessed);
        }
        self.add_future(points, mu, at(-1));
        solve(&mut self.rows, &mut self.found);
        changes.extend(self.found.iter().map(SMatrix::transpose));
    }

    /// The equations of the last plan.
    pub fn rows(&self) -> &[PlanRow] {
        &self.rows
    }

    /// Adds `factor`·|Σ coefficient·change + guessed|²; places of frames before do not change.
    fn add(&mut self, terms: &[(isize, f64)], factor: f64, guessed: Coordinates) {
        for (index, coefficient) in terms {
            let Some(row) = usize::try_from(*index).ok().and_then(|index| self.rows.get_mut(index)) else {
                continue;
            };
            row.right -= guessed.transpose() * (factor * coefficient);
            let [far, near] = &mut row.beside;
            for (other, beside) in terms.iter().filter(|(other, _)| *other >= 0 && other <= index) {
                let element = match index - other {
                    0 => &mut row.diagonal.x,
                    1 => &mut *near,
                    _ => &mut *far,
                };
                *element += factor * coefficient * beside;
            }
        }
    }

    /// Adds the cost of what follows the last point.
    fn add_future(&mut self, points: &[Point], mu: f64, before: Option<(f64, Coordinates)>) {
        let Some((last, earlier)) = points.split_last() else { return };
        let index = earlier.len() as isize;
        let root = mu.sqrt().sqrt();
        // The quadratic form as squares: √2·μ^¼·(e + μ^¼·v/√2)² + μ^¾·v²/√2.
        let known = earlier.last().map(|point| (point.time, point.path(), point.place));
        let Some((time, path, place)) = known.or_else(|| before.map(|(time, place)| (time, place, place)))
        else {
            self.add(&[(index, 1.0)], std::f64::consts::SQRT_2 * root, last.offset);
            return;
        };
        let interval = (last.time - time).max(LEAST_INTERVAL);
        // The mean velocity over about a deviation.
        let reach = root * HALVING;
        let from = earlier.iter().find(|point| last.time - point.time <= reach);
        let (since, origin) = from.map_or((time, path), |point| (point.time, point.path()));
        let rate = (last.path() - origin) * (CONTINUED / (last.time - since).max(LEAST_INTERVAL));
        let lever = root * std::f64::consts::FRAC_1_SQRT_2 / interval;
        let guessed_rate = (last.place - place) / interval - rate;
        let terms = [(index - 1, -lever), (index, 1.0 + lever)];
        let guessed = last.offset + guessed_rate * (lever * interval);
        self.add(&terms, std::f64::consts::SQRT_2 * root, guessed);
        let speed = [(index - 1, -1.0 / interval), (index, 1.0 / interval)];
        self.add(&speed, root * root * root * std::f64::consts::FRAC_1_SQRT_2, guessed_rate);
    }
}

/// The weight μ of the acceleration, in s⁴.
pub fn stiffness(deviation: f64) -> f64 {
    (deviation / HALVING).powi(4)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn planned(points: &[Point], before: [Option<(f64, Coordinates)>; 2], deviation: f64) -> Vec<f64> {
        let mut changes = Vec::new();
        Planner::default().plan(points, before, deviation, &mut changes);
        points.iter().zip(&changes).map(|(point, change)| point.place[0] + change[0]).collect()
    }

    fn points(count: i32, path: impl Fn(f64) -> f64) -> Vec<Point> {
        let point = |k: i32| {
            let time = f64::from(k) / 30.0;
            // Whatever is guessed.
            let offset = Coordinates::repeat(3.0 * (1.3 * f64::from(k)).sin());
            Point { time, place: Coordinates::repeat(path(time)) + offset, offset }
        };
        (0..count).map(point).collect()
    }

    #[test]
    fn a_frequency_is_passed_as_by_the_filter_in_closed_form() {
        // At the frequency that a Gaussian of 0.2 s halves, and at three times it.
        for (factor, passed) in [(1.0, 0.5), (3.0, 1.0 / 82.0)] {
            let omega = factor * HALVING / 0.2;
            let found = planned(&points(301, |t| (omega * (t - 5.0)).cos()), [None; 2], 0.2);
            assert!((found[150] - passed).abs() < 0.01, "{factor}: {}", found[150]);
        }
    }

    #[test]
    fn a_steady_pan_is_followed_without_lag() {
        let before =
            [Some((-1.0 / 30.0, Coordinates::repeat(-1.0))), Some((-2.0 / 30.0, Coordinates::repeat(-2.0)))];
        for (before, first, tolerance) in [([None; 2], 60, 0.5), (before, 0, 0.2)] {
            let found = planned(&points(180, |t| 30.0 * t), before, 0.4);
            for (k, place) in found.iter().enumerate().take(120).skip(first) {
                assert!((place - k as f64).abs() < tolerance, "frame {k}: {place}");
            }
        }
    }

    #[test]
    fn it_goes_on_from_where_it_was() {
        // From 8 above and at rest: no jump, no overshoot by more than a twentieth.
        let before = [1, 2].map(|k| Some((-f64::from(k) / 30.0, Coordinates::repeat(8.0))));
        let found = planned(&points(120, |_| 0.0), before, 0.3);
        assert!((found[0] - 8.0).abs() < 0.2 && found.iter().all(|place| *place > -0.4 && *place <= 8.0));
        assert!(found[60].abs() < 0.4, "{}", found[60]);
    }

    #[test]
    fn one_frame_stays_where_it_is() {
        let solo = planned(&points(1, |_| 0.0), [None; 2], 0.5);
        assert!(solo[0].abs() < 1e-12 && planned(&[], [None; 2], 0.5).is_empty());
    }
}
