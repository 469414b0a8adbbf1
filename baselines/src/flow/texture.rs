// SPDX-License-Identifier: MIT OR Apache-2.0

//! A picture less most of its large structure, which a change of light changes most.
//!
//! A. Wedel, T. Pock, C. Zach, H. Bischof, D. Cremers, *An Improved Algorithm for TV-L1 Optical Flow*,
//! 2009: the structure S is the solution of Rudin, Osher and Fatemi's min ∫ |∇S| + (S − I)²/2θ, and
//! I − 0.95·S is what the flow is computed on. S is found by Chambolle's projections: S = I + θ div p,
//! p ← Π(p + τ/θ ∇S), with Π the projection of each p to the unit disc.

use super::image::Image;
use rayon::prelude::*;

/// Share of the structure that is taken away.
const SHARE: f32 = 0.95;

/// θ: 1/8 for pictures from −1 to 1, hence for grey levels 0 to 255.
const THETA: f32 = 127.5 / 8.0;

/// τ, the length of a step; at most ¼.
const STEP: f32 = 0.25;

/// Projections.
const ITERATIONS: usize = 50;

/// The texture of a picture of grey levels 0 to 255.
pub fn of(image: &Image) -> Image {
    let structure = structure(image);
    let data = image.data.iter().zip(&structure.data).map(|(whole, structure)| whole - SHARE * structure);
    Image::new(image.width, image.height, data.collect())
}

fn structure(image: &Image) -> Image {
    let width = image.width;
    let mut dual = [image.map(|_| 0.0), image.map(|_| 0.0)];
    let mut structure = image.clone();
    for _ in 0..ITERATIONS {
        let [px, py] = &mut dual;
        let rows = px.data.par_chunks_mut(width).zip(py.data.par_chunks_mut(width)).enumerate();
        rows.with_min_len(32).for_each(|(y, (px, py))| {
            let below = structure.row((y + 1).min(structure.height - 1));
            project_row(structure.row(y), below, px, py);
        });
        let rows = structure.data.par_chunks_mut(width).enumerate();
        rows.with_min_len(32).for_each(|(y, out)| {
            let above = y.checked_sub(1).map(|above| dual[1].row(above));
            compose_row(image.row(y), [dual[0].row(y), dual[1].row(y)], above, out);
        });
    }
    structure
}

/// p ← Π(p + τ/θ ∇S) in one row; differences forward, none at the border.
fn project_row(row: &[f32], below: &[f32], px: &mut [f32], py: &mut [f32]) {
    let last = row.len() - 1;
    for x in 0..row.len() {
        let across = row[(x + 1).min(last)] - row[x];
        let (x_part, y_part) = (px[x] + STEP / THETA * across, py[x] + STEP / THETA * (below[x] - row[x]));
        let length = (x_part * x_part + y_part * y_part).sqrt().max(1.0);
        (px[x], py[x]) = (x_part / length, y_part / length);
    }
}

/// S = I + θ div p in one row; `above` is the y part of the row above.
fn compose_row(row: &[f32], [px, py]: [&[f32]; 2], above: Option<&[f32]>, out: &mut [f32]) {
    let mut left = 0.0;
    for x in 0..row.len() {
        let divergence = (px[x] - left) + (py[x] - above.map_or(0.0, |above| above[x]));
        left = px[x];
        out[x] = row[x] + THETA * divergence;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flat_picture_keeps_a_twentieth() {
        let texture = of(&Image::new(9, 7, vec![100.0; 63]));
        assert!(texture.data.iter().all(|value| (value - 5.0).abs() < 1e-4));
    }

    #[test]
    fn fine_detail_is_texture_and_large_steps_are_structure() {
        // Stripes one pixel wide of ±2 on a step of 100: a curve as long as the picture is high that
        // encloses half of it lowers S by θ/(half of the width) only, while stripes of less than
        // ±2θ vanish from S.
        let step = |x: usize| if x < 32 { 50.0 } else { 150.0 };
        let stripe = |x: usize| if x.is_multiple_of(2) { 2.0 } else { -2.0 };
        let texture = of(&Image::from_fn(64, 16, |x, _| step(x) + stripe(x)));
        for x in [10, 11, 50, 51] {
            let expected = 0.05 * step(x) + stripe(x);
            let found = texture.at(x, 8);
            assert!((found - expected).abs() < 1.5, "{x}: {found} is not {expected}");
        }
    }
}
