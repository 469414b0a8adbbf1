// SPDX-License-Identifier: MIT OR Apache-2.0

//! Correspondences out of the flow.

use super::image::Image;
use super::{Flow, Prepared};
use nalgebra::{Matrix2, Vector2};
use rsrectify::correspond::Correspondence;

/// Half of a patch's side, in pixels: as large as the sampler's, 16 × 16.
const HALF_PATCH: isize = 8;

/// How far from its start a point may return, in pixels, when it follows the flow forward and
/// backward. What is hidden in the second frame has no way back.
const MOST_RETURN_ERROR: f32 = 0.5;

/// Correspondences from one frame to the next: the flow at the centres of a grid of `columns` × `rows`
/// cells. Points that leave the frame or do not find their way back are left out.
pub fn correspondences(
    first: &Prepared,
    second: &Prepared,
    [columns, rows]: [usize; 2],
) -> Vec<Correspondence> {
    let (forward, backward) = rayon::join(|| Flow::between(first, second), || Flow::between(second, first));
    let [width, height] = [first.luma.width, first.luma.height];
    let centre =
        |index: usize, cells: usize, length: usize| (index as f64 + 0.5) * length as f64 / cells as f64 - 0.5;
    let cells = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
    cells
        .filter_map(|(column, row)| {
            let from = Vector2::new(centre(column, columns, width), centre(row, rows, height));
            let to = followed(&forward, &backward, from.cast())?;
            let patch = Patch::of(&first.luma, &second.luma, &forward, from.cast());
            let (texture, residual) = (patch.texture(), patch.residual());
            Some(Correspondence { from, to: to.cast(), texture, residual, covariance: Matrix2::zeros() })
        })
        .collect()
}

/// Where a point is seen in the second frame, if it is and finds its way back.
fn followed(forward: &Flow, backward: &Flow, from: Vector2<f32>) -> Option<Vector2<f32>> {
    let to = from + Vector2::from(forward.at(from.x, from.y));
    if !backward.u.contains(to.x, to.y) {
        return None;
    }
    let back = to + Vector2::from(backward.at(to.x, to.y));
    ((back - from).norm() <= MOST_RETURN_ERROR).then_some(to)
}

/// Sums over the pixels of a patch, as far as they are in the frame.
#[derive(Default)]
struct Patch {
    count: f32,
    /// Of the gradients' products: xx, xy, yy.
    gradients: [f32; 3],
    /// Of the differences between the frames along the flow, and of their squares.
    differences: [f32; 2],
}

impl Patch {
    /// The 16 × 16 pixels around a point of the first frame.
    fn of(first: &Image, second: &Image, flow: &Flow, centre: Vector2<f32>) -> Self {
        let pixels = |middle: f32, length: usize| {
            let start = (middle + 0.5).floor() as isize - HALF_PATCH;
            start.max(0) as usize..((start + 2 * HALF_PATCH) as usize).min(length)
        };
        let mut patch = Self::default();
        for y in pixels(centre.y, first.height) {
            for x in pixels(centre.x, first.width) {
                patch.add(first, second, flow, x, y);
            }
        }
        patch
    }

    fn add(&mut self, first: &Image, second: &Image, flow: &Flow, x: usize, y: usize) {
        let (column, row) = (x as isize, y as isize);
        let gx = 0.5 * (first.clamped(column + 1, row) - first.clamped(column - 1, row));
        let gy = 0.5 * (first.clamped(column, row + 1) - first.clamped(column, row - 1));
        let products = [gx * gx, gx * gy, gy * gy];
        self.gradients.iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
        let to = [x as f32 + flow.u.at(x, y), y as f32 + flow.v.at(x, y)];
        let difference = second.cubic(to[0], to[1]).value - first.at(x, y);
        self.differences[0] += difference;
        self.differences[1] += difference * difference;
        self.count += 1.0;
    }

    /// The smaller eigenvalue of the gradients' matrix, per pixel.
    fn texture(&self) -> f32 {
        let [xx, xy, yy] = self.gradients;
        let smaller = 0.5 * (xx + yy) - (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        smaller.max(0.0) / self.count
    }

    /// The root mean square difference, less its mean.
    fn residual(&self) -> f32 {
        let [sum, squares] = self.differences.map(|sum| sum / self.count);
        (squares - sum * sum).max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uniform(u: f32, v: f32) -> Flow {
        let constant = |value: f32| Image::from_fn(40, 30, |_, _| value);
        Flow { u: constant(u), v: constant(v) }
    }

    #[test]
    fn only_points_that_stay_and_return_are_followed() {
        let from = Vector2::new(30.0, 10.0);
        let followed = |forward, backward| followed(&forward, &backward, from);
        assert_eq!(followed(uniform(5.0, -2.0), uniform(-5.25, 2.25)), Some(Vector2::new(35.0, 8.0)));
        assert_eq!(followed(uniform(5.0, -2.0), uniform(-4.25, 2.0)), None);
        assert_eq!(followed(uniform(9.5, 0.0), uniform(-9.5, 0.0)), None);
    }

    #[test]
    fn texture_and_residual_by_hand() {
        let patch = |first: &Image, second: &Image| {
            Patch::of(first, second, &uniform(1.0, 0.0), Vector2::new(19.5, 14.5))
        };
        // A ramp has no texture along its lines. One that moved on by its flow and became brighter by 3
        // has no residual.
        let ramp = |start: f32| Image::from_fn(40, 30, move |x, _| start + 4.0 * x as f32);
        let moved = patch(&ramp(0.0), &ramp(3.0 - 4.0));
        assert_eq!((moved.count, moved.texture()), (256.0, 0.0));
        assert!(moved.residual() < 1e-2, "{}", moved.residual());
        // A roof of gradient (4, ∓2): the products xy cancel and the eigenvalues are 16 and 4, but for the
        // 2 of 16 rows at the ridge, where the central difference down is half of theirs.
        let roof = Image::from_fn(40, 30, |x, y| 4.0 * x as f32 + 2.0 * (y as f32 - 14.5).abs());
        let texture = patch(&roof, &roof).texture();
        assert!((texture - (4.0 * 14.0 + 1.0 * 2.0) / 16.0).abs() < 0.01, "{texture}");
        // Stripes of ±5 that the second frame shows inverted differ by ±10.
        let stripes = |sign: f32| {
            Image::from_fn(40, 30, move |_, y| if y.is_multiple_of(2) { 5.0 * sign } else { -5.0 * sign })
        };
        assert!((patch(&stripes(1.0), &stripes(-1.0)).residual() - 10.0).abs() < 1e-3);
    }
}
