//! Line-by-line ray casting: each row, or column, is seen from the pose at its own instant.
//!
//! Along a line of pixels the plane of a surface is a quotient of linear functions (the homography
//! of [`Surface::view`](super::geometry::Surface::view)), so that the stretch of the line in which
//! a surface is seen is an intersection of half-lines, and the nearest surface the largest linear
//! function. Cost for each subsample: two or three surfaces compared, one texture lookup.

use super::camera::{Pose, RollingCamera};
use super::geometry::{Scene, Surface};
use super::picture::Picture;
use super::texture::{Colour, add_scaled};
use nalgebra::{Matrix3, Vector2, Vector3};
use rayon::prelude::*;

/// Renders frames of a scene.
pub struct Renderer<'a> {
    /// What is seen.
    pub scene: &'a Scene,
    /// Who sees it.
    pub camera: &'a RollingCamera,
    /// Rays along each side of a pixel: 2 means 4 rays a pixel.
    pub samples: usize,
}

impl Renderer<'_> {
    /// The frame whose readout starts at `start` seconds.
    pub fn rolling(&self, start: f64) -> Picture {
        self.render(|line| self.camera.exposure(start, line))
    }

    /// The frame that a global shutter sees at the instant `t`.
    pub fn global(&self, t: f64) -> Picture {
        self.render(|_| t)
    }

    fn render(&self, time: impl Fn(Vector2<f64>) -> f64 + Sync) -> Picture {
        let lens = self.camera.lens;
        let by_rows = self.camera.shutter.first.is_by_rows();
        let (length, lines) = if by_rows { (lens.width, lens.height) } else { (lens.height, lens.width) };
        let mut colours = vec![[0.0; 3]; length * lines];
        colours.par_chunks_mut(length).enumerate().for_each_init(Line::default, |line, (index, out)| {
            let start = Vector3::new(0.0, 0.0, 1.0);
            let (origin, along, across) = if by_rows {
                (start + Vector3::y() * index as f64, Vector3::x(), Vector3::y())
            } else {
                (start + Vector3::x() * index as f64, Vector3::y(), Vector3::x())
            };
            line.look(self.scene, &lens.rays(), &self.camera.path.pose(time(origin.xy())));
            line.draw(self.scene, &Track { origin, along, across, samples: self.samples }, out);
        });
        if by_rows {
            Picture::new(length, lines, colours)
        } else {
            Picture::new(length, lines, colours).transposed()
        }
    }
}

/// A line of pixels in homogeneous pixel coordinates.
struct Track {
    /// Its first pixel.
    origin: Vector3<f64>,
    /// From one pixel to the next.
    along: Vector3<f64>,
    /// From this line to the next.
    across: Vector3<f64>,
    /// Subsamples along each side of a pixel.
    samples: usize,
}

/// The scene as one line sees it; buffers are kept from line to line.
#[derive(Default)]
struct Line {
    views: Vec<Matrix3<f64>>,
    nearness: Vec<f64>,
    nearest: Vec<usize>,
}

impl Line {
    /// Prepares the homographies of all surfaces from a pose.
    fn look(&mut self, scene: &Scene, lens_rays: &Matrix3<f64>, pose: &Pose) {
        let rays = pose.rotation.matrix() * lens_rays;
        self.views.clear();
        self.views.extend(scene.surfaces.iter().map(|surface| surface.view(pose.position, &rays)));
    }

    /// Fills `out` with the mean of each pixel's subsamples.
    fn draw(&mut self, scene: &Scene, track: &Track, out: &mut [Colour]) {
        let step = 1.0 / track.samples as f64;
        let weight = (step * step) as f32;
        for sub in 0..track.samples {
            let offset = |index: usize| (index as f64 + 0.5) * step - 0.5;
            let first = track.origin + track.across * offset(sub) + track.along * offset(0);
            self.find_nearest(&first, &(track.along * step), out.len() * track.samples);
            for (index, &surface) in self.nearest.iter().enumerate() {
                let Some(rectangle) = scene.surfaces.get(surface) else { continue };
                let pixel = first + track.along * (index as f64 * step);
                let colour = shade(scene, rectangle, &self.views[surface], pixel, step as f32);
                let pixel = &mut out[index / track.samples];
                *pixel = add_scaled(*pixel, colour, weight);
            }
        }
    }

    /// For each of `count` subsamples the surface with the largest 1/distance.
    fn find_nearest(&mut self, first: &Vector3<f64>, step: &Vector3<f64>, count: usize) {
        self.nearness.clear();
        self.nearness.resize(count, 0.0);
        self.nearest.clear();
        self.nearest.resize(count, usize::MAX);
        for (surface, view) in self.views.iter().enumerate() {
            let (start, slope) = (view * first, view * step);
            let (low, high) = visible_stretch(&start, &slope, count);
            for index in low..high {
                let nearness = start.z + slope.z * index as f64;
                if nearness > self.nearness[index] {
                    self.nearness[index] = nearness;
                    self.nearest[index] = surface;
                }
            }
        }
    }
}

/// The subsamples low..high for which 0 ≤ u·w ≤ w, 0 ≤ v·w ≤ w and w > 0, where (u·w, v·w, w) =
/// start + index · slope.
fn visible_stretch(start: &Vector3<f64>, slope: &Vector3<f64>, count: usize) -> (usize, usize) {
    let (mut low, mut high) = (0.0f64, count as f64 - 1.0);
    let conditions = [
        (start.z - 1e-6, slope.z),
        (start.x, slope.x),
        (start.z - start.x, slope.z - slope.x),
        (start.y, slope.y),
        (start.z - start.y, slope.z - slope.y),
    ];
    for (value, slope) in conditions {
        if slope > 0.0 {
            low = low.max(-value / slope);
        } else if slope < 0.0 {
            high = high.min(-value / slope);
        } else if value < 0.0 {
            return (0, 0);
        }
    }
    // The negation also catches NaN from a surface seen exactly edge on.
    if !(low <= high) { (0, 0) } else { (low.ceil() as usize, high.floor() as usize + 1) }
}

/// The colour of a surface in a subsample of side `step` pixels, 0 to 1.
fn shade(scene: &Scene, surface: &Surface, view: &Matrix3<f64>, pixel: Vector3<f64>, step: f32) -> Colour {
    let seen = view * pixel;
    let (u, v) = (seen.x / seen.z, seen.y / seen.z);
    let scale = f64::from(step) / seen.z;
    let (tile_u, tile_v) = (surface.tiling.x, surface.tiling.y);
    let slope = |axis: usize| {
        let du = (view[(0, axis)] - u * view[(2, axis)]) * scale;
        let dv = (view[(1, axis)] - v * view[(2, axis)]) * scale;
        [du as f32 * tile_u, dv as f32 * tile_v]
    };
    let (u, v) = (u as f32, v as f32);
    let texture = &scene.textures[surface.texture];
    let (x, y) = (u * tile_u + surface.shift.x, v * tile_v + surface.shift.y);
    let colour = texture.sample(x, y, slope(0), slope(1));
    let [a, b, c, d] = surface.light;
    let light = (a + (b - a) * u) * (1.0 - v) + (c + (d - c) * u) * v;
    colour.map(|channel| channel * light)
}
