//! Named sequences and their settings.

mod catalogue;
mod settings;

pub use catalogue::{catalogue, demo, named};
pub use settings::{Settings, Strength};

use crate::metrics::{Stats, distances};
use crate::scene::path::Oscillations;
use crate::scene::procedural::bake_all;
use crate::scene::{Frame, Lens, Renderer, RollingCamera, Scene, Shutter};
use crate::truth::Capture;
use std::sync::Arc;

/// Focal length in frame widths: a field of view of 53° across.
const FOCAL: f64 = 1.0;

/// A sequence ready to be rendered and judged.
pub struct Sequence {
    /// What determines it.
    pub settings: Settings,
    /// What is seen, and who sees it.
    pub take: Take,
}

/// A scene and the camera that films it.
pub struct Take {
    /// What is seen.
    pub scene: Arc<Scene>,
    /// Who sees it.
    pub camera: RollingCamera,
}

impl Sequence {
    /// Builds the scene with procedural textures and chooses the amplitude.
    pub fn new(settings: Settings) -> Self {
        let scene = settings.scene.covered(settings.seed, bake_all(settings.seed));
        Self::in_scene(settings, Arc::new(scene))
    }

    /// A sequence in a scene that is there already.
    pub fn in_scene(settings: Settings, scene: Arc<Scene>) -> Self {
        let take = Take { scene, camera: camera(&settings, 1.0) };
        let mut sequence = Self { settings, take };
        match sequence.settings.strength {
            Strength::Amplitude(amplitude) => sequence.take.camera = camera(&sequence.settings, amplitude),
            Strength::Displacement(pixels) => sequence.reach(pixels),
        }
        sequence
    }

    /// When frame `k` starts to be read, in seconds.
    pub fn start(&self, k: usize) -> f64 {
        k as f64 / self.settings.fps
    }

    /// The truth of frame `k`.
    pub fn capture(&self, k: usize) -> Capture<'_> {
        Capture { take: &self.take, start: self.start(k) }
    }

    /// The displacement of the sequence as it arrives, sampled every `step` pixels.
    pub fn uncorrected(&self, step: usize) -> Stats {
        let frames = (0..self.settings.frames).map(|k| self.capture(k).samples(step));
        Stats::of(frames.flat_map(|samples| distances(&samples, |x| x).collect::<Vec<_>>()).collect())
    }

    /// Frame `k` as the camera gives it.
    pub fn frame(&self, k: usize) -> Frame {
        let picture = self.renderer().rolling(self.start(k));
        let seed = self.settings.seed ^ (k as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        picture.sense(self.settings.noise, seed)
    }

    /// All frames, one after another.
    pub fn frames(&self) -> impl Iterator<Item = Frame> + '_ {
        (0..self.settings.frames).map(|k| self.frame(k))
    }

    /// The renderer of its frames.
    pub fn renderer(&self) -> Renderer<'_> {
        Renderer { scene: &self.take.scene, camera: &self.take.camera, samples: 2 }
    }

    /// Scales the motion until the uncorrected frames are `target` pixels from their truth.
    ///
    /// Displacement is nearly proportional to the amplitude, so that repeated proportion settles
    /// quickly; the visibility mask and perspective bend it a little.
    fn reach(&mut self, target: f64) {
        let mut amplitude = 1.0;
        for _ in 0..8 {
            self.take.camera = camera(&self.settings, amplitude);
            let reached = self.uncorrected(self.settings.width / 40).rms;
            if (reached - target).abs() < 1e-3 * target {
                break;
            }
            amplitude *= target / reached.max(1e-6);
        }
    }
}

fn camera(settings: &Settings, amplitude: f64) -> RollingCamera {
    let focal = FOCAL * settings.width as f64;
    RollingCamera {
        lens: Lens { width: settings.width, height: settings.height, focal, distortion: settings.distortion },
        shutter: Shutter { first: settings.first, readout: settings.readout_time(), open: settings.exposure },
        path: Box::new(Oscillations::new(settings.motion, amplitude, settings.fps, settings.seed)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{SceneKind, room};
    use nalgebra::Vector2;

    fn small(name: &str) -> Settings {
        Settings { width: 320, height: 240, frames: 4, noise: 0.0, ..named(name).unwrap() }
    }

    #[test]
    fn every_sequence_reaches_its_displacement() {
        let scene = Arc::new(room::room(1));
        for settings in catalogue() {
            let Strength::Displacement(target) = settings.strength else { continue };
            let name = settings.name.clone();
            let reached = Sequence::in_scene(settings, scene.clone()).uncorrected(8).rms;
            assert!((reached - target).abs() < 0.03 * target, "{name}: {reached} px for {target} px");
        }
    }

    #[test]
    fn controls_are_without_displacement() {
        for name in ["control_global", "control_still"] {
            assert!(Sequence::new(small(name)).uncorrected(16).rms < 1e-9);
        }
    }

    #[test]
    fn a_still_camera_repeats_its_frame_and_a_shaken_one_does_not() {
        let still = Sequence::new(small("control_still"));
        assert_eq!(still.frame(0), still.frame(3));
        let shaken = Sequence::new(small("control_global"));
        assert_ne!(shaken.frame(0), shaken.frame(3));
    }

    #[test]
    fn the_seed_decides() {
        let frame = |seed| Sequence::new(Settings { seed, noise: 2.0, ..small("rot2_B40") }).frame(1);
        assert_eq!(frame(1), frame(1));
        assert_ne!(frame(1), frame(2));
    }

    /// Linear interpolation in a grey picture.
    fn at(grey: &[f32], width: usize, x: Vector2<f64>) -> f64 {
        let (x0, y0) = (x.x as usize, x.y as usize);
        let (fx, fy) = (x.x - x0 as f64, x.y - y0 as f64);
        let pixel = |i: usize, j: usize| f64::from(grey[((y0 + j) * width + x0 + i).min(grey.len() - 1)]);
        (pixel(0, 0) * (1.0 - fx) + pixel(1, 0) * fx) * (1.0 - fy)
            + (pixel(0, 1) * (1.0 - fx) + pixel(1, 1) * fx) * fy
    }

    #[test]
    fn the_truth_takes_rolling_frames_to_global_ones() {
        let textures = bake_all(1);
        let foreground = Settings { scene: SceneKind::Foreground, ..small("rot2_B40") };
        let barrel = Settings { distortion: [-0.3, 0.07], ..foreground.clone() };
        let plain = ["rot1_B0", "trans_rot1_B40", "btt_g085"].map(small);
        for settings in plain.into_iter().chain([foreground, barrel]) {
            let name = format!("{} {:?} {:?}", settings.name, settings.scene, settings.distortion);
            let scene = settings.scene.covered(settings.seed, textures.clone());
            let sequence = Sequence::in_scene(settings, Arc::new(scene));
            let rolling = sequence.renderer().rolling(sequence.start(2)).grey();
            let global = sequence.renderer().global(sequence.capture(2).reference()).grey();
            let (mut moved, mut left, mut count) = (0.0, 0.0, 0.0);
            for sample in sequence.capture(2).samples(3) {
                let seen = at(&rolling, 320, sample.seen);
                left += (seen - at(&global, 320, sample.truth)).powi(2);
                moved += (seen - at(&global, 320, sample.seen)).powi(2);
                count += 1.0;
            }
            let psnr = |squares: f64| 10.0 * (255.0f64.powi(2) * count / squares).log10();
            let (moved, left) = (psnr(moved), psnr(left));
            assert!(left > 28.0 && left > moved + 8.0, "{name}: {moved:.1} dB → {left:.1} dB");
        }
    }
}
