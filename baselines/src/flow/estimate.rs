// SPDX-License-Identifier: MIT OR Apache-2.0

//! From two pyramids to a flow: coarse to fine, several warps a level.

use super::board::{Board, Layout};
use super::field::Flow;
use super::image::Image;
use super::median;
use super::prepared::Prepared;
use super::solver::{Constraint, solve};
use rayon::prelude::*;

/// Linearisations on each level.
const WARPS: usize = 5;

impl Flow {
    /// The flow from one frame to another of the same size.
    ///
    /// # Panics
    /// Where the sizes differ.
    pub fn between(first: &Prepared, second: &Prepared) -> Self {
        let size = |frame: &Prepared| (frame.luma.width, frame.luma.height);
        assert_eq!(size(first), size(second), "flow between frames of different sizes");
        let coarsest = &first.levels[first.levels.len() - 1];
        let mut flow = Flow::zero(coarsest.width, coarsest.height);
        for (first, second) in first.levels.iter().zip(&second.levels).rev() {
            flow = flow.on_level(first.width, first.height);
            let slopes = Slopes::of(first);
            for _ in 0..WARPS {
                flow = improved(first, &slopes, second, &flow);
            }
        }
        flow
    }
}

/// ∂/∂x and ∂/∂y of a picture.
struct Slopes(Vec<[f32; 2]>);

impl Slopes {
    fn of(image: &Image) -> Self {
        let rows = (0..image.height).into_par_iter().with_min_len(16);
        Self(rows.flat_map_iter(|y| (0..image.width).map(move |x| image.slope(x, y))).collect())
    }
}

/// One warp: the second picture is brought to the first, the difference is linearised around the flow, the
/// energy minimised, and the flow freed of outliers by a median filter (Sun et al., section 4).
fn improved(first: &Image, slopes: &Slopes, second: &Image, flow: &Flow) -> Flow {
    let layout = Layout { width: first.width, height: first.height };
    let constraint = linearised(first, slopes, second, flow);
    let mut boards = [Board::of(&flow.u), Board::of(&flow.v)];
    solve(&constraint, &mut boards, layout);
    let [u, v] = boards.map(|board| median::filtered(&board.picture()));
    Flow { u, v }
}

/// I₂(x + w) − I₁(x) as a linear function of w, its slope the mean of both pictures'. Zero where
/// x + w is outside.
fn linearised(first: &Image, slopes: &Slopes, second: &Image, flow: &Flow) -> Constraint {
    let width = first.width;
    let mut parts = [(); 3].map(|()| vec![0.0; first.data.len()]);
    let [ix, iy, rest] = &mut parts;
    let rows = (ix.par_chunks_mut(width), iy.par_chunks_mut(width), rest.par_chunks_mut(width));
    rows.into_par_iter().enumerate().with_min_len(16).for_each(|(y, (ix, iy, rest))| {
        for x in 0..width {
            let [u, v] = [flow.u.at(x, y), flow.v.at(x, y)];
            let to = [x as f32 + u, y as f32 + v];
            if !second.contains(to[0], to[1]) {
                continue;
            }
            let there = second.cubic(to[0], to[1]);
            let here = slopes.0[y * width + x];
            ix[x] = 0.5 * (there.slope[0] + here[0]);
            iy[x] = 0.5 * (there.slope[1] + here[1]);
            rest[x] = there.value - first.at(x, y) - ix[x] * u - iy[x] * v;
        }
    });
    let [ix, iy, rest] = parts.map(|part| Board::of(&Image::new(width, first.height, part)));
    Constraint { slope: [ix, iy], rest }
}
