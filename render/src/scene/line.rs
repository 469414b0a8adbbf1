// SPDX-License-Identifier: MIT OR Apache-2.0

//! One line of a picture: what it sees of the scene, and the light that it collects.
//!
//! Along a line of pixels the plane of a surface is a quotient of linear functions (the homography
//! of [`Surface::view`](super::geometry::Surface::view)), so that the stretch of the line in which
//! a surface is seen is an intersection of half-lines, and the nearest surface the largest linear
//! function. Cost: an outline for each surface, two or three surfaces compared a subsample, one
//! texture lookup a pixel, and one a subsample where surfaces meet.

use super::camera::Pose;
use super::geometry::Scene;
use super::texture::{Colour, add_scaled};
use nalgebra::{Matrix3, Vector2, Vector3};
use std::ops::Range;

/// A line of pixels in homogeneous pixel coordinates.
pub struct Track {
    /// Its first pixel.
    pub origin: Vector3<f64>,
    /// From one pixel to the next.
    pub along: Vector3<f64>,
    /// From this line to the next.
    pub across: Vector3<f64>,
    /// Subsamples along each side of a pixel.
    pub samples: usize,
    /// The part of the pixels' light that is collected at this instant.
    pub weight: f32,
}

/// The scene as one line sees it; buffers are kept from line to line.
#[derive(Default)]
pub struct Line {
    outlines: Vec<Outline>,
    views: Vec<View>,
    nearness: Vec<f64>,
    nearest: Vec<usize>,
}

/// Where a surface may be seen at one instant.
struct Outline {
    /// The camera in the axes of the surface.
    camera: Pose,
    /// What holds the directions of its corners.
    extent: Extent,
}

/// A surface that a stretch may see: its index and its homography from pixels.
struct View {
    surface: usize,
    homography: Matrix3<f64>,
}

/// A rectangle of directions (x, y, 1) in the camera.
struct Extent {
    low: Vector2<f64>,
    high: Vector2<f64>,
}

impl Extent {
    /// That of some points in front of the camera; all directions where one is not.
    fn of(points: [Vector3<f64>; 4]) -> Self {
        let all = Vector2::repeat(f64::INFINITY);
        if points.iter().any(|point| point.z < 1e-6) {
            return Self { low: -all, high: all };
        }
        let directions = points.map(|point| point.xy() / point.z);
        let low = directions.iter().fold(all, |low, direction| low.inf(direction));
        let high = directions.iter().fold(-all, |high, direction| high.sup(direction));
        Self { low, high }
    }

    fn meets(&self, other: &Self) -> bool {
        (0..2).all(|axis| self.low[axis] <= other.high[axis] && other.low[axis] <= self.high[axis])
    }
}

impl Line {
    /// Prepares the outlines of all surfaces as a camera of this pose sees them at time `t`.
    pub fn look(&mut self, scene: &Scene, camera: &Pose, t: f64) {
        let (mut mover, mut own) = (None, *camera);
        self.outlines.clear();
        for surface in &scene.surfaces {
            if surface.mover != mover {
                mover = surface.mover;
                own = camera.seen_from(&scene.axes(mover, t));
            }
            let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)];
            let extent = Extent::of(corners.map(|(u, v)| own.to_own(surface.point(u, v))));
            self.outlines.push(Outline { camera: own, extent });
        }
    }

    /// Prepares the homographies of the surfaces that a track of some pixels may see; `rays` takes a
    /// pixel (x, y, 1) to its direction in the camera.
    pub fn focus(&mut self, scene: &Scene, rays: &Matrix3<f64>, track: &Track, pixels: usize) {
        let corner = |i: f64, j: f64| rays * (track.origin + track.along * i + track.across * j);
        let end = pixels as f64 - 0.5;
        let seen = Extent::of([corner(-0.5, -0.5), corner(end, -0.5), corner(-0.5, 0.5), corner(end, 0.5)]);
        self.views.clear();
        for (surface, outline) in self.outlines.iter().enumerate() {
            if outline.extent.meets(&seen) {
                let Pose { position, rotation } = outline.camera;
                let homography = scene.surfaces[surface].view(position, &(rotation.matrix() * rays));
                self.views.push(View { surface, homography });
            }
        }
    }

    /// Adds to `out` the light of each pixel: one lookup where all its subsamples see the same
    /// surface, else the mean of theirs.
    pub fn draw(&mut self, scene: &Scene, track: &Track, out: &mut [Colour]) {
        let samples = track.samples;
        let step = 1.0 / samples as f64;
        let offset = |index: usize| (index as f64 + 0.5) * step - 0.5;
        let count = out.len() * samples;
        self.nearness.clear();
        self.nearness.resize(count * samples, 0.0);
        self.nearest.clear();
        self.nearest.resize(count * samples, usize::MAX);
        for sub in 0..samples {
            let first = track.origin + track.across * offset(sub) + track.along * offset(0);
            self.find_nearest(&first, &(track.along * step), sub * count..(sub + 1) * count);
        }
        for (index, colour) in out.iter_mut().enumerate() {
            let centre = track.origin + track.along * index as f64;
            let seen = |sub: usize| &self.nearest[sub * count + index * samples..][..samples];
            let view = seen(0)[0];
            if (0..samples).all(|sub| seen(sub).iter().all(|other| *other == view)) {
                *colour = add_scaled(*colour, self.shade(scene, view, centre, 1.0), track.weight);
                continue;
            }
            for (sub, along) in (0..samples * samples).map(|i| (i / samples, i % samples)) {
                let pixel = centre + track.across * offset(sub) + track.along * offset(along);
                let part = self.shade(scene, seen(sub)[along], pixel, step);
                *colour = add_scaled(*colour, part, track.weight * (step * step) as f32);
            }
        }
    }

    /// For each subsample of a stretch of the buffers the view with the largest 1/distance.
    fn find_nearest(&mut self, first: &Vector3<f64>, step: &Vector3<f64>, stretch: Range<usize>) {
        let nearness = &mut self.nearness[stretch.clone()];
        let nearest = &mut self.nearest[stretch];
        for (index, View { homography, .. }) in self.views.iter().enumerate() {
            let (start, slope) = (homography * first, homography * step);
            let (low, high) = visible_stretch(&start, &slope, nearness.len());
            for place in low..high {
                let near = start.z + slope.z * place as f64;
                if near > nearness[place] {
                    nearness[place] = near;
                    nearest[place] = index;
                }
            }
        }
    }

    /// The colour of a view in a square of side `step` pixels about `pixel`; black for none.
    fn shade(&self, scene: &Scene, view: usize, pixel: Vector3<f64>, step: f64) -> Colour {
        let Some(View { surface, homography: view }) = self.views.get(view) else {
            return [0.0; 3];
        };
        let rectangle = &scene.surfaces[*surface];
        let seen = view * pixel;
        let (u, v) = (seen.x / seen.z, seen.y / seen.z);
        let scale = step / seen.z;
        let slope = |axis: usize| {
            let du = (view[(0, axis)] - u * view[(2, axis)]) * scale;
            let dv = (view[(1, axis)] - v * view[(2, axis)]) * scale;
            [du as f32 * rectangle.tiling.x, dv as f32 * rectangle.tiling.y]
        };
        let (u, v) = (u as f32, v as f32);
        let x = u * rectangle.tiling.x + rectangle.shift.x;
        let y = v * rectangle.tiling.y + rectangle.shift.y;
        let colour = scene.textures[rectangle.texture].sample(x, y, slope(0), slope(1));
        let light = rectangle.light_at(u, v);
        colour.map(|channel| channel * light)
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
    // A surface seen exactly edge on may give NaN, which is no stretch either.
    if low <= high { (low.ceil() as usize, high.floor() as usize + 1) } else { (0, 0) }
}
