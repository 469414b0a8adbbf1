//! The exact truth of a sequence: where each pixel belongs, and where it is seen next.

use crate::metrics::{Stats, distances};
use crate::sequence::Sequence;
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;
use rsrectify::correspond::Correspondence;

/// Texture given to exact correspondences: as good as a patch of full contrast.
const EXACT_TEXTURE: f32 = 1000.0;

/// A pixel of a frame as it arrived and its place at the reference instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The pixel as it was seen.
    pub seen: Vector2<f64>,
    /// Where the same scene point is seen at the reference instant.
    pub truth: Vector2<f64>,
}

/// The truth of a sequence, computed from its geometry on demand.
///
/// The reference instant of frame k is t_k + T/2: half of the readout, by time.
pub struct Truth<'a> {
    sequence: &'a Sequence,
}

impl<'a> Truth<'a> {
    /// The truth of `sequence`.
    pub fn new(sequence: &'a Sequence) -> Self {
        Self { sequence }
    }

    /// The instant that frame `k`, rectified, shows.
    pub fn reference(&self, k: usize) -> f64 {
        self.sequence.start(k) + self.sequence.camera.shutter.readout / 2.0
    }

    /// Where the scene point seen at `pixel` of frame `k` is at the reference instant; `None`
    /// where it is then outside the frame or hidden.
    pub fn at_reference(&self, k: usize, pixel: Vector2<f64>) -> Option<Vector2<f64>> {
        let point = self.point(k, pixel)?;
        let instant = self.reference(k);
        let truth = self.sequence.camera.project(instant, point)?;
        self.is_visible(instant, truth, point).then_some(truth)
    }

    /// The samples of frame `k`, every `step` pixels in x and y, that can be judged.
    pub fn samples(&self, k: usize, step: usize) -> Vec<Sample> {
        let lens = &self.sequence.camera.lens;
        let places = |length: usize| (step / 2..length).step_by(step.max(1));
        let rows: Vec<usize> = places(lens.height).collect();
        rows.into_par_iter()
            .flat_map_iter(|y| {
                places(lens.width).filter_map(move |x| {
                    let seen = Vector2::new(x as f64, y as f64);
                    self.at_reference(k, seen).map(|truth| Sample { seen, truth })
                })
            })
            .collect()
    }

    /// The displacement of the sequence as it arrives, sampled every `step` pixels.
    pub fn uncorrected(&self, step: usize) -> Stats {
        let all = 0..self.sequence.settings.frames;
        Stats::of(all.flat_map(|k| distances(&self.samples(k, step), |x| x).collect::<Vec<_>>()).collect())
    }

    /// Correspondences from frame `k` to frame `k + 1` without error: the centres of a grid of
    /// `columns` × `rows` cells, where the points seen there are visible in both.
    pub fn exact_correspondences(&self, k: usize, columns: usize, rows: usize) -> Vec<Correspondence> {
        let lens = &self.sequence.camera.lens;
        let centre = |index: usize, cells: usize, length: usize| {
            (index as f64 + 0.5) * length as f64 / cells as f64 - 0.5
        };
        let cells = (0..rows * columns).into_par_iter();
        cells
            .filter_map(|cell| {
                let from = Vector2::new(
                    centre(cell % columns, columns, lens.width),
                    centre(cell / columns, rows, lens.height),
                );
                let to = self.seen_next(k, from)?;
                Some(Correspondence { from, to, texture: EXACT_TEXTURE, residual: 0.0 })
            })
            .collect()
    }

    /// Where frame `k + 1` sees the scene point that frame `k` sees at `pixel`.
    fn seen_next(&self, k: usize, pixel: Vector2<f64>) -> Option<Vector2<f64>> {
        let point = self.point(k, pixel)?;
        let start = self.sequence.start(k + 1);
        let seen = self.sequence.camera.observe(start, point)?;
        let instant = self.sequence.camera.exposure(start, seen);
        self.is_visible(instant, seen, point).then_some(seen)
    }

    /// The scene point seen at `pixel` of frame `k`.
    fn point(&self, k: usize, pixel: Vector2<f64>) -> Option<Vector3<f64>> {
        let instant = self.sequence.camera.exposure(self.sequence.start(k), pixel);
        let (from, direction) = self.sequence.camera.ray(instant, pixel);
        Some(self.sequence.scene.hit(from, direction)?.point)
    }

    /// Whether a point that projects to `pixel` at `instant` is inside the frame and not hidden.
    fn is_visible(&self, instant: f64, pixel: Vector2<f64>, point: Vector3<f64>) -> bool {
        if !self.sequence.camera.lens.contains(pixel) {
            return false;
        }
        let (from, direction) = self.sequence.camera.ray(instant, pixel);
        self.sequence.scene.hit(from, direction).is_some_and(|hit| (hit.point - point).norm() < 1e-6)
    }
}
