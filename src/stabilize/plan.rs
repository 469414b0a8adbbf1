// SPDX-License-Identifier: MIT OR Apache-2.0

//! The path of the virtual camera: the one of least acceleration near the path of the scene.
//!
//! Over the frames that are known, with the scene's path p and the planned one V,
//!
//! > Σ w·|V − p − b|²·h + μ·Σ |V̈|²·h + (cost of what follows) → least,
//!
//! h the interval between frames, given the places of the two frames before. Where V may go where it likes (w = 1, b = 0), this is a
//! low-pass filter of the fourth order that follows a pan without lag: 1/(1 + μω⁴). Its deviation in time is that of a Gaussian
//! which halves the same frequency, so μ = (σ/1.177)⁴. Where the window would leave the picture, V is held at the offset b from where it does not.
//!
//! The cost of what follows the last frame is that of the optimal control of a double integrator, in closed form from the
//! algebraic Riccati equation: with e = V − p and its rate v, √2·μ^¼·e² + 2·√μ·e·v + √2·μ^¾·v².

use super::logarithm::Coordinates;

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
    /// The path of the scene.
    pub path: Coordinates,
    /// Offset from it at which the virtual camera is held, and how strongly: none and 1 where the window is inside the picture.
    pub held: Coordinates,
    pub weight: f64,
}

/// A row of the lower half of a symmetric matrix with two diagonals beside the main one, and the right side.
#[derive(Clone, Copy, Debug, Default)]
struct Row {
    /// Element with the row two before, one before, and of the diagonal.
    elements: [f64; 3],
    right: Coordinates,
}

/// Solves plans; reuses its buffer.
#[derive(Debug, Default)]
pub struct Planner {
    rows: Vec<Row>,
}

impl Planner {
    /// Fills `places` with the planned place of each point. `before` are the places of the frames before with their times, the
    /// nearest first.
    pub fn plan(
        &mut self,
        points: &[Point],
        before: [Option<(f64, Coordinates)>; 2],
        deviation: f64,
        places: &mut Vec<Coordinates>,
    ) {
        places.clear();
        let Some(last) = points.len().checked_sub(1) else { return };
        let mu = (deviation / HALVING).powi(4);
        self.rows.clear();
        self.rows.resize(points.len(), Row::default());
        // Frames before have the indices −1 and −2.
        let known =
            |index: isize| usize::try_from(-index - 1).ok().and_then(|back| before.get(back)?.as_ref());
        let time = |index: isize| match usize::try_from(index) {
            Ok(index) => points.get(index).map(|point| point.time),
            Err(_) => known(index).map(|(time, _)| *time),
        };
        for (index, point) in points.iter().enumerate() {
            let index = index as isize;
            let ends = [time(index - 1).unwrap_or(point.time), time(index + 1).unwrap_or(point.time)];
            let interval = ((ends[1] - ends[0]) / 2.0).max(LEAST_INTERVAL);
            self.add(&[(index, 1.0)], point.weight * interval, point.path + point.held, known);
        }
        for index in -1..last as isize {
            let triple = [index - 1, index, index + 1];
            let [Some(a), Some(b), Some(c)] = triple.map(time) else { continue };
            let [first, second] = [b - a, c - b].map(|interval| interval.max(LEAST_INTERVAL));
            let sum = first + second;
            let [before, after] = [2.0 / (first * sum), 2.0 / (second * sum)];
            let terms = [(triple[0], before), (triple[1], -before - after), (triple[2], after)];
            self.add(&terms, mu * sum / 2.0, Coordinates::zeros(), known);
        }
        self.add_future(points, mu, known);
        self.solve(places);
    }

    /// Adds `factor`·|Σ coefficient·V − target|².
    fn add<'a>(
        &mut self,
        terms: &[(isize, f64)],
        factor: f64,
        target: Coordinates,
        known: impl Fn(isize) -> Option<&'a (f64, Coordinates)>,
    ) {
        let mut target = target;
        for (index, coefficient) in terms {
            if let Some((_, place)) = known(*index) {
                target -= place * *coefficient;
            }
        }
        for (index, coefficient) in terms {
            let Some(row) = usize::try_from(*index).ok().and_then(|index| self.rows.get_mut(index)) else {
                continue;
            };
            row.right += target * (factor * coefficient);
            for (other, beside) in terms.iter().filter(|(other, _)| *other >= 0 && other <= index) {
                if let Some(element) = row.elements.get_mut((2 - (index - other)).max(0) as usize) {
                    *element += factor * coefficient * beside;
                }
            }
        }
    }

    /// Adds the cost of what follows the last point.
    fn add_future<'a>(
        &mut self,
        points: &[Point],
        mu: f64,
        known: impl Fn(isize) -> Option<&'a (f64, Coordinates)> + Copy,
    ) {
        let Some((last, earlier)) = points.split_last() else { return };
        let index = earlier.len() as isize;
        let root = mu.sqrt().sqrt();
        // The quadratic form as squares: √2·μ^¼·(e + μ^¼·v/√2)² + μ^¾·v²/√2.
        let before = earlier.last().map(|point| (point.time, point.path));
        let Some((time, path)) = before.or_else(|| known(-1).copied()) else {
            self.add(&[(index, 1.0)], std::f64::consts::SQRT_2 * root, last.path, known);
            return;
        };
        let interval = (last.time - time).max(LEAST_INTERVAL);
        // The mean velocity over about a deviation.
        let reach = root * HALVING;
        let from = earlier.iter().find(|point| last.time - point.time <= reach);
        let (since, origin) = from.map_or((time, path), |point| (point.time, point.path));
        let rate = (last.path - origin) * (CONTINUED / (last.time - since).max(LEAST_INTERVAL));
        let lever = root * std::f64::consts::FRAC_1_SQRT_2 / interval;
        let target = last.path + rate * (lever * interval);
        let terms = [(index - 1, -lever), (index, 1.0 + lever)];
        self.add(&terms, std::f64::consts::SQRT_2 * root, target, known);
        let speed = [(index - 1, -1.0 / interval), (index, 1.0 / interval)];
        self.add(&speed, root * root * root * std::f64::consts::FRAC_1_SQRT_2, rate, known);
    }

    /// Solves the equations by the Cholesky factor L·D·Lᵀ inside the band.
    fn solve(&mut self, places: &mut Vec<Coordinates>) {
        let rows = &mut self.rows;
        for index in 0..rows.len() {
            let (done, rest) = rows.split_at_mut(index);
            let Some(row) = rest.first_mut() else { break };
            let one = done.last().copied().unwrap_or_default();
            let two = index.checked_sub(2).and_then(|two| done.get(two)).copied().unwrap_or_default();
            // Of a row that is done: factors beside the diagonal, the diagonal, and the right side by L⁻¹.
            let [far, near, diagonal] = row.elements;
            let near = near - far * one.elements[1];
            let factor = |element: f64, diagonal: f64| if diagonal > 0.0 { element / diagonal } else { 0.0 };
            let (to_two, to_one) = (factor(far, two.elements[2]), factor(near, one.elements[2]));
            let diagonal = diagonal - to_two * far - to_one * near;
            row.right -= two.right * to_two + one.right * to_one;
            row.elements = [to_two, to_one, diagonal];
        }
        places.resize(rows.len(), Coordinates::zeros());
        for index in (0..rows.len()).rev() {
            let Some(row) = rows.get(index) else { continue };
            let mut place = if row.elements[2] > 0.0 { row.right / row.elements[2] } else { row.right };
            for (beyond, element) in [(1, 1), (2, 0)] {
                if let (Some(row), Some(after)) = (rows.get(index + beyond), places.get(index + beyond)) {
                    place -= after * row.elements[element];
                }
            }
            if let Some(slot) = places.get_mut(index) {
                *slot = place;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn planned(points: &[Point], before: [Option<(f64, Coordinates)>; 2], deviation: f64) -> Vec<f64> {
        let mut places = Vec::new();
        Planner::default().plan(points, before, deviation, &mut places);
        places.iter().map(|place| place[0]).collect()
    }

    fn points(count: i32, path: impl Fn(f64) -> f64) -> Vec<Point> {
        let point = |k: i32| {
            let time = f64::from(k) / 30.0;
            Point { time, path: Coordinates::repeat(path(time)), held: Coordinates::zeros(), weight: 1.0 }
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
    fn what_has_weight_is_followed() {
        let mut points = points(61, |t| if t > 1.0 { 10.0 } else { 0.0 });
        points[30].weight = 1e6;
        let found = planned(&points, [None; 2], 0.5);
        assert!(found[30].abs() < 0.01, "{}", found[30]);
        let solo = planned(&points[..1], [None; 2], 0.5);
        assert!(solo[0].abs() < 1e-12 && planned(&[], [None; 2], 0.5).is_empty());
    }
}
