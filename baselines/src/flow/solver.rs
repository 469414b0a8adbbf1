// SPDX-License-Identifier: MIT OR Apache-2.0

//! The flow that minimises the robust energy around one warp.
//!
//! ∑ over pixels of ψ(r; ε_D) + λ ∑ over pairs of neighbours of ψ(|w_p − w_q|; ε_S), with
//! ψ(s; ε) = √(s² + ε²) after Charbonnier and r = Iₓ u + I_y v + c the linearised difference of
//! brightness. Reweighted least squares: with the weights 1/ψ held, it is a linear system of two
//! equations a pixel, solved by successive over-relaxation in red-black order.

use super::board::{Around, Board, LANES, Layout, Line};
use rayon::prelude::*;

/// λ: grey levels of brightness difference that a step of one pixel in the flow is worth. More makes
/// smooth flows more exact, less keeps the edges of what is near.
const SMOOTHNESS: f32 = 6.0;

/// ε_D in grey levels: a smaller difference counts quadratically.
const DATA_EPSILON: f32 = 0.5;

/// ε_S in pixels: a smaller step counts quadratically.
const STEP_EPSILON: f32 = 0.01;

/// How often the weights are renewed.
const ROUNDS: usize = 3;

/// Relaxations of every pixel between two renewals.
const SWEEPS: usize = 10;

/// ω of the over-relaxation.
const RELAXATION: f32 = 1.85;

/// Lines that are not worth being shared among threads.
const FEW_LINES: usize = 48;

/// Numbers kept for each square: the inverse of its 2 × 2 matrix (11, 12, 22), its right side (1, 2).
const NUMBERS: usize = 5;

/// As many numbers as are worked on at once.
type Lanes = [f32; LANES];

/// The difference of brightness as a linear function of the flow: `slope` · w + `rest`, in grey levels.
/// Where nothing is known all are 0.
pub struct Constraint {
    /// ∂/∂x and ∂/∂y of the brightness.
    pub slope: [Board; 2],
    /// What is left at a flow of zero.
    pub rest: Board,
}

/// Improves a flow, given as a board for u and one for v.
pub fn solve(constraint: &Constraint, flow: &mut [Board; 2], layout: Layout) {
    for _ in 0..ROUNDS {
        let system = System::new(constraint, flow, layout);
        for _ in 0..SWEEPS {
            system.relax(flow, 0);
            system.relax(flow, 1);
        }
    }
}

/// The linear system: for each pixel (diagonal block + ∑ weights) w = right side + ∑ weight · w of
/// the neighbour.
struct System {
    layout: Layout,
    /// Weight of the step from each pixel to the one on the right; 0 at the border.
    across: Board,
    /// Weight of the step to the pixel below.
    down: Board,
    /// For each colour the numbers of its lines, one line of each number after the other.
    equations: [Vec<f32>; 2],
}

impl System {
    fn new(constraint: &Constraint, flow: &[Board; 2], layout: Layout) -> Self {
        let mut across = Board::new(layout);
        let mut down = Board::new(layout);
        for colour in [0, 1] {
            let stride = layout.stride();
            let weights = across.colours[colour]
                .par_chunks_mut(stride)
                .zip(down.colours[colour].par_chunks_mut(stride));
            let rows = weights.enumerate().with_min_len(FEW_LINES).skip(1).take(layout.height);
            rows.for_each(|(row, (across, down))| {
                let line = Line { colour, row };
                step_weights(
                    flow,
                    line,
                    |around| around.right,
                    across,
                    Layout::pixels(line, layout.width - 1),
                );
                let pixels = if row < layout.height { Layout::pixels(line, layout.width) } else { 0 };
                step_weights(flow, line, |around| around.down, down, pixels);
            });
        }
        let mut system = Self { layout, across, down, equations: Default::default() };
        system.equations = [0, 1].map(|colour| system.assembled(constraint, flow, colour));
        system
    }

    /// The equations of one colour.
    fn assembled(&self, constraint: &Constraint, flow: &[Board; 2], colour: usize) -> Vec<f32> {
        let size = NUMBERS * self.layout.span();
        let mut equations = vec![0.0; size * self.layout.height];
        let rows = equations.par_chunks_mut(size).enumerate().with_min_len(FEW_LINES);
        rows.for_each(|(y, numbers)| {
            let line = Line { colour, row: y + 1 };
            let weights = self.weights(line);
            let [ix, iy] = constraint.slope.each_ref().map(|slope| slope.line(line));
            let [u, v] = flow.each_ref().map(|part| part.line(line));
            let rest = constraint.rest.line(line);
            for k in 0..Layout::pixels(line, self.layout.width) {
                let sum = weights.left[k] + weights.right[k] + weights.up[k] + weights.down[k];
                let equation = equation([ix[k], iy[k]], rest[k], [u[k], v[k]], sum);
                let squares = numbers.iter_mut().skip(k).step_by(self.layout.span());
                squares.zip(equation).for_each(|(number, value)| *number = value);
            }
        });
        equations
    }

    /// The weights of the steps from the pixels of a line to each of their neighbours.
    fn weights(&self, line: Line) -> Around<'_> {
        Around {
            left: self.across.around(line).left,
            right: self.across.line(line),
            up: self.down.around(line).up,
            down: self.down.line(line),
        }
    }

    /// One relaxation of all pixels of a colour.
    fn relax(&self, flow: &mut [Board; 2], colour: usize) {
        let mut own = flow.each_mut().map(|part| std::mem::take(&mut part.colours[colour]));
        let others = &*flow;
        let stride = self.layout.stride();
        let [us, vs] = &mut own;
        let rows = us.par_chunks_mut(stride).zip(vs.par_chunks_mut(stride)).enumerate();
        rows.with_min_len(FEW_LINES).skip(1).take(self.layout.height).for_each(|(row, (u, v))| {
            self.relax_line(others, Line { colour, row }, [&mut u[1..], &mut v[1..]]);
        });
        for (part, own) in flow.iter_mut().zip(own) {
            part.colours[colour] = own;
        }
    }

    fn relax_line(&self, others: &[Board; 2], line: Line, [us, vs]: [&mut [f32]; 2]) {
        let span = self.layout.span();
        let numbers = &self.equations[line.colour][(line.row - 1) * NUMBERS * span..][..NUMBERS * span];
        let weights = self.weights(line);
        let around = others.each_ref().map(|part| part.around(line));
        for k in (0..span).step_by(LANES) {
            let [u_sum, v_sum] = [weighted(&weights, &around[0], k), weighted(&weights, &around[1], k)];
            let number = |n: usize| lanes(numbers, n * span + k);
            let (xx, xy, yy, bu, bv) = (number(0), number(1), number(2), number(3), number(4));
            let (mut u, mut v) = (lanes(us, k), lanes(vs, k));
            for lane in 0..LANES {
                let (right_u, right_v) = (bu[lane] + u_sum[lane], bv[lane] + v_sum[lane]);
                u[lane] += RELAXATION * (xx[lane] * right_u + xy[lane] * right_v - u[lane]);
                v[lane] += RELAXATION * (xy[lane] * right_u + yy[lane] * right_v - v[lane]);
            }
            us[k..k + LANES].copy_from_slice(&u);
            vs[k..k + LANES].copy_from_slice(&v);
        }
    }
}

#[inline(always)]
fn lanes(values: &[f32], from: usize) -> Lanes {
    let mut lanes = [0.0; LANES];
    lanes.copy_from_slice(&values[from..from + LANES]);
    lanes
}

/// ∑ weight · value over the four neighbours of the squares from the k-th on.
#[inline(always)]
fn weighted(weights: &Around, values: &Around, k: usize) -> Lanes {
    let mut sum = [0.0; LANES];
    add_product(&mut sum, lanes(weights.left, k), lanes(values.left, k));
    add_product(&mut sum, lanes(weights.right, k), lanes(values.right, k));
    add_product(&mut sum, lanes(weights.up, k), lanes(values.up, k));
    add_product(&mut sum, lanes(weights.down, k), lanes(values.down, k));
    sum
}

#[inline(always)]
fn add_product(sum: &mut Lanes, weights: Lanes, values: Lanes) {
    for lane in 0..LANES {
        sum[lane] += weights[lane] * values[lane];
    }
}

/// λ/ψ of the steps in the flow from the first `pixels` squares of a line to a neighbour, into a row of
/// the board.
fn step_weights(
    flow: &[Board; 2],
    line: Line,
    neighbour: for<'a> fn(Around<'a>) -> &'a [f32],
    out: &mut [f32],
    pixels: usize,
) {
    let [u, v] = flow.each_ref().map(|part| part.line(line).iter().zip(neighbour(part.around(line))));
    for ((weight, u), v) in out[1..].iter_mut().zip(u).zip(v).take(pixels) {
        let (du, dv) = (u.1 - u.0, v.1 - v.0);
        *weight = SMOOTHNESS / (du * du + dv * dv + STEP_EPSILON * STEP_EPSILON).sqrt();
    }
}

/// The numbers of a pixel's equations: its constraint's weight follows from the flow as it is, `sum` is
/// that of the weights of its neighbours.
fn equation([ix, iy]: [f32; 2], rest: f32, [u, v]: [f32; 2], sum: f32) -> [f32; NUMBERS] {
    let difference = ix * u + iy * v + rest;
    let weight = 1.0 / (difference * difference + DATA_EPSILON * DATA_EPSILON).sqrt();
    let (xx, xy, yy) = (weight * ix * ix + sum, weight * ix * iy, weight * iy * iy + sum);
    let determinant = (xx * yy - xy * xy).max(f32::MIN_POSITIVE);
    let right = -weight * rest;
    [yy / determinant, -xy / determinant, xx / determinant, right * ix, right * iy]
}

#[cfg(test)]
mod tests {
    use super::super::image::Image;
    use super::*;

    fn constraint(
        slope: impl Fn(usize, usize) -> [f32; 2] + Sync,
        rest: impl Fn(usize, usize) -> f32 + Sync,
    ) -> Constraint {
        let image = |of: &(dyn Fn(usize, usize) -> f32 + Sync)| Board::of(&Image::from_fn(24, 18, of));
        Constraint {
            slope: [image(&|x, y| slope(x, y)[0]), image(&|x, y| slope(x, y)[1])],
            rest: image(&rest),
        }
    }

    fn solved(constraint: &Constraint) -> [Image; 2] {
        let layout = Layout { width: 24, height: 18 };
        let mut flow = [Board::new(layout), Board::new(layout)];
        (0..10).for_each(|_| solve(constraint, &mut flow, layout));
        flow.map(|part| part.picture())
    }

    /// Gradients in all directions whose constraints all hold for one flow determine it, though each
    /// of them leaves one direction open.
    #[test]
    fn one_flow_that_meets_all_constraints_is_found() {
        let slope = |x: usize, y: usize| [20.0 * (0.7 * x as f32 + 0.2).sin(), 20.0 * (0.9 * y as f32).cos()];
        let rest = |x: usize, y: usize| -(1.5 * slope(x, y)[0] - 0.75 * slope(x, y)[1]);
        let [u, v] = solved(&constraint(slope, rest));
        assert!(
            u.data.iter().all(|u| (u - 1.5).abs() < 2e-3) && v.data.iter().all(|v| (v + 0.75).abs() < 2e-3)
        );
    }

    /// A third of the constraints claim another flow: the robust energy follows the majority, least
    /// squares would go two thirds of the way.
    #[test]
    fn a_minority_is_outvoted() {
        let slope = |x: usize, y: usize| if (x + y).is_multiple_of(2) { [4.0, 0.0] } else { [0.0, 4.0] };
        let wrong = |x: usize, y: usize| (x * 5 + y * 7).is_multiple_of(3);
        let rest = |x: usize, y: usize| if wrong(x, y) { -12.0 } else { -4.0 };
        let [u, v] = solved(&constraint(slope, rest));
        for flow in [u, v] {
            let mut found = flow.data;
            found.sort_by(f32::total_cmp);
            let median = found[found.len() / 2];
            assert!((median - 1.0).abs() < 0.1, "{median}");
        }
    }

    /// Where no constraint holds, the flow is that of the surroundings.
    #[test]
    fn what_is_unknown_is_filled_in() {
        let known = |x: usize| !(9..15).contains(&x);
        let slope = |x: usize, y: usize| match (known(x), y % 2) {
            (false, _) => [0.0; 2],
            (true, 0) => [25.0, 0.0],
            (true, _) => [0.0, 25.0],
        };
        let [u, _] = solved(&constraint(slope, |x, _| if known(x) { -50.0 } else { 0.0 }));
        assert!((u.at(12, 9) - 2.0).abs() < 0.05, "{}", u.at(12, 9));
    }
}
