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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::path::{Motion, uniform};
    use crate::scene::{CameraPath, FirstEdge, Pinhole, RollingCamera, Scene, Shutter, Surface};
    use crate::sequence::{Settings, Strength, named};
    use std::sync::Arc;

    const DEPTH: f64 = 3.0;
    const FOCAL: f64 = 300.0;
    const PERIOD: f64 = 0.04;
    const READOUT: f64 = 0.03;

    /// A camera of 320×240 that looks at a wall, far wider than it sees, at `DEPTH`.
    fn wall(first: FirstEdge, path: impl CameraPath + 'static) -> Sequence {
        let surface = Surface::new(
            Vector3::new(-30.0, -30.0, DEPTH),
            Vector3::new(60.0, 0.0, 0.0),
            Vector3::new(0.0, 60.0, 0.0),
        );
        let settings = Settings {
            fps: 1.0 / PERIOD,
            readout_ratio: READOUT / PERIOD,
            motion: Motion::Still,
            strength: Strength::Amplitude(0.0),
            ..named("rot1_B0").unwrap()
        };
        let camera = RollingCamera {
            lens: Pinhole { width: 320, height: 240, focal: FOCAL },
            shutter: Shutter { first, readout: READOUT },
            path: Box::new(path),
        };
        let scene = Arc::new(Scene { surfaces: vec![surface], textures: Vec::new() });
        Sequence { settings, scene, camera }
    }

    /// Time from a pixel's exposure to the middle of the readout, written out by direction.
    fn until_reference(first: FirstEdge, pixel: Vector2<f64>) -> f64 {
        READOUT
            * match first {
                FirstEdge::Top => 0.5 - (pixel.y + 0.5) / 240.0,
                FirstEdge::Bottom => 0.5 - (239.5 - pixel.y) / 240.0,
                FirstEdge::Left => 0.5 - (pixel.x + 0.5) / 320.0,
                FirstEdge::Right => 0.5 - (319.5 - pixel.x) / 320.0,
            }
    }

    const EDGES: [FirstEdge; 4] = [FirstEdge::Top, FirstEdge::Bottom, FirstEdge::Left, FirstEdge::Right];

    #[test]
    fn a_turn_about_the_axis_displaces_by_a_rotation() {
        let (rate, centre) = (1.3, Vector2::new(159.5, 119.5));
        for first in EDGES {
            let sequence = wall(first, uniform(rate, Vector3::zeros()));
            let samples = sequence.truth().samples(2, 16);
            assert!(samples.len() > 250);
            for Sample { seen, truth } in samples {
                // The picture turns against the camera.
                let (sin, cos) = (-rate * until_reference(first, seen)).sin_cos();
                let x = seen - centre;
                let expected = centre + Vector2::new(cos * x.x - sin * x.y, sin * x.x + cos * x.y);
                assert!((truth - expected).norm() < 1e-9, "{first:?} {seen}");
            }
        }
    }

    #[test]
    fn a_move_along_a_wall_displaces_by_a_translation() {
        let velocity = Vector3::new(1.5, -0.7, 0.0);
        for first in EDGES {
            let sequence = wall(first, uniform(0.0, velocity));
            for Sample { seen, truth } in sequence.truth().samples(1, 16) {
                let expected = seen - velocity.xy() * (FOCAL / DEPTH * until_reference(first, seen));
                assert!((truth - expected).norm() < 1e-9, "{first:?} {seen}");
            }
        }
    }

    #[test]
    fn exact_correspondences_solve_for_the_row_of_arrival() {
        let velocity = Vector3::new(0.9, 0.6, 0.0);
        let sequence = wall(FirstEdge::Top, uniform(0.0, velocity));
        let pairs = sequence.truth().exact_correspondences(3, 8, 6);
        assert!(pairs.len() >= 36);
        let image = -velocity.xy() * (FOCAL / DEPTH);
        for pair in pairs {
            // y′ − y = v (P + T (y′ − y)/N), solved for y′ − y.
            let rise = image.y * PERIOD / (1.0 - image.y * READOUT / 240.0);
            let elapsed = PERIOD + READOUT * rise / 240.0;
            assert!((pair.to - pair.from - image * elapsed).norm() < 1e-8);
        }
    }

    #[test]
    fn points_that_leave_the_frame_or_hide_are_not_judged() {
        let velocity = Vector3::new(40.0, 0.0, 0.0);
        let mut sequence = wall(FirstEdge::Top, uniform(0.0, velocity));
        let truth = sequence.truth();
        let visible = Vector2::new(200.0, 60.0);
        assert!(truth.at_reference(0, visible).is_some());
        assert!(truth.at_reference(0, Vector2::new(5.0, 0.0)).is_none(), "60 px to the left is outside");
        let hides = truth.at_reference(0, visible).unwrap();
        let pose = sequence.camera.path.pose(truth.reference(0)).position;
        let on_the_way = pose + (sequence.camera.lens.rays() * hides.push(1.0)) * 0.5;
        let patch = Surface::new(
            on_the_way - Vector3::new(0.01, 0.01, 0.0),
            Vector3::new(0.02, 0.0, 0.0),
            Vector3::new(0.0, 0.02, 0.0),
        );
        let surfaces = [sequence.scene.surfaces.clone(), vec![patch]].concat();
        sequence.scene = Arc::new(Scene { surfaces, textures: Vec::new() });
        assert!(sequence.truth().at_reference(0, visible).is_none());
    }
}
