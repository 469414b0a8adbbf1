// SPDX-License-Identifier: MIT OR Apache-2.0

//! The homographies along a path.
//!
//! On homogeneous points the generators' velocities are ẋ = A(t)·x, so the motion between two instants is a
//! homography: H(t) from the first instant of the window to t, H(t′)·H(t)⁻¹ from t to t′. H is integrated
//! from node to node by Magnus's series to the fourth order, H ← exp(Ω)·H with Ω = (A₁ + A₂)·h/2 +
//! (√3/12)·h²·(A₂·A₁ − A₁·A₂), A₁ and A₂ at the nodes of Gauss's quadrature, and interpolated by cubics with
//! the slopes A·H. Against Runge–Kutta with 400 steps, shake of 180 px a block on a frame of 640 px is
//! followed to 0.03 px; a turn about one axis, in closed form, to 0.001 px.

use super::splines::{Splines, ratio};
use crate::lanes::matrices::{Columns, columns, times};
use crate::lanes::scalar::Scalar;
use crate::lanes::{DOUBLES, DoubleCpu};
use crate::motion::generators::{GENERATORS, flow_matrix};
use nalgebra::{Matrix3, Vector2};

/// Blocks between nodes: half a knot spacing of the turns.
const STEP: f64 = 0.5 / ratio(0) as f64;
/// Half the distance between the nodes of Gauss's quadrature on an interval of length 1: √3/6.
const GAUSS: f64 = 0.288_675_134_594_812_9;
const _: () =
    assert!(GENERATORS.is_multiple_of(DOUBLES), "rates are taken by vectors: the last ones would stay 0");

#[derive(Clone, Debug)]
struct Node {
    /// H and its slope per step.
    forward: [Columns; 2],
    /// H⁻¹ and its slope per step.
    back: [Columns; 2],
    /// Rates of the generators in pixels a block.
    rates: [f64; GENERATORS],
    /// Paths of the generators in pixels, up to constants.
    values: [f64; GENERATORS],
}

/// The path at an instant, interpolated between two nodes; extrapolated outside all nodes.
#[derive(Clone, Copy, Debug)]
pub struct PathState<'a> {
    nodes: &'a [Node; 2],
    /// Steps after the first of the nodes.
    step: f64,
}

impl PathState<'_> {
    /// H, from the first instant to this one.
    #[inline(always)]
    fn until<C: DoubleCpu>(self, cpu: C) -> [C::Doubles; 3] {
        hermite(cpu, &self.nodes[0].forward, &self.nodes[1].forward, self.step)
    }

    /// H⁻¹, from this instant to the first.
    #[inline(always)]
    fn back<C: DoubleCpu>(self, cpu: C) -> [C::Doubles; 3] {
        hermite(cpu, &self.nodes[0].back, &self.nodes[1].back, self.step)
    }

    /// Where a point seen at this instant is at another.
    #[inline(always)]
    pub fn carry<C: DoubleCpu>(self, cpu: C, point: Vector2<f64>, to: Self) -> Vector2<f64> {
        let first = times(cpu, self.back(cpu), [point.x, point.y, 1.0]);
        let [x, y, z] = times(cpu, to.until(cpu), first);
        Vector2::new(x, y) / z
    }

    /// Rates of the generators in pixels a block here, times a factor, less those at another instant, times another.
    #[inline(always)]
    pub fn rates_less<C: DoubleCpu>(self, cpu: C, factor: f64, other: Self, by: f64) -> [f64; GENERATORS] {
        self.less(cpu, factor, other, by, |node| &node.rates)
    }

    /// Paths of the generators in pixels here less those at another instant.
    #[inline(always)]
    pub fn values_less<C: DoubleCpu>(self, cpu: C, other: Self) -> [f64; GENERATORS] {
        self.less(cpu, 1.0, other, 1.0, |node| &node.values)
    }

    /// Numbers interpolated linearly between the nodes.
    #[inline(always)]
    fn less<C: DoubleCpu>(
        self,
        cpu: C,
        factor: f64,
        other: Self,
        by: f64,
        of: impl Fn(&Node) -> &[f64; GENERATORS],
    ) -> [f64; GENERATORS] {
        let mut sums = [0.0; GENERATORS];
        for (k, sums) in sums.as_chunks_mut().0.iter_mut().enumerate() {
            let own = cpu.splat_double(factor) * self.linear(cpu, k, &of);
            *sums = cpu.store_doubles(own - cpu.splat_double(by) * other.linear(cpu, k, &of));
        }
        sums
    }

    /// Four of some numbers, interpolated linearly between the nodes.
    #[inline(always)]
    fn linear<C: DoubleCpu>(
        self,
        cpu: C,
        four: usize,
        of: impl Fn(&Node) -> &[f64; GENERATORS],
    ) -> C::Doubles {
        let [a, b] = [0, 1].map(
            #[inline(always)]
            |node: usize| cpu.load_doubles(&of(&self.nodes[node]).as_chunks().0[four]),
        );
        a + (b - a) * cpu.splat_double(self.step)
    }
}

/// The homographies of a path between two instants, for points in radii. Times are in blocks.
#[derive(Clone, Debug, Default)]
pub struct Homographies {
    /// Time of the first node, in steps.
    first: f64,
    nodes: Vec<Node>,
}

impl Homographies {
    /// Integrates a path, `radius` in pixels, between two blocks.
    pub fn integrate(&mut self, path: &Splines, [from, to]: [f64; 2], radius: f64) {
        self.first = (from / STEP).floor();
        let count = ((to / STEP).ceil() - self.first).max(1.0) as usize;
        let rates = |steps: f64| path.rates(STEP * (self.first + steps));
        let matrix =
            |rates: [f64; GENERATORS]| flow_matrix(&rates.map(|rate| rate / radius * STEP), path.kappa);
        let mut h = Matrix3::identity();
        let mut inverse = h;
        self.nodes.clear();
        for k in 0..=count {
            let steps = k as f64;
            let here = rates(steps);
            let a = matrix(here);
            let values = path.values(STEP * (self.first + steps));
            self.nodes.push(Node {
                forward: [&h, &(a * h)].map(columns),
                back: [&inverse, &(-inverse * a)].map(columns),
                rates: here,
                values,
            });
            let [p, q] = [0.5 - GAUSS, 0.5 + GAUSS].map(|offset| matrix(rates(steps + offset)));
            let omega = (p + q) / 2.0 + (q * p - p * q) * (GAUSS / 2.0);
            h = exponential(omega) * h;
            inverse *= exponential(-omega);
        }
    }

    /// Whether a block lies between the nodes.
    pub fn covers(&self, block: f64) -> bool {
        let at = block / STEP - self.first;
        at >= 0.0 && at <= self.nodes.len() as f64 - 1.0
    }

    /// The path at a block; `None` before any integration.
    #[inline(always)]
    pub fn at(&self, block: f64) -> Option<PathState<'_>> {
        let at = block / STEP - self.first;
        let last = self.nodes.len().checked_sub(2)?;
        let index = (at.max(0.0) as usize).min(last);
        let nodes = self.nodes.get(index..index + 2)?.first_chunk::<2>()?;
        Some(PathState { nodes, step: at - index as f64 })
    }

    /// The homography from the first instant to a block.
    pub fn until(&self, block: f64) -> Matrix3<f64> {
        self.at(block).map_or_else(Matrix3::identity, |state| matrix(state.until(Scalar)))
    }

    /// The homography from a block to the first instant.
    pub fn back(&self, block: f64) -> Matrix3<f64> {
        self.at(block).map_or_else(Matrix3::identity, |state| matrix(state.back(Scalar)))
    }

    /// Where a point seen at block `from` is at block `to`.
    pub fn carry(&self, point: Vector2<f64>, from: f64, to: f64) -> Vector2<f64> {
        self.at(from).zip(self.at(to)).map_or(point, |(from, to)| from.carry(Scalar, point, to))
    }
}

fn matrix(columns: [<Scalar as DoubleCpu>::Doubles; 3]) -> Matrix3<f64> {
    let columns = columns.map(|column| Scalar.store_doubles(column));
    Matrix3::from_fn(|r, c| columns[c][r])
}

/// The cubic with these values and slopes at 0 and 1.
#[inline(always)]
fn hermite<C: DoubleCpu>(cpu: C, a: &[Columns; 2], b: &[Columns; 2], s: f64) -> [C::Doubles; 3] {
    let (s2, s3) = (s * s, s * s * s);
    let weights = [1.0 - 3.0 * s2 + 2.0 * s3, s - 2.0 * s2 + s3, 3.0 * s2 - 2.0 * s3, s3 - s2];
    let mut sums = [cpu.splat_double(0.0); 3];
    for (k, sum) in sums.iter_mut().enumerate() {
        *sum = cpu.splat_double(weights[0]) * cpu.load_doubles(&a[0][k]);
        for (of, weight) in [&a[1], &b[0], &b[1]].into_iter().zip(&weights[1..]) {
            *sum = *sum + cpu.splat_double(*weight) * cpu.load_doubles(&of[k]);
        }
    }
    sums
}

/// The exponential of a small matrix, to the fourth order.
fn exponential(a: Matrix3<f64>) -> Matrix3<f64> {
    let a2 = a * a;
    Matrix3::identity() + a + a2 / 2.0 + a2 * a / 6.0 + a2 * a2 / 24.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::generators::fields;
    use nalgebra::{Rotation3, SVector, Vector3};

    const RADIUS: f64 = 320.0;
    const POINTS: [[f64; 2]; 4] = [[0.0, 0.0], [0.9, -0.6], [-0.8, 0.7], [0.3, 0.5]];

    /// A path over blocks −1 to 5 whose coefficient of generator j at time t is `coefficient(j, t)`.
    fn path(kappa: f64, coefficient: impl Fn(usize, f64) -> f64) -> Splines {
        let mut path = Splines::still(-1, 9, kappa);
        for j in 0..GENERATORS {
            for knot in path.knots(j) {
                let spacing = if path.knots(j).end > 8 { 0.25 } else { 1.0 };
                let place = path.place(j, knot) as usize;
                // Coefficient i is centred one knot before it: see the splines.
                path.coefficients[place] = coefficient(j, (knot - 1) as f64 * spacing);
            }
        }
        path
    }

    /// Runge–Kutta on ẋ = Σⱼ φⱼ(x)·rateⱼ.
    fn integrate(path: &Splines, mut x: Vector2<f64>, from: f64, to: f64) -> Vector2<f64> {
        let steps = 400;
        let h = (to - from) / steps as f64;
        let velocity =
            |x: Vector2<f64>, t: f64| fields(x, path.kappa) * SVector::from(path.rates(t)) / RADIUS;
        for step in 0..steps {
            let t = from + h * step as f64;
            let a = velocity(x, t);
            let b = velocity(x + a * (h / 2.0), t + h / 2.0);
            let c = velocity(x + b * (h / 2.0), t + h / 2.0);
            let d = velocity(x + c * h, t + h);
            x += (a + (b + c) * 2.0 + d) * (h / 6.0);
        }
        x
    }

    fn worst(
        path: &Splines,
        times: &[[f64; 2]],
        expected: impl Fn(Vector2<f64>, f64, f64) -> Vector2<f64>,
    ) -> f64 {
        let mut flow = Homographies::default();
        flow.integrate(path, [0.0, 4.0], RADIUS);
        let off = |[from, to]: [f64; 2], x: Vector2<f64>| flow.carry(x, from, to) - expected(x, from, to);
        let all = times.iter().flat_map(|times| POINTS.map(|x| off(*times, x.into()).norm() * RADIUS));
        all.fold(0.0, f64::max)
    }

    #[test]
    fn rates_between_nodes_are_those_of_the_path() {
        // A swing whose rate turns round within a block.
        let path = path(0.3, |j, t| if j == 1 { 10.0 * (4.0 * t).sin() } else { 0.0 });
        let mut flow = Homographies::default();
        flow.integrate(&path, [0.0, 4.0], RADIUS);
        for time in [0.3, 1.07, 2.94] {
            let state = flow.at(time).unwrap();
            let off = state.rates_less(Scalar, 1.0, state, 0.0)[1] - path.rates(time)[1];
            // A chord is off by an eighth of the step squared times the second derivative, 640.
            assert!(off.abs() < STEP * STEP / 8.0 * 640.0, "{time}: {off}");
        }
    }

    #[test]
    fn homographies_integrate_the_velocity_fields() {
        // 30 px to and fro, about once in a block for the turns, in two for the rest: up to 180 px a block.
        let shaken =
            path(0.3, |j, t| (30.0 - 3.0 * j as f64) * (t * if j < 3 { 6.0 } else { 3.0 } + j as f64).sin());
        let times = [[0.0, 1.0], [0.13, 2.71], [3.9, 0.2], [1.5, 1.8], [2.0, 2.0]];
        let off = worst(&shaken, &times, |x, from, to| integrate(&shaken, x, from, to));
        assert!(off < 0.03, "{off} px");
    }

    #[test]
    fn turns_are_rotations_of_the_camera() {
        // About one axis all the time: f = 1.25 radii, 80 px a block of yaw, −50 of pitch, 30 of roll.
        let (focal, rates) = (1.25, [80.0, -50.0, 30.0]);
        let even = path(1.0 / (focal * focal), |j, t| rates.get(j).map_or(0.0, |rate| rate * t));
        let axis = Vector3::new(-rates[1] / focal, rates[0] / focal, rates[2]) / RADIUS;
        let seen = |x: Vector2<f64>, from: f64, to: f64| {
            let ray = Rotation3::new(axis * (to - from)) * x.push(focal);
            ray.xy() * (focal / ray.z)
        };
        let off = worst(&even, &[[0.1, 1.2], [0.5, 3.7], [3.0, 0.4]], seen);
        assert!(off < 1e-3, "{off} px");
    }

    #[test]
    fn outside_of_the_nodes_points_stay_finite() {
        let mut flow = Homographies::default();
        let point = Vector2::new(0.4, -0.2);
        assert_eq!(flow.carry(point, 0.0, 1.0), point);
        assert!(!flow.covers(0.0) && flow.at(0.0).is_none());
        flow.integrate(&path(0.3, |j, t| t * (j + 1) as f64), [0.0, 4.0], RADIUS);
        assert!(flow.covers(0.0) && flow.covers(4.0) && !flow.covers(-0.01) && !flow.covers(4.01));
        assert!(flow.carry(point, -0.3, 4.3).iter().all(|coordinate| coordinate.is_finite()));
    }
}
