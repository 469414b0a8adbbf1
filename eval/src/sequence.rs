//! Named sequences and their settings.

use crate::scene::path::{Motion, Oscillations};
use crate::scene::{FirstEdge, Frame, Pinhole, Renderer, RollingCamera, Scene, Shutter, room};
use crate::truth::Truth;
use std::sync::Arc;

/// Focal length in frame widths: a field of view of 53° across.
const FOCAL: f64 = 1.0;

/// How strong the motion is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Strength {
    /// A factor on the motion's own amplitude.
    Amplitude(f64),
    /// So strong that the frames as they are seen lie this many pixels (RMS) from their truth.
    Displacement(f64),
}

/// Everything that determines a sequence.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The sequence's name.
    pub name: String,
    /// Frame width in pixels.
    pub width: usize,
    /// Frame height in pixels.
    pub height: usize,
    /// Number of frames.
    pub frames: usize,
    /// Frames a second.
    pub fps: f64,
    /// Readout ratio γ = T / frame period, 0 (global shutter) to 1.
    pub readout_ratio: f64,
    /// The edge exposed first.
    pub first: FirstEdge,
    /// Standard deviation of the sensor noise in grey levels.
    pub noise: f32,
    /// How the camera moves.
    pub motion: Motion,
    /// How strongly.
    pub strength: Strength,
    /// Seed of the path, the textures and the noise.
    pub seed: u64,
}

impl Settings {
    fn new(name: &str, motion: Motion, strength: Strength) -> Self {
        Self {
            name: name.into(),
            width: 640,
            height: 480,
            frames: 24,
            fps: 30.0,
            readout_ratio: 1.0,
            first: FirstEdge::Top,
            noise: 0.0,
            motion,
            strength,
            seed: 1,
        }
    }

    /// With `rows` blank rows between frames of 480: γ = 480 / (480 + rows), whatever the size.
    fn blank_rows(mut self, rows: f64) -> Self {
        self.readout_ratio = 480.0 / (480.0 + rows);
        self
    }

    /// Readout time T in seconds.
    pub fn readout_time(&self) -> f64 {
        self.readout_ratio / self.fps
    }
}

/// The settings of all named sequences.
///
/// The first five follow the data set of P.-E. Forssén and E. Ringaby, *Rectifying rolling shutter
/// video from hand-held devices*, CVPR 2010, in name, kind of motion, frame size and blank rows.
pub fn catalogue() -> Vec<Settings> {
    use Strength::{Amplitude, Displacement};
    let shake = |lowest, highest| Motion::Shake { lowest, highest };
    vec![
        Settings::new("rot1_B0", Motion::SpiralRotation, Displacement(9.0)),
        Settings::new("rot1_B40", Motion::SpiralRotation, Displacement(9.0)).blank_rows(40.0),
        Settings::new("rot2_B40", Motion::Rotation, Displacement(5.5)).blank_rows(40.0),
        Settings::new("trans1_B40", Motion::Translation, Displacement(5.0)).blank_rows(40.0),
        Settings::new("trans_rot1_B40", Motion::RotationAndTranslation, Displacement(6.0)).blank_rows(40.0),
        Settings {
            readout_ratio: 0.42,
            noise: 3.0,
            frames: 30,
            ..Settings::new("shake_g042", shake(0.04, 0.4), Displacement(3.0))
        },
        Settings {
            readout_ratio: 0.85,
            first: FirstEdge::Bottom,
            noise: 3.0,
            frames: 30,
            ..Settings::new("btt_g085", shake(0.015, 0.15), Displacement(5.0))
        },
        Settings { frames: 30, ..Settings::new("vibration", Motion::Vibration, Displacement(5.0)) },
        Settings { readout_ratio: 0.0, ..Settings::new("control_global", shake(0.04, 0.4), Amplitude(1.0)) },
        Settings { noise: 2.0, ..Settings::new("control_still", Motion::Still, Amplitude(0.0)) },
    ]
}

/// The settings of the sequence with this name.
pub fn named(name: &str) -> Option<Settings> {
    catalogue().into_iter().find(|settings| settings.name == name)
}

/// The clip that shows what a rolling shutter does: 4.5 s at 1280×720, strongly shaken.
pub fn demo() -> Settings {
    Settings {
        width: 1280,
        height: 720,
        frames: 135,
        noise: 1.0,
        ..Settings::new("demo", Motion::Shake { lowest: 0.05, highest: 0.13 }, Strength::Displacement(13.0))
    }
}

/// A sequence ready to be rendered and judged.
pub struct Sequence {
    /// What determines it.
    pub settings: Settings,
    /// What is seen.
    pub scene: Arc<Scene>,
    /// Who sees it.
    pub camera: RollingCamera,
}

impl Sequence {
    /// Builds the room and chooses the amplitude.
    pub fn new(settings: Settings) -> Self {
        let scene = Arc::new(room::room(settings.seed));
        Self::in_scene(settings, scene)
    }

    /// A sequence in a scene that is there already.
    pub fn in_scene(settings: Settings, scene: Arc<Scene>) -> Self {
        let camera = camera(&settings, 1.0);
        let mut sequence = Self { settings, scene, camera };
        match sequence.settings.strength {
            Strength::Amplitude(amplitude) => sequence.camera = camera_of(&sequence, amplitude),
            Strength::Displacement(pixels) => sequence.reach(pixels),
        }
        sequence
    }

    /// When frame `k` starts to be read, in seconds.
    pub fn start(&self, k: usize) -> f64 {
        k as f64 / self.settings.fps
    }

    /// The truth of this sequence.
    pub fn truth(&self) -> Truth<'_> {
        Truth::new(self)
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
        Renderer { scene: &self.scene, camera: &self.camera, samples: 2 }
    }

    /// Scales the motion until the uncorrected frames are `target` pixels from their truth.
    ///
    /// Displacement is nearly proportional to the amplitude, so that repeated proportion settles
    /// quickly; the visibility mask and perspective bend it a little.
    fn reach(&mut self, target: f64) {
        let mut amplitude = 1.0;
        for _ in 0..8 {
            self.camera = camera_of(self, amplitude);
            let reached = self.truth().uncorrected(self.settings.width / 40).rms;
            if (reached - target).abs() < 1e-3 * target {
                break;
            }
            amplitude *= target / reached.max(1e-6);
        }
    }
}

fn camera_of(sequence: &Sequence, amplitude: f64) -> RollingCamera {
    camera(&sequence.settings, amplitude)
}

fn camera(settings: &Settings, amplitude: f64) -> RollingCamera {
    let focal = FOCAL * settings.width as f64;
    RollingCamera {
        lens: Pinhole { width: settings.width, height: settings.height, focal },
        shutter: Shutter { first: settings.first, readout: settings.readout_time() },
        path: Box::new(Oscillations::new(settings.motion, amplitude, settings.fps, settings.seed)),
    }
}
