//! The exact truth of a sequence: where each pixel belongs, and where it is seen next.

use crate::sequence::{Take, Warp};
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

/// One readout of a take's camera: the truth of a frame, computed from the geometry on demand.
///
/// The reference instant is start + T/2: half of the readout, by time.
#[derive(Clone, Copy)]
pub struct Capture<'a> {
    /// What is seen, and who sees it.
    pub take: &'a Take,
    /// When the readout starts, in seconds.
    pub start: f64,
    /// What is done to the frame before it is delivered. Pixels are those of the delivered frame.
    pub warp: Warp,
}

impl Capture<'_> {
    /// The instant that the frame, rectified, shows.
    pub fn reference(&self) -> f64 {
        self.start + self.take.camera.shutter.readout / 2.0
    }

    /// Where the scene point seen at `pixel` is at the reference instant; `None` where it is then
    /// outside the frame or hidden.
    pub fn at_reference(&self, pixel: Vector2<f64>) -> Option<Vector2<f64>> {
        let point = self.point(pixel)?;
        let instant = self.reference();
        let truth = self.take.camera.project(instant, point)?;
        self.take.shows(instant, truth, point).then(|| self.delivered(truth))?
    }

    /// The samples of the frame, every `step` pixels in x and y, that can be judged.
    pub fn samples(&self, step: usize) -> Vec<Sample> {
        let lens = &self.take.camera.lens;
        let places = |length: usize| (step / 2..length).step_by(step.max(1));
        let rows: Vec<usize> = places(lens.height).collect();
        rows.into_par_iter()
            .flat_map_iter(|y| {
                places(lens.width).filter_map(move |x| {
                    let seen = Vector2::new(x as f64, y as f64);
                    self.at_reference(seen).map(|truth| Sample { seen, truth })
                })
            })
            .collect()
    }

    /// Correspondences from this frame to `next`, of the same take, without error: the centres of a
    /// grid of `columns` × `rows` cells, where the points seen there are visible in both.
    pub fn exact_correspondences(&self, next: &Self, columns: usize, rows: usize) -> Vec<Correspondence> {
        let lens = &self.take.camera.lens;
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
                let to = self.seen_by(next, from)?;
                Some(Correspondence { from, to, texture: EXACT_TEXTURE, residual: 0.0 })
            })
            .collect()
    }

    /// Where another frame of the take sees the scene point that this one sees at `pixel`.
    pub fn seen_by(&self, other: &Self, pixel: Vector2<f64>) -> Option<Vector2<f64>> {
        let point = self.point(pixel)?;
        let camera = &other.take.camera;
        let seen = camera.observe(other.start, point)?;
        other.take.shows(camera.exposure(other.start, seen), seen, point).then(|| other.delivered(seen))?
    }

    /// The place in the delivered frame; `None` if it was cut off.
    fn delivered(&self, captured: Vector2<f64>) -> Option<Vector2<f64>> {
        let delivered = self.warp.delivered(captured);
        self.take.camera.lens.contains(delivered).then_some(delivered)
    }

    /// The scene point seen at `pixel`.
    fn point(&self, pixel: Vector2<f64>) -> Option<Vector3<f64>> {
        let camera = &self.take.camera;
        let pixel = self.warp.captured(pixel);
        let (from, direction) = camera.ray(camera.exposure(self.start, pixel), pixel);
        Some(self.take.scene.hit(from, direction)?.point)
    }
}

impl Take {
    /// Whether a point that projects to `pixel` at `instant` is inside the frame and not hidden.
    fn shows(&self, instant: f64, pixel: Vector2<f64>, point: Vector3<f64>) -> bool {
        if !self.camera.lens.contains(pixel) {
            return false;
        }
        let (from, direction) = self.camera.ray(instant, pixel);
        self.scene.hit(from, direction).is_some_and(|hit| (hit.point - point).norm() < 1e-6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::path::uniform;
    use crate::scene::{CameraPath, FirstEdge, Pinhole, RollingCamera, Scene, Shutter, Surface};
    use std::sync::Arc;

    const DEPTH: f64 = 3.0;
    const FOCAL: f64 = 300.0;
    const PERIOD: f64 = 0.04;
    const READOUT: f64 = 0.03;

    /// A camera of 320×240 that looks at a wall, far wider than it sees, at `DEPTH`.
    fn wall(first: FirstEdge, path: impl CameraPath + 'static) -> Take {
        let surface = Surface::new(
            Vector3::new(-30.0, -30.0, DEPTH),
            Vector3::new(60.0, 0.0, 0.0),
            Vector3::new(0.0, 60.0, 0.0),
        );
        let camera = RollingCamera {
            lens: Pinhole { width: 320, height: 240, focal: FOCAL },
            shutter: Shutter { first, readout: READOUT },
            path: Box::new(path),
        };
        let scene = Arc::new(Scene { surfaces: vec![surface], textures: Vec::new() });
        Take { scene, camera }
    }

    fn frame(take: &Take, k: usize) -> Capture<'_> {
        Capture { take, start: k as f64 * PERIOD, warp: Warp::default() }
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
            let take = wall(first, uniform(rate, Vector3::zeros()));
            let samples = frame(&take, 2).samples(16);
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
            let take = wall(first, uniform(0.0, velocity));
            for Sample { seen, truth } in frame(&take, 1).samples(16) {
                let expected = seen - velocity.xy() * (FOCAL / DEPTH * until_reference(first, seen));
                assert!((truth - expected).norm() < 1e-9, "{first:?} {seen}");
            }
        }
    }

    #[test]
    fn exact_correspondences_solve_for_the_row_of_arrival() {
        let velocity = Vector3::new(0.9, 0.6, 0.0);
        let take = wall(FirstEdge::Top, uniform(0.0, velocity));
        let pairs = frame(&take, 3).exact_correspondences(&frame(&take, 4), 8, 6);
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
        let mut take = wall(FirstEdge::Top, uniform(0.0, velocity));
        let truth = frame(&take, 0);
        let visible = Vector2::new(200.0, 60.0);
        assert!(truth.at_reference(visible).is_some());
        assert!(truth.at_reference(Vector2::new(5.0, 0.0)).is_none(), "60 px to the left is outside");
        let hides = truth.at_reference(visible).unwrap();
        let pose = take.camera.path.pose(truth.reference()).position;
        let on_the_way = pose + (take.camera.lens.rays() * hides.push(1.0)) * 0.5;
        let patch = Surface::new(
            on_the_way - Vector3::new(0.01, 0.01, 0.0),
            Vector3::new(0.02, 0.0, 0.0),
            Vector3::new(0.0, 0.02, 0.0),
        );
        let surfaces = [take.scene.surfaces.clone(), vec![patch]].concat();
        take.scene = Arc::new(Scene { surfaces, textures: Vec::new() });
        assert!(frame(&take, 0).at_reference(visible).is_none());
    }
}
