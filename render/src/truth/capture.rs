// SPDX-License-Identifier: MIT OR Apache-2.0

//! The exact truth of a frame: where each pixel belongs, and where it is seen next.

use crate::scene::Hit;
use crate::sequence::{Settings, Take, Warp};
use nalgebra::Vector2;
use rayon::prelude::*;

/// A pixel of a frame as it arrived and its place at the reference instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The pixel as it was seen.
    pub seen: Vector2<f64>,
    /// Where the same scene point is seen at the reference instant.
    pub truth: Vector2<f64>,
}

/// The same scene point in two frames, in pixels, without error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExactMatch {
    /// Where the first frame shows it.
    pub from: Vector2<f64>,
    /// Where the second frame shows it.
    pub to: Vector2<f64>,
}

/// One readout of a take's camera: the truth of a frame, computed from the geometry on demand.
///
/// The reference instant is that at which the middle of the delivered frame was exposed: start + T/2, half of the
/// readout by time, unless the frame was moved by a stabiliser.
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
        let centre = self.take.camera.lens.centre();
        let exposure = || self.take.camera.exposure(self.start, self.warp.captured(centre));
        self.warp.rows_turned_to.unwrap_or_else(exposure)
    }

    /// Where the scene point seen at `pixel` is at the reference instant; `None` where it is then
    /// outside the frame or hidden.
    pub fn at_reference(&self, pixel: Vector2<f64>) -> Option<Vector2<f64>> {
        self.to_share(pixel, 0.5)
    }

    /// Where the scene point seen at `pixel` is when the share of the readout has elapsed (0: its
    /// start, ½: the reference instant, 1: its end); `None` where it is then outside or hidden.
    pub fn to_share(&self, pixel: Vector2<f64>, share: f64) -> Option<Vector2<f64>> {
        let Take { scene, camera } = self.take;
        let instant = self.reference() + (share - 0.5) * camera.shutter.readout / self.warp.zoom;
        let point = self.point(pixel)?;
        let truth = camera.project(instant, scene.position(instant, &point))?;
        self.take.shows(instant, truth, &point).then(|| self.visible(self.warp.delivered(truth)))?
    }

    /// The samples of the frame, every `step` pixels in x and y, that can be judged.
    pub fn samples(&self, step: usize) -> Vec<Sample> {
        let [columns, rows] = self.places(step);
        let places = (0..columns.len() * rows.len()).into_par_iter();
        places
            .filter_map(|index| {
                let (x, y) = (columns[index % columns.len()], rows[index / columns.len()]);
                let seen = Vector2::new(x as f64, y as f64);
                self.at_reference(seen).map(|truth| Sample { seen, truth })
            })
            .collect()
    }

    /// Matches of this frame with `next`, of the same take: the centres of a grid of `columns` × `rows` cells, where the
    /// points seen there are visible in both.
    pub fn exact_matches(&self, next: &Self, columns: usize, rows: usize) -> Vec<ExactMatch> {
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
                Some(ExactMatch { from, to })
            })
            .collect()
    }

    /// Where another frame of the take sees the scene point that this one sees at `pixel`.
    pub fn seen_by(&self, other: &Self, pixel: Vector2<f64>) -> Option<Vector2<f64>> {
        other.observe(&self.point(pixel)?)
    }

    /// Where this frame sees a point of an object; `None` where that is outside it or hidden.
    pub(super) fn observe(&self, point: &Hit) -> Option<Vector2<f64>> {
        let Take { scene, camera } = self.take;
        let seen = camera.observe(self.start, |t| scene.position(t, point))?;
        self.take.shows(camera.exposure(self.start, seen), seen, point).then(|| self.delivered(seen))?
    }

    /// The place in the delivered frame of a place in the rolling one; `None` if it was cut off.
    fn delivered(&self, captured: Vector2<f64>) -> Option<Vector2<f64>> {
        let camera = &self.take.camera;
        let turned = match self.warp.rows_turned_to {
            None => captured,
            Some(t) => {
                let (_, direction) = camera.ray(camera.exposure(self.start, captured), captured);
                camera.project(t, camera.path.pose(t).position + direction)?
            }
        };
        self.visible(self.warp.delivered(turned))
    }

    /// Where a place of the delivered frame was in the rolling one.
    pub fn captured(&self, delivered: Vector2<f64>) -> Vector2<f64> {
        let (camera, turned) = (&self.take.camera, self.warp.captured(delivered));
        let Some(instant) = self.warp.rows_turned_to else { return turned };
        let (_, direction) = camera.ray(instant, turned);
        // The rolling frame sees what lies in this direction as if the camera only turned.
        camera.observe(self.start, |t| camera.path.pose(t).position + direction).unwrap_or(turned)
    }

    /// A place that is inside the delivered frame.
    fn visible(&self, delivered: Vector2<f64>) -> Option<Vector2<f64>> {
        self.take.camera.lens.contains(delivered).then_some(delivered)
    }

    /// How far the scene point seen at `pixel` is from the camera, in metres.
    pub fn distance(&self, pixel: Vector2<f64>) -> Option<f64> {
        let instant = self.take.camera.exposure(self.start, self.captured(pixel));
        let place = self.take.scene.position(instant, &self.point(pixel)?);
        Some((place - self.take.camera.path.pose(instant).position).norm())
    }

    /// The columns and the rows at which the frame is sampled every `step` pixels.
    pub fn places(&self, step: usize) -> [Vec<usize>; 2] {
        let lens = &self.take.camera.lens;
        [lens.width, lens.height].map(|length| (step / 2..length).step_by(step.max(1)).collect())
    }

    /// The point of an object seen at `pixel`.
    fn point(&self, pixel: Vector2<f64>) -> Option<Hit> {
        let pixel = self.captured(pixel);
        self.take.look(self.take.camera.exposure(self.start, pixel), pixel)
    }
}

impl Take {
    /// The truth of capture `k`.
    pub fn capture(&self, settings: &Settings, k: usize) -> Capture<'_> {
        let start = k as f64 / settings.fps;
        let middle = start + settings.readout_time() / 2.0;
        let stabilised =
            settings.stabilisation.map(|s| s.warp(&self.scene, &self.camera, middle, settings.fps));
        Capture { take: self, start, warp: stabilised.unwrap_or_default() }
    }

    /// What is seen at `pixel` at an instant.
    pub(super) fn look(&self, instant: f64, pixel: Vector2<f64>) -> Option<Hit> {
        let (from, direction) = self.camera.ray(instant, pixel);
        self.scene.hit(instant, from, direction)
    }

    /// Whether a point that projects to `pixel` at `instant` is inside the frame and not hidden.
    fn shows(&self, instant: f64, pixel: Vector2<f64>, point: &Hit) -> bool {
        let place = |hit: &Hit| self.scene.position(instant, hit);
        self.camera.lens.contains(pixel)
            && self.look(instant, pixel).is_some_and(|hit| (place(&hit) - place(point)).norm() < 1e-6)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::scene::path::{Oscillation, Oscillations, uniform};
    use crate::scene::{CameraPath, FirstEdge, Lens, Mover, Pose, RollingCamera, Scene, Shutter, Surface};
    use crate::sequence::{Move, Stabilisation};
    use nalgebra::{Rotation3, Vector3};
    use std::sync::Arc;

    pub const DEPTH: f64 = 3.0;
    pub const FOCAL: f64 = 300.0;
    pub const PERIOD: f64 = 0.04;
    pub const READOUT: f64 = 0.03;

    /// A camera of 320×240 that looks at a wall, far wider than it sees, at `DEPTH`.
    pub fn wall(first: FirstEdge, path: impl CameraPath + 'static) -> Take {
        let surface = Surface::new(
            Vector3::new(-30.0, -30.0, DEPTH),
            Vector3::new(60.0, 0.0, 0.0),
            Vector3::new(0.0, 60.0, 0.0),
        );
        let camera = RollingCamera {
            lens: Lens::pinhole(320, 240, FOCAL),
            shutter: Shutter { first, readout: READOUT, open: 0.0 },
            path: Box::new(path),
        };
        let scene = Arc::new(Scene { surfaces: vec![surface], ..Scene::default() });
        Take { scene, camera }
    }

    pub fn frame(take: &Take, k: usize) -> Capture<'_> {
        Capture { take, start: k as f64 * PERIOD, warp: Warp::default() }
    }

    /// Time from a pixel's exposure to the middle of the readout, written out by direction.
    pub fn until_reference(first: FirstEdge, pixel: Vector2<f64>) -> f64 {
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
    fn a_crop_shortens_the_readout_of_what_is_visible() {
        // A steady move along a wall is not stabilised, only enlarged: the velocity grows by the zoom, the readout of
        // the visible rows shrinks by it.
        let (velocity, zoom) = (Vector3::new(1.5, -0.7, 0.0), 1.25);
        let stabilisation = Stabilisation { kind: Move::Similarity, smoothing: 3.0, zoom };
        for first in EDGES {
            let take = wall(first, uniform(0.0, velocity));
            let plain = frame(&take, 1);
            let warp = stabilisation.warp(&take.scene, &take.camera, plain.reference(), 1.0 / PERIOD);
            let capture = Capture { warp, ..plain };
            assert!((capture.reference() - plain.reference()).abs() < 1e-9);
            for Sample { seen, truth } in capture.samples(16) {
                let elapsed = until_reference(first, seen) / zoom;
                let expected = seen - velocity.xy() * (zoom * FOCAL / DEPTH * elapsed);
                assert!((truth - expected).norm() < 1e-6, "{first:?} {seen}: {truth} {expected}");
            }
        }
    }

    #[test]
    fn rows_are_turned_and_turned_back() {
        let turning = |t: f64| Pose {
            rotation: Rotation3::from_euler_angles(0.4 * t, -0.9 * t, 0.7 * t),
            position: Vector3::new(0.3 * t, 0.0, 0.2 * t),
        };
        let stabilisation = Stabilisation { kind: Move::TurnByRow, smoothing: 3.0, zoom: 1.2 };
        let take = wall(FirstEdge::Bottom, turning);
        let plain = frame(&take, 2);
        let warp = stabilisation.warp(&take.scene, &take.camera, plain.reference(), 1.0 / PERIOD);
        let capture = Capture { warp, ..plain };
        for pixel in [[20.0, 30.0], [159.5, 119.5], [300.0, 220.0]].map(Vector2::from) {
            let captured = capture.captured(pixel);
            assert!((captured - warp.captured(pixel)).norm() > 0.1 || pixel.y == 119.5);
            assert!((capture.delivered(captured).unwrap() - pixel).norm() < 1e-6, "{pixel}");
        }
    }

    #[test]
    fn exact_matches_solve_for_the_row_of_arrival() {
        let velocity = Vector3::new(0.9, 0.6, 0.0);
        let take = wall(FirstEdge::Top, uniform(0.0, velocity));
        let pairs = frame(&take, 3).exact_matches(&frame(&take, 4), 8, 6);
        assert!(pairs.len() >= 36);
        let image = -velocity.xy() * (FOCAL / DEPTH);
        for pair in pairs {
            // y′ − y = v (P + T (y′ − y)/N), solved for y′ − y.
            let rise = image.y * PERIOD / (1.0 - image.y * READOUT / 240.0);
            let elapsed = PERIOD + READOUT * rise / 240.0;
            assert!((pair.to - pair.from - image * elapsed).norm() < 1e-8);
        }
    }

    /// Where the swinging wall is at time `t`, in metres.
    fn swing(t: f64) -> Vector2<f64> {
        Vector2::new(0.3, -0.2) * (std::f64::consts::TAU * (1.5 * t + 0.1)).sin()
    }

    /// The wall of [`wall`] before a camera at rest, carried by a mover along [`swing`].
    fn swinging_wall(first: FirstEdge) -> Take {
        let mut take = wall(first, uniform(0.0, Vector3::zeros()));
        let along = |amplitude| vec![Oscillation { amplitude, frequency: 1.5, phase: 0.1 }];
        let path = Oscillations {
            fps: 1.0,
            rotation: Default::default(),
            position: [along(0.3), along(-0.2), Vec::new()],
            zoom: Vec::new(),
        };
        let surfaces = take.scene.surfaces.iter().map(|wall| wall.clone().carried(0)).collect();
        let movers = vec![Mover { rest: Vector3::zeros(), path }];
        take.scene = Arc::new(Scene { surfaces, movers, ..Scene::default() });
        take
    }

    #[test]
    fn the_truth_follows_an_object_that_moves_on_its_own() {
        for first in EDGES {
            let take = swinging_wall(first);
            let capture = frame(&take, 2);
            let samples = capture.samples(16);
            assert!(samples.len() > 250);
            for Sample { seen, truth } in samples {
                let shift =
                    swing(capture.reference()) - swing(capture.reference() - until_reference(first, seen));
                assert!((truth - seen - shift * (FOCAL / DEPTH)).norm() < 1e-9, "{first:?} {seen}");
            }
        }
    }

    #[test]
    fn exact_matches_follow_an_object_that_moves_on_its_own() {
        let take = swinging_wall(FirstEdge::Top);
        let time = |k: f64, pixel: Vector2<f64>| k * PERIOD + READOUT * (pixel.y + 0.5) / 240.0;
        let pairs = frame(&take, 3).exact_matches(&frame(&take, 4), 8, 6);
        assert!(pairs.len() >= 36);
        for pair in pairs {
            let shift = swing(time(4.0, pair.to)) - swing(time(3.0, pair.from));
            assert!((pair.to - pair.from - shift * (FOCAL / DEPTH)).norm() < 1e-7);
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
        let on_the_way = pose + take.camera.lens.ray(hides) * 0.5;
        let patch = Surface::new(
            on_the_way - Vector3::new(0.01, 0.01, 0.0),
            Vector3::new(0.02, 0.0, 0.0),
            Vector3::new(0.0, 0.02, 0.0),
        );
        let surfaces = [take.scene.surfaces.clone(), vec![patch]].concat();
        take.scene = Arc::new(Scene { surfaces, ..Scene::default() });
        assert!(frame(&take, 0).at_reference(visible).is_none());
    }
}
