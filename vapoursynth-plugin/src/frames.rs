// SPDX-License-Identifier: MIT OR Apache-2.0

//! One frame: which motion it has, its planes rectified.

use rsrectify::Warper;
use rsrectify::motion::FrameMotion;
use rsrectify::motion::file::MotionFile;
use rsrectify::plane::{Plane, PlaneLayout, PlaneMut, SampleFormat};
use rsrectify::warp::{BorderMode, Fill, Interpolation, SampleGrid, WarpSettings};
use std::path::Path;
use std::slice;
use std::sync::{Mutex, PoisonError};
use vapoursynth4_rs::core::Core;
use vapoursynth4_rs::ffi::VSColorFamily;
use vapoursynth4_rs::frame::{Frame, VideoFormat, VideoFrame};
use vapoursynth4_rs::map::Key;

/// Largest share that can be cropped.
const MOST_CROP: f64 = 0.5;

/// How frames are rectified.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    warp: WarpSettings,
    zoom: Zoom,
    crop: f64,
    /// Seconds of the recording at which the clip's time is 0.
    start: f64,
}

/// Which zoom hides the borders, if any does.
#[derive(Clone, Copy, Debug)]
enum Zoom {
    OfFile,
    OfCrop,
    None,
}

impl Default for Settings {
    fn default() -> Self {
        Self { warp: WarpSettings::default(), zoom: Zoom::OfFile, crop: 0.05, start: 0.0 }
    }
}

fn in_range(name: &str, value: f64, range: std::ops::RangeInclusive<f64>) -> Result<f64, String> {
    let refusal = || format!("{name} must be between {} and {}", range.start(), range.end());
    Some(value).filter(|value| range.contains(value)).ok_or_else(refusal)
}

impl Settings {
    pub fn set_interpolation(&mut self, name: &str) -> Result<(), String> {
        self.warp.interpolation = match name {
            "nearest" => Interpolation::Nearest,
            "linear" => Interpolation::Linear,
            "cubic" => Interpolation::Cubic,
            "lanczos" => Interpolation::Lanczos,
            _ => return Err("interpolation must be nearest, linear, cubic or lanczos".into()),
        };
        Ok(())
    }

    pub fn set_border(&mut self, name: &str) -> Result<(), String> {
        self.warp.border = match name {
            "auto" | "replicate" | "crop" => BorderMode::Replicate,
            "mirror" => BorderMode::Mirror,
            // Its samples are those of the format at hand.
            "constant" => BorderMode::Constant(Fill::default()),
            _ => return Err("border must be auto, replicate, mirror, constant or crop".into()),
        };
        self.zoom = match name {
            "auto" => Zoom::OfFile,
            "crop" => Zoom::OfCrop,
            _ => Zoom::None,
        };
        Ok(())
    }

    pub fn set_strength(&mut self, strength: f64) -> Result<(), String> {
        self.warp.strength = in_range("strength", strength, 0.0..=1.0)?;
        Ok(())
    }

    pub fn set_crop(&mut self, crop: f64) -> Result<(), String> {
        self.crop = in_range("crop", crop, 0.0..=MOST_CROP)?;
        Ok(())
    }

    pub fn set_start(&mut self, start: f64) -> Result<(), String> {
        self.start = in_range("start", start, -1e9..=1e9)?;
        Ok(())
    }
}

/// Rectifies the frames of a clip by a motion file.
pub struct Rectifier {
    file: MotionFile,
    settings: Settings,
    /// Buffers of the warp, one for each thread that is in it.
    warpers: Mutex<Vec<Warper>>,
}

impl Rectifier {
    /// Opens the motion file of a clip.
    pub fn open(path: &Path, mut settings: Settings) -> Result<Self, String> {
        let file = MotionFile::open(path).map_err(|error| format!("{}: {error}", path.display()))?;
        settings.warp.zoom = match settings.zoom {
            Zoom::OfFile => file.clip().zoom,
            Zoom::OfCrop => 1.0 / (1.0 - settings.crop),
            Zoom::None => 1.0,
        };
        settings.warp.hide_borders = settings.warp.zoom > 1.0;
        Ok(Self { file, settings, warpers: Mutex::default() })
    }

    /// Rectifies frame `number` of the clip; it stays as it is where the file does not have it.
    pub fn rectified(&self, number: i32, source: VideoFrame, core: &Core) -> Result<VideoFrame, String> {
        let Some(motion) = self.motion(number, &source)? else { return Ok(source) };
        let format = source.get_video_format();
        let [width, height] = [source.frame_width(0), source.frame_height(0)];
        let mut target = core.new_video_frame(format, width, height, Some(&source));
        let mut warper =
            self.warpers.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default();
        let mut settings = self.settings.warp;
        if matches!(settings.border, BorderMode::Constant(_)) {
            settings.border = BorderMode::Constant(black(format));
        }
        let prepared = warper.prepare(&motion, &settings);
        for index in 0..format.num_planes {
            let layout = layout(&source, index)?;
            let target_layout = PlaneLayout { stride: stride(&target, index)?, ..layout };
            let bytes = |layout: &PlaneLayout| layout.required_bytes().ok_or("a plane is too large");
            let (source_bytes, target_bytes) = (bytes(&layout)?, bytes(&target_layout)?);
            // SAFETY: VapourSynth's planes have as many rows as stated, `stride` bytes apart; nobody writes to this one.
            let from = unsafe { slice::from_raw_parts(source.plane(index), source_bytes) };
            // SAFETY: as above; the frame is new, and this is the only slice to the plane.
            let to = unsafe { slice::from_raw_parts_mut(target.plane_mut(index), target_bytes) };
            let from = Plane::new(from, layout).map_err(|error| error.to_string())?;
            let mut to = PlaneMut::new(to, target_layout).map_err(|error| error.to_string())?;
            let grid = if index > 0 { chroma(format, &source) } else { SampleGrid::FULL };
            let index = usize::try_from(index).unwrap_or(0);
            prepared.warp_plane(index, &from, &mut to, grid).map_err(|error| error.to_string())?;
        }
        self.warpers.lock().unwrap_or_else(PoisonError::into_inner).push(warper);
        Ok(target)
    }

    /// The motion of a frame: by the time that its source filter has stated, else by its number.
    fn motion(&self, number: i32, frame: &VideoFrame) -> Result<Option<FrameMotion>, String> {
        let stated = property(frame, "_AbsoluteTime", |map, key| map.get_float(key, 0).ok());
        let time = match stated.filter(|seconds| seconds.is_finite()) {
            Some(seconds) => Some(((seconds + self.settings.start) * 1e9).round() as i64),
            None => usize::try_from(number).ok().and_then(|number| self.file.time(number)),
        };
        let Some(time) = time else { return Ok(None) };
        let side = |side: i32| usize::try_from(side).unwrap_or(0);
        let size = [side(frame.frame_width(0)), side(frame.frame_height(0))];
        // Source filters do not turn frames, scripts may.
        let motion = self.file.motion(time, size).or_else(|_| self.file.upright_motion(time, size));
        motion.map_err(|error| error.to_string())
    }
}

/// A property of a frame.
fn property<T>(
    frame: &VideoFrame,
    name: &str,
    value: impl FnOnce(&vapoursynth4_rs::map::Map, &Key) -> Option<T>,
) -> Option<T> {
    value(&*frame.properties()?, &Key::new(name).ok()?)
}

fn stride(frame: &VideoFrame, plane: i32) -> Result<usize, String> {
    usize::try_from(frame.stride(plane)).map_err(|_| "the rows of a plane are upside down".into())
}

fn layout(frame: &VideoFrame, plane: i32) -> Result<PlaneLayout, String> {
    let format = match frame.get_video_format().bits_per_sample {
        8 => SampleFormat::U8,
        10 => SampleFormat::U10,
        12 => SampleFormat::U12,
        16 => SampleFormat::U16,
        bits => return Err(format!("samples of {bits} bits")),
    };
    let side = |side: i32| usize::try_from(side).map_err(|_| "a plane without a size");
    let (width, height) = (side(frame.frame_width(plane))?, side(frame.frame_height(plane))?);
    Ok(PlaneLayout { stride: stride(frame, plane)?, ..PlaneLayout::packed(width, height, format) })
}

/// Where the chroma samples lie: between two luma samples, or on the first of them.
fn chroma(format: &VideoFormat, frame: &VideoFrame) -> SampleGrid {
    if format.color_family != VSColorFamily::YUV {
        return SampleGrid::FULL;
    }
    // As ITU-T H.273 counts: left, centre, top left, top, bottom left, bottom.
    let location = property(frame, "_ChromaLocation", |map, key| map.get_int(key, 0).ok()).unwrap_or(0);
    let scale =
        [format.sub_sampling_w, format.sub_sampling_h].map(|shift| f64::from(1_u32 << shift.clamp(0, 4)));
    let across = if matches!(location, 1 | 3 | 5) { 0.5 } else { 0.0 };
    let down = match location {
        2 | 3 => 0.0,
        4 | 5 => 1.0,
        _ => 0.5,
    };
    SampleGrid { scale, offset: [across * (scale[0] - 1.0), down * (scale[1] - 1.0)] }
}

/// Black.
fn black(format: &VideoFormat) -> Fill {
    let above = u32::try_from(format.bits_per_sample - 8).unwrap_or(0);
    match format.color_family {
        VSColorFamily::YUV => Fill::planar([16, 128, 128, 0].map(|value| value << above)),
        _ => Fill::default(),
    }
}
