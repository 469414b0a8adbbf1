// SPDX-License-Identifier: MIT OR Apache-2.0

//! Line-by-line ray casting: each row, or column, is seen from the pose at its own instant, or from
//! several while it is exposed. A lens that distorts is followed in short straight stretches.

use super::camera::{Lens, RollingCamera, Shutter};
use super::geometry::Scene;
use super::line::{Line, Track};
use super::picture::Picture;
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

/// Pixels that are drawn at once where the lens distorts: its rays are taken as linear over such a
/// stretch, which is wrong by less than 0.02 px for the barrels of action cameras at 640 × 480.
const STRETCH: usize = 4;

/// The most instants of an exposure at which a line is drawn.
const MOST_INSTANTS: usize = 64;

/// Renders frames of a scene.
pub struct Renderer<'a> {
    /// What is seen.
    pub scene: &'a Scene,
    /// Who sees it.
    pub camera: &'a RollingCamera,
    /// Rays along each side of a pixel, which smooth the edges of surfaces: 2 means 4 rays a pixel.
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
        let stretch = if lens.is_pinhole() { length } else { STRETCH };
        let instants = self.instants(&time);
        let weight = 1.0 / instants.len() as f32;
        let mut colours = vec![[0.0; 3]; length * lines];
        colours.par_chunks_mut(length).enumerate().for_each_init(Line::default, |line, (index, out)| {
            let (along, across) =
                if by_rows { (Vector3::x(), Vector3::y()) } else { (Vector3::y(), Vector3::x()) };
            let first = Vector3::z() + across * index as f64;
            let t = time(first.xy());
            for instant in &instants {
                line.look(self.scene, &self.camera.path.pose(t + instant), t + instant);
                let lens = self.camera.lens_at(t + instant);
                for (part, out) in out.chunks_mut(stretch).enumerate() {
                    let origin = first + along * (part * stretch) as f64;
                    let middle = origin + along * (0.5 * (out.len() as f64 - 1.0));
                    let track = Track { origin, along, across, samples: self.samples, weight };
                    line.focus(self.scene, &lens.rays_near(middle.xy()), &track, out.len());
                    line.draw(self.scene, &track, out);
                }
            }
        });
        if by_rows {
            Picture::new(length, lines, colours)
        } else {
            Picture::new(length, lines, colours).transposed()
        }
    }

    /// The instants, from the middle of a line's exposure, at which it is drawn: at most a pixel of
    /// motion apart, and [`MOST_INSTANTS`] at most.
    fn instants(&self, time: &impl Fn(Vector2<f64>) -> f64) -> Vec<f64> {
        let open = self.camera.shutter.open;
        let travel = if open > 0.0 { open * self.fastest(time) } else { 0.0 };
        let count = (travel.ceil() as usize).clamp(1, MOST_INSTANTS);
        (0..count).map(|index| open * ((index as f64 + 0.5) / count as f64 - 0.5)).collect()
    }

    /// The fastest motion, in pixels a second, of what a grid of pixels sees while they are exposed.
    fn fastest(&self, time: &impl Fn(Vector2<f64>) -> f64) -> f64 {
        const MOMENT: f64 = 1e-5;
        let Shutter { open, .. } = self.camera.shutter;
        let Lens { width, height, .. } = self.camera.lens;
        let speed = |pixel: Vector2<f64>, t: f64| {
            let (from, direction) = self.camera.ray(t, pixel);
            let hit = self.scene.hit(t, from, direction)?;
            let next = self.camera.project(t + MOMENT, self.scene.position(t + MOMENT, &hit))?;
            Some((next - pixel).norm() / MOMENT)
        };
        let mut fastest = 0.0f64;
        for (i, j, k) in (0..12 * 9 * 3).map(|index| (index % 12, index / 12 % 9, index / 108)) {
            let pixel = Vector2::new((i * width) as f64 / 12.0, (j * height) as f64 / 9.0);
            let t = time(pixel) + open * (f64::from(k as u8) - 1.0) / 2.0;
            fastest = fastest.max(speed(pixel, t).unwrap_or(0.0));
        }
        fastest
    }
}

#[cfg(test)]
mod tests {
    use super::super::path::{Motion, Oscillations};
    use super::super::procedural::bake_all;
    use super::super::texture::Texture;
    use super::super::{FirstEdge, Mover, Pose, SceneKind};
    use super::*;
    use std::sync::LazyLock;

    const WIDTH: usize = 160;
    const HEIGHT: usize = 120;

    /// A scene whose textures are baked once for all tests.
    fn scene(kind: SceneKind) -> Scene {
        static TEXTURES: LazyLock<Vec<Texture>> = LazyLock::new(|| bake_all(1));
        kind.covered(1, TEXTURES.clone())
    }

    fn camera(scale: usize, first: FirstEdge, readout: f64, motion: Motion) -> RollingCamera {
        let (width, height) = (WIDTH * scale, HEIGHT * scale);
        RollingCamera {
            lens: Lens::pinhole(width, height, width as f64),
            shutter: Shutter { first, readout, open: 0.0 },
            path: Box::new(Oscillations::new(motion, 1.0, 30.0, 4)),
        }
    }

    fn psnr(a: &[f32], b: &[f32]) -> f32 {
        let squares: f32 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
        10.0 * (255.0f32.powi(2) * a.len() as f32 / squares).log10()
    }

    /// Means of squares of `side` pixels.
    fn shrunk(picture: &Picture, side: usize) -> Vec<f32> {
        let grey = picture.grey();
        let width = picture.width / side;
        let mean = |index: usize| {
            let (x, y) = (side * (index % width), side * (index / width));
            let rows = (y..y + side).map(|row| &grey[row * picture.width + x..][..side]);
            rows.flatten().sum::<f32>() / (side * side) as f32
        };
        (0..width * picture.height / side).map(mean).collect()
    }

    #[test]
    fn is_anti_aliased() {
        let scene = scene(SceneKind::Room);
        let fine = camera(8, FirstEdge::Top, 0.0, Motion::Still);
        let fine = Renderer { scene: &scene, camera: &fine, samples: 2 }.global(0.0);
        let truth = shrunk(&fine, 8);
        let coarse = camera(1, FirstEdge::Top, 0.0, Motion::Still);
        let coarse = Renderer { scene: &scene, camera: &coarse, samples: 2 }.global(0.0);
        let smooth = psnr(&coarse.grey(), &truth);
        let grey = fine.grey();
        let points: Vec<f32> = (0..WIDTH * HEIGHT)
            .map(|i| grey[(8 * (i / WIDTH) + 4) * fine.width + 8 * (i % WIDTH) + 4])
            .collect();
        let aliased = psnr(&points, &truth);
        assert!(smooth > 30.0 && smooth > aliased + 8.0, "{smooth} dB, point samples {aliased} dB");
    }

    #[test]
    fn each_line_of_a_rolling_frame_is_a_line_of_a_global_one() {
        let scene = scene(SceneKind::Room);
        for first in [FirstEdge::Top, FirstEdge::Bottom, FirstEdge::Left, FirstEdge::Right] {
            let camera = camera(1, first, 0.03, Motion::Shake { lowest: 0.1, highest: 0.4, sway: 0.01 });
            let renderer = Renderer { scene: &scene, camera: &camera, samples: 1 };
            let rolling = renderer.rolling(0.2);
            for (x, y) in [(20, 10), (140, 100)] {
                let share = match first {
                    FirstEdge::Top => (y as f64 + 0.5) / HEIGHT as f64,
                    FirstEdge::Bottom => 1.0 - (y as f64 + 0.5) / HEIGHT as f64,
                    FirstEdge::Left => (x as f64 + 0.5) / WIDTH as f64,
                    FirstEdge::Right => 1.0 - (x as f64 + 0.5) / WIDTH as f64,
                };
                let global = renderer.global(0.2 + 0.03 * share);
                let index = y * WIDTH + x;
                for (a, b) in rolling.colours[index].iter().zip(global.colours[index]) {
                    assert!((a - b).abs() < 0.01, "{first:?} {x} {y}");
                }
            }
        }
    }

    const BARREL: Lens = Lens { width: 640, height: 480, focal: 448.0, distortion: [-0.25, 0.05] };

    #[test]
    fn stretches_are_short_enough() {
        for (y, part) in (0..480).step_by(20).flat_map(|y| (0..160).map(move |part| (y, part))) {
            let place = |along: f64| Vector2::new((part * STRETCH) as f64 + along, f64::from(y));
            let rays = BARREL.rays_near(place(1.5));
            for along in [-0.5, 0.3, 3.5] {
                let drawn = BARREL.project(rays * place(along).push(1.0)).unwrap();
                assert!((drawn - place(along)).norm() < 0.02, "{}", place(along));
            }
        }
    }

    #[test]
    fn a_barrel_shows_each_pixel_where_its_ray_leads() {
        let scene = scene(SceneKind::Room);
        for first in [FirstEdge::Top, FirstEdge::Left] {
            let still = camera(1, first, 0.0, Motion::Still);
            let lens = Lens { distortion: [-0.25, 0.05], ..still.lens };
            let barrel = RollingCamera { lens, ..camera(1, first, 0.0, Motion::Still) };
            let picture = Renderer { scene: &scene, camera: &barrel, samples: 2 }.global(0.0).grey();
            // A pinhole of the same scale that sees more.
            let (width, height) = (WIDTH + 40, HEIGHT + 40);
            let lens = Lens::pinhole(width, height, still.lens.focal);
            let wide = RollingCamera { lens, ..still };
            let wide = Renderer { scene: &scene, camera: &wide, samples: 2 }.global(0.0).grey();
            let (mut seen, mut expected) = (Vec::new(), Vec::new());
            for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
                let place = lens.project(barrel.lens.ray(Vector2::new(x as f64, y as f64))).unwrap();
                let rounded = place.map(f64::round);
                // Where the two grids nearly agree, no interpolation is needed.
                if (place - rounded).amax() < 0.08 {
                    seen.push(picture[y * WIDTH + x]);
                    expected.push(wide[rounded.y as usize * width + rounded.x as usize]);
                }
            }
            let psnr = psnr(&seen, &expected);
            assert!(seen.len() > 400 && psnr > 30.0, "{} pixels, {psnr} dB", seen.len());
        }
    }

    #[test]
    fn blur_is_the_mean_over_the_exposure() {
        let scene = scene(SceneKind::Foreground);
        let motion = Motion::Shake { lowest: 0.1, highest: 0.4, sway: 0.01 };
        let (mut blurred, sharp) =
            (camera(1, FirstEdge::Top, 0.03, motion), camera(1, FirstEdge::Top, 0.03, motion));
        blurred.shutter.open = 0.02;
        let blurred = Renderer { scene: &scene, camera: &blurred, samples: 2 }.rolling(0.2).grey();
        let renderer = Renderer { scene: &scene, camera: &sharp, samples: 2 };
        let mut mean = vec![0.0; WIDTH * HEIGHT];
        for index in 0..40 {
            // Shifting the readout in time shifts the instant of every line.
            let grey = renderer.rolling(0.2 + 0.02 * ((f64::from(index) + 0.5) / 40.0 - 0.5)).grey();
            mean.iter_mut().zip(grey).for_each(|(mean, grey)| *mean += grey / 40.0);
        }
        let (near, far) = (psnr(&blurred, &mean), psnr(&renderer.rolling(0.2).grey(), &mean));
        assert!(near > 42.0 && far < near - 12.0, "{near} dB, sharp {far} dB");
    }

    #[test]
    fn an_object_that_turns_looks_as_if_the_camera_turned_the_other_way() {
        let mut scene = scene(SceneKind::Room);
        let path = Oscillations::new(Motion::RotationAndTranslation, 1.0, 30.0, 5);
        let mover = Mover { rest: Vector3::new(0.2, 0.0, 2.0), path };
        let camera_path = {
            let mover = mover.clone();
            move |t: f64| Pose::identity().seen_from(&mover.pose(t))
        };
        let turning =
            RollingCamera { path: Box::new(camera_path), ..camera(1, FirstEdge::Top, 0.03, Motion::Still) };
        let expected = Renderer { scene: &scene, camera: &turning, samples: 1 }.rolling(0.2);
        scene.surfaces = scene.surfaces.into_iter().map(|surface| surface.carried(0)).collect();
        scene.movers = vec![mover];
        let still = camera(1, FirstEdge::Top, 0.03, Motion::Still);
        let rolling = Renderer { scene: &scene, camera: &still, samples: 1 }.rolling(0.2);
        assert!(psnr(&rolling.grey(), &expected.grey()) > 60.0);
    }

    /// The standard deviation of grey in each block of 20 × 20 pixels of a view of the scene.
    fn contrasts(scene: &Scene) -> Vec<f32> {
        let camera = camera(2, FirstEdge::Top, 0.0, Motion::Still);
        let picture = Renderer { scene, camera: &camera, samples: 2 }.global(0.0);
        let grey = picture.grey();
        let block = 20;
        let blocks =
            (0..picture.height / block).flat_map(|row| (0..picture.width / block).map(move |c| (c, row)));
        let contrast = |(column, row): (usize, usize)| {
            let pixels: Vec<f32> = (0..block * block)
                .map(|i| grey[(row * block + i / block) * picture.width + column * block + i % block])
                .collect();
            let mean = pixels.iter().sum::<f32>() / pixels.len() as f32;
            let variance = pixels.iter().map(|p| (p - mean).powi(2)).sum::<f32>() / pixels.len() as f32;
            variance.sqrt()
        };
        blocks.map(contrast).collect()
    }

    #[test]
    fn detail_is_everywhere() {
        let contrasts = contrasts(&scene(SceneKind::Room));
        assert!(contrasts.iter().all(|contrast| *contrast >= 4.0), "blocks without texture");
    }

    #[test]
    fn low_texture_leaves_edges_alone() {
        let contrasts = contrasts(&scene(SceneKind::LowTexture));
        let share = |low: f32, high: f32| {
            let count = contrasts.iter().filter(|contrast| (low..high).contains(*contrast)).count();
            count as f32 / contrasts.len() as f32
        };
        assert!(
            share(0.0, 4.0) > 0.4 && share(10.0, 200.0) > 0.1,
            "{} {}",
            share(0.0, 4.0),
            share(10.0, 200.0)
        );
    }
}
