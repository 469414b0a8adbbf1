// SPDX-License-Identifier: MIT OR Apache-2.0

//! A predicted motion sampled at a few nodes, so that its cost does not depend on the predictor.

use super::patch::SIDE;
use nalgebra::Vector2;

/// Nodes along each axis. A homography over an eighth of the frame is linear to within a few per cent of its
/// departure from the mean, which is negligible for a candidate.
const NODES: usize = 9;

/// Predicted displacements in analysed pixels, interpolated linearly between nodes.
#[derive(Debug, Default)]
pub(super) struct FlowPrediction {
    nodes: Vec<[f32; 2]>,
    size: [f32; 2],
}

impl FlowPrediction {
    /// Samples `predict`, which maps full-frame pixels of the first frame to those of the second, or its
    /// inverse if `inverse`, over `size` analysed pixels, each `scale` full-frame pixels wide.
    pub(super) fn fill(
        &mut self,
        (width, height): (usize, usize),
        scale: f64,
        inverse: bool,
        predict: &impl Fn(Vector2<f64>) -> Vector2<f64>,
    ) {
        self.size = [width as f32, height as f32];
        self.nodes.clear();
        let last = (NODES - 1) as f64;
        for index in 0..NODES * NODES {
            let share = [(index % NODES) as f64 / last, (index / NODES) as f64 / last];
            let at = Vector2::new(share[0] * width as f64, share[1] * height as f64) * scale
                - Vector2::new(0.5, 0.5);
            let moved = |from: Vector2<f64>| predict(from) - from;
            let shift = if inverse { -moved(at - moved(at)) } else { moved(at) };
            let shift = shift / scale;
            let is_usable = shift.iter().all(|value| value.abs() <= (width + height) as f64);
            self.nodes.push(if is_usable { [shift.x as f32, shift.y as f32] } else { [0.0; 2] });
        }
    }

    /// The displacement of the patch with top left pixel (x, y) on the level that is 2^`depth` times coarser,
    /// in pixels of that level.
    #[inline(always)]
    pub(super) fn of_patch(&self, depth: usize, x: usize, y: usize) -> [f32; 2] {
        let unit = (1usize << depth) as f32;
        let middle = |at: usize| (at as f32 + 0.5 * SIDE as f32) * unit - 0.5;
        self.at(middle(x), middle(y)).map(|shift| shift / unit)
    }

    /// The displacement at a point of the frame; both in analysed pixels.
    #[inline(always)]
    fn at(&self, x: f32, y: f32) -> [f32; 2] {
        let last = (NODES - 1) as f32;
        // As `clamp`, but maps NaN to 0.
        let place = |at: f32, length: f32| ((at + 0.5) / length * last).max(0.0).min(last - 1e-3);
        let (x, y) = (place(x, self.size[0]), place(y, self.size[1]));
        let (column, row) = (x as usize, y as usize);
        let node =
            |row: usize, column: usize| self.nodes.get(row * NODES + column).copied().unwrap_or_default();
        let blend = |a: [f32; 2], b: [f32; 2], share: f32| {
            [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])]
        };
        let (across, down) = (x - column as f32, y - row as f32);
        let above = blend(node(row, column), node(row, column + 1), across);
        let below = blend(node(row + 1, column), node(row + 1, column + 1), across);
        blend(above, below, down)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_affine_motion_is_kept_and_inverted() {
        let predict = |p: Vector2<f64>| Vector2::new(1.02 * p.x + 3.0, 0.98 * p.y - 2.0);
        let (mut there, mut back) = (FlowPrediction::default(), FlowPrediction::default());
        there.fill((64, 48), 2.0, false, &predict);
        back.fill((64, 48), 2.0, true, &predict);
        // Analysed (20, 30) is (40.5, 60.5) of the full frame.
        let shift = there.at(20.0, 30.0);
        assert!((shift[0] - (0.02 * 40.5 + 3.0) as f32 / 2.0).abs() < 1e-3);
        assert!((shift[1] - (-0.02 * 60.5 - 2.0) as f32 / 2.0).abs() < 1e-3);
        let again = back.at(20.0 + shift[0], 30.0 + shift[1]);
        assert!((again[0] + shift[0]).abs() < 2e-3 && (again[1] + shift[1]).abs() < 2e-3);
    }

    #[test]
    fn nonsense_predicts_no_motion() {
        let mut prediction = FlowPrediction::default();
        prediction.fill((64, 48), 1.0, false, &|_| Vector2::new(f64::NAN, f64::INFINITY));
        assert_eq!(prediction.at(10.0, 10.0), [0.0; 2]);
        assert_eq!(FlowPrediction::default().at(f32::NAN, 0.0), [0.0; 2]);
    }
}
