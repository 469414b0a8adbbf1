// SPDX-License-Identifier: MIT OR Apache-2.0

//! Named sequences and their settings.

mod amplitude;
mod at_once;
mod catalogue;
mod gain;
mod processed;
mod scenes;
mod settings;
mod stabilisation;
mod take;
mod timeline;

pub use catalogue::{all, catalogue, chosen, demo, hard, named};
pub use gain::Gain;
pub use settings::{Settings, Strength};
pub use stabilisation::{Move, Stabilisation, Warp};
pub use take::Take;
pub use timeline::{Delivery, Timeline};

use crate::media;
use crate::scene::{Frame, Picture, Renderer, Scene};
use crate::truth::Capture;
use anyhow::Result;
use stabilisation::resample;
use std::collections::VecDeque;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// What the seed of a take after a cut differs by from the one before.
const OTHER_TAKE: u64 = 0x6d2b_79f5;

/// A sequence ready to be rendered and judged.
pub struct Sequence {
    /// What determines it.
    pub settings: Settings,
    /// What its motion was multiplied by, for each take, to have the strength that the settings ask for.
    pub amplitudes: Vec<f64>,
    /// The take before the cut and the one after it, or the only one.
    takes: Vec<Take>,
}

impl Sequence {
    /// Builds the scene with procedural textures and chooses the amplitude.
    pub fn new(settings: Settings) -> Self {
        Self::with_textures(settings, None).expect("procedural textures need no file")
    }

    /// Builds the scene with the photographs of a folder as textures, procedural ones without it, and
    /// chooses the amplitude.
    ///
    /// # Errors
    /// If the folder cannot be read or holds no photographs.
    pub fn with_textures(settings: Settings, textures: Option<&Path>) -> Result<Self> {
        let scenes = scenes_of(&settings, textures)?;
        Ok(Self::filmed(settings, scenes))
    }

    /// A sequence without a cut in a scene that is there already.
    pub fn in_scene(settings: Settings, scene: Arc<Scene>) -> Self {
        Self::filmed(Settings { cut: None, ..settings }, vec![scene])
    }

    /// Chooses the amplitude of each take, given their scenes.
    fn filmed(settings: Settings, scenes: Vec<Arc<Scene>>) -> Self {
        let captures = stretches(&settings).into_iter().enumerate();
        let amplitudes = captures.zip(&scenes).map(|((take, captures), scene)| {
            amplitude::of_strength(&settings, scene, seed_of(&settings, take), captures)
        });
        let amplitudes = amplitudes.collect();
        Self::of_scenes(settings, scenes, amplitudes)
    }

    /// A sequence of which the amplitude of each take is known.
    ///
    /// # Errors
    /// As [`with_textures`](Self::with_textures).
    pub fn with_amplitudes(
        settings: Settings,
        textures: Option<&Path>,
        amplitudes: Vec<f64>,
    ) -> Result<Self> {
        let scenes = scenes_of(&settings, textures)?;
        Ok(Self::of_scenes(settings, scenes, amplitudes))
    }

    fn of_scenes(settings: Settings, scenes: Vec<Arc<Scene>>, amplitudes: Vec<f64>) -> Self {
        let takes = scenes.into_iter().zip(&amplitudes).enumerate();
        let takes = takes.map(|(take, (scene, amplitude))| {
            Take::new(&settings, scene, seed_of(&settings, take), *amplitude)
        });
        let takes = takes.collect();
        Self { settings, amplitudes, takes }
    }

    /// When capture `k` starts to be read, in seconds.
    pub fn start(&self, k: usize) -> f64 {
        k as f64 / self.settings.fps
    }

    /// The number of the take that capture `k` belongs to.
    pub fn take_index(&self, k: usize) -> usize {
        usize::from(self.settings.cut.is_some_and(|cut| k >= cut))
    }

    /// The take that capture `k` belongs to.
    pub fn take(&self, k: usize) -> &Take {
        &self.takes[self.take_index(k)]
    }

    /// The truth of capture `k`.
    pub fn capture(&self, k: usize) -> Capture<'_> {
        self.take(k).capture(&self.settings, k)
    }

    /// Focal length of the delivered frames in pixels; of a zoom, the one in its middle.
    pub fn focal(&self) -> f64 {
        self.takes[0].camera.lens.focal * self.settings.stabilisation.map_or(1.0, |s| s.zoom)
    }

    /// Which capture each delivered frame shows, and its timestamp.
    pub fn deliveries(&self) -> Vec<Delivery> {
        self.settings.timeline.deliveries(self.settings.frames, self.settings.fps)
    }

    /// Capture `k` as it leaves the camera, before it is coded.
    pub fn frame(&self, k: usize) -> Frame {
        let picture = self.exposed(k, self.renderer(k).rolling(self.start(k)));
        let seed = self.settings.seed ^ (k as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let sensed = picture.sense(self.settings.noise, seed);
        match self.settings.stabilisation {
            None => sensed,
            Some(_) => {
                let capture = self.capture(k);
                resample(&sensed.picture(), |pixel| capture.captured(pixel)).sense(0.0, 0)
            }
        }
    }

    /// The frame that a global shutter takes at the reference instant of capture `k`, without noise and
    /// uncoded, but with the same gain and stabilised as the capture was.
    pub fn global(&self, k: usize) -> Frame {
        let capture = self.capture(k);
        let picture = self.exposed(k, self.renderer(k).global(capture.reference()));
        match self.settings.stabilisation {
            None => picture.sense(0.0, 0),
            Some(_) => {
                let picture = picture.sense(0.0, 0).picture();
                resample(&picture, |pixel| capture.warp.captured(pixel)).sense(0.0, 0)
            }
        }
    }

    fn exposed(&self, k: usize, picture: Picture) -> Picture {
        match self.settings.gain {
            None => picture,
            Some(gain) => gain.apply(k, picture),
        }
    }

    /// The frames of the clip. They come one after another as they are asked for, except where they
    /// are coded, which takes all of them.
    ///
    /// # Errors
    /// Where the settings ask for H.264 and it is not to be had.
    pub fn frames(&self) -> Result<Box<dyn Iterator<Item = Frame> + '_>> {
        // The last two, so that a frame shown twice or blended is rendered once.
        let mut known: VecDeque<(usize, Frame)> = VecDeque::new();
        let mut frame = move |capture: usize| {
            if let Some((_, frame)) = known.iter().find(|(k, _)| *k == capture) {
                return frame.clone();
            }
            known.truncate(1);
            known.push_front((capture, self.frame(capture)));
            known[0].1.clone()
        };
        let frames = self.deliveries().into_iter().map(move |delivery| {
            let first = frame(delivery.capture);
            if delivery.blend > 0.0 {
                first.blended(&frame(delivery.capture + 1), delivery.blend)
            } else {
                first
            }
        });
        Ok(match self.settings.bitrate {
            None => Box::new(frames),
            Some(bitrate) => {
                let coded = media::through_h264(frames.collect(), self.settings.delivered_fps(), bitrate)?;
                Box::new(coded.into_iter())
            }
        })
    }

    /// The renderer of capture `k`, before it is stabilised.
    pub fn renderer(&self, k: usize) -> Renderer<'_> {
        let take = self.take(k);
        Renderer { scene: &take.scene, camera: &take.camera, samples: 2 }
    }
}

/// The seed of a take's scene and path.
fn seed_of(settings: &Settings, take: usize) -> u64 {
    if take == 0 { settings.seed } else { settings.seed ^ OTHER_TAKE }
}

/// The scene of each take.
fn scenes_of(settings: &Settings, textures: Option<&Path>) -> Result<Vec<Arc<Scene>>> {
    let takes = 0..stretches(settings).len();
    takes.map(|take| scenes::shared(settings.scene, seed_of(settings, take), textures)).collect()
}

/// The captures of each take.
fn stretches(settings: &Settings) -> Vec<Range<usize>> {
    let cut = settings.cut.filter(|cut| *cut < settings.frames);
    let first = 0..cut.unwrap_or(settings.frames);
    let second = cut.map(|cut| cut..settings.frames);
    std::iter::once(first).chain(second).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneKind;
    use crate::scene::texture::Texture;
    use crate::stats;
    use nalgebra::Vector2;

    fn small(name: &str) -> Settings {
        Settings { width: 320, height: 240, frames: 4, noise: 0.0, ..named(name).unwrap() }
    }

    /// The displacement of all captures as they arrive, RMS in pixels.
    fn displaced(sequence: &Sequence) -> f64 {
        let samples = (0..sequence.settings.frames).flat_map(|k| sequence.capture(k).samples(12));
        stats::uncorrected(samples).rms
    }

    /// The scene without its textures, which take longest to make and displace nothing.
    fn bare(kind: SceneKind) -> Arc<Scene> {
        let plain = Texture::new(1, vec![[0.5; 3]]);
        Arc::new(kind.covered(1, vec![plain]))
    }

    #[test]
    fn every_sequence_reaches_its_displacement() {
        for settings in catalogue() {
            let Strength::Displacement(target) = settings.strength else { continue };
            let short = Settings { frames: 5, cut: settings.cut.map(|_| 2), ..settings };
            let scenes = stretches(&short).iter().map(|_| bare(short.scene)).collect();
            let sequence = Sequence::filmed(short, scenes);
            let (name, reached) = (&sequence.settings.name, displaced(&sequence));
            assert!((reached - target).abs() < 0.03 * target, "{name}: {reached} px for {target} px");
        }
    }

    #[test]
    fn controls_are_without_displacement() {
        let controls =
            ["control_global", "control_still", "control_eis", "eis_global_walk", "eis_aware_shake"];
        for name in controls {
            assert!(displaced(&Sequence::new(small(name))) < 1e-6, "{name}");
        }
    }

    #[test]
    fn stabilised_frames_show_no_border() {
        let mut shown = Vec::new();
        let stabilised = all().filter(|settings| settings.stabilisation.is_some());
        for settings in stabilised {
            // As many as the blind runs need.
            let frames = settings.frames.max(62);
            let scene = bare(settings.scene);
            let name = settings.name.clone();
            let sequence = match settings.strength {
                Strength::Amplitude(_) => Sequence::in_scene(Settings { frames, ..settings }, scene),
                Strength::Displacement(_) => Sequence::in_scene(settings, scene),
            };
            let Settings { width, height, frames, .. } = sequence.settings;
            let last = Vector2::new(width as f64, height as f64).add_scalar(-1.0);
            let corners = (0..4 * frames).map(|i| {
                let corner = Vector2::new(f64::from(i as u32 % 2), f64::from(i as u32 / 2 % 2));
                sequence.capture(i / 4).captured(corner.component_mul(&last))
            });
            let outside =
                corners.map(|corner| (-corner).sup(&(corner - last)).max()).fold(f64::MIN, f64::max);
            if outside > 1e-6 {
                shown.push(format!("{name}: {outside:.1} px"));
            }
        }
        assert!(shown.is_empty(), "{shown:?}");
    }

    #[test]
    fn a_cut_changes_room_and_path() {
        let moving = Sequence::new(Settings { cut: Some(2), ..small("cut") });
        let pose = |k: usize| moving.take(k).camera.path.pose(0.1);
        assert_eq!(pose(0), pose(1));
        assert_ne!(pose(1), pose(2));
        let still = Sequence::new(Settings { cut: Some(2), ..small("control_still") });
        assert_eq!(still.frame(0), still.frame(1));
        assert_eq!(still.frame(2), still.frame(3));
        let (before, after) = (still.frame(1).luma(), still.frame(2).luma());
        let changed = before.iter().zip(&after).filter(|(a, b)| a.abs_diff(**b) > 10).count();
        assert!(changed > before.len() / 2, "{changed}");
    }

    #[test]
    fn gain_brightens_the_frame_and_its_truth() {
        let flash = Some(Gain { ramp: [0, 1], end: 0.5, flash: Some((2, 1.5)) });
        let sequence = Sequence::new(Settings { gain: flash, ..small("control_still") });
        let mean = |frame: Frame| frame.rgb.iter().map(|byte| f64::from(*byte)).sum::<f64>();
        let ratio = |k| mean(sequence.frame(k)) / mean(sequence.frame(0));
        assert!((ratio(1) - 0.5).abs() < 0.02 && (ratio(2) - 0.75).abs() < 0.03, "{} {}", ratio(1), ratio(2));
        assert_eq!(sequence.frame(2), sequence.global(2));
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
    fn rows_turned_by_a_stabiliser_show_what_a_global_shutter_sees() {
        let psnr = |name: &str| {
            let sequence = Sequence::new(small(name));
            let (delivered, global) = (sequence.frame(3).luma(), sequence.global(3).luma());
            let squares = delivered.iter().zip(&global).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
            10.0 * (255.0f64.powi(2) * global.len() as f64 / squares.sum::<f64>()).log10()
        };
        let (aware, turned) = (psnr("eis_aware_shake"), psnr("eis_rot_shake"));
        assert!(aware > 30.0 && aware > turned + 5.0, "{aware:.1} dB, by one turn a frame {turned:.1} dB");
    }

    #[test]
    fn the_truth_takes_rolling_frames_to_global_ones() {
        for name in [
            "rot1_B0",
            "trans_rot1_B40",
            "btt_g085",
            "ltr_g08",
            "eis",
            "foreground",
            "fisheye",
            "zoom",
            "eis_sim_walk",
            "eis_sim_shake",
            "eis_rot_pan",
        ] {
            let sequence = Sequence::new(small(name));
            let rolling = sequence.frame(2).picture().grey();
            let global = sequence.global(2).picture().grey();
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
