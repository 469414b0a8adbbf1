// SPDX-License-Identifier: MIT OR Apache-2.0

//! One filter in a host.

use crate::clock::{Clock, Position};
use crate::parameters::{MOTION_FILE, Values};
use rsrectify::Warper;
use rsrectify::motion::FrameMotion;
use rsrectify::motion::file::MotionFile;
use rsrectify::plane::{Plane, PlaneLayout, PlaneMut, SampleFormat};
use rsrectify::warp::SampleGrid;
use std::ffi::{CStr, CString};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Bytes of a pixel: blue, green, red, alpha.
const CHANNELS: usize = 4;

/// A filter for frames of one size, 8-bit BGRA; hosts may call it from several threads at once.
#[derive(Debug)]
pub struct Filter {
    size: [usize; 2],
    state: Mutex<State>,
    /// Buffers of the warp, one for each thread that is in it.
    warpers: Mutex<Vec<Warper>>,
}

#[derive(Debug, Default)]
struct State {
    values: Values,
    file: Option<Arc<MotionFile>>,
    clock: Clock,
    /// Whether it has been said why frames are left as they are: once is enough.
    has_warned: bool,
}

impl Filter {
    /// A filter for frames of `width` × `height` pixels.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        Self { size: [width, height], state: Mutex::default(), warpers: Mutex::default() }
    }

    /// Bytes of a frame; `None` if there cannot be so many.
    #[must_use]
    pub fn frame_bytes(&self) -> Option<usize> {
        let [width, height] = self.size;
        width.checked_mul(height)?.checked_mul(CHANNELS).filter(|bytes| isize::try_from(*bytes).is_ok())
    }

    /// Sets a text parameter. Hosts set all of them before each frame.
    pub fn set_text(&self, index: usize, value: &CStr) {
        let mut state = lock(&self.state);
        if state.values.text(index) == Some(value) {
            return;
        }
        state.values.set_text(index, value);
        if index == MOTION_FILE {
            (state.has_warned, state.file, state.clock) = (false, None, Clock::default());
            let path = path_of(value);
            if !value.is_empty() {
                match MotionFile::open(&path) {
                    Ok(file) => state.file = Some(Arc::new(file)),
                    Err(error) => state.warn(&format!("{}: {error}", path.display())),
                }
            }
        }
    }

    /// Sets a number parameter.
    pub fn set_number(&self, index: usize, value: f64) {
        lock(&self.state).values.set_number(index, value);
    }

    /// A text parameter.
    #[must_use]
    pub fn text(&self, index: usize) -> Option<CString> {
        lock(&self.state).values.text(index).map(CStr::to_owned)
    }

    /// A number parameter.
    #[must_use]
    pub fn number(&self, index: usize) -> Option<f64> {
        lock(&self.state).values.number(index)
    }

    /// Rectifies the frame that is shown at `time` seconds of the clip; it stays as it is where the motion file has nothing
    /// for it.
    pub fn update(&self, time: f64, input: &[u8], output: &mut [u8]) {
        let warp = {
            let state = lock(&self.state);
            state.values.warp(state.file.as_ref().map_or(1.0, |file| file.clip().zoom))
        };
        let warped = self.motion(time).and_then(|motion| self.warp(&motion, &warp, input, output));
        if warped.is_none() {
            let length = input.len().min(output.len());
            if let Some((input, output)) = input.get(..length).zip(output.get_mut(..length)) {
                output.copy_from_slice(input);
            }
        }
    }

    /// The motion of the frame at a host's time.
    fn motion(&self, time: f64) -> Option<FrameMotion> {
        let (file, position) = {
            let mut state = lock(&self.state);
            let file = state.file.clone()?;
            let settings = state.values.clock();
            let position = state.clock.next(time, &settings, file.interval() as f64 * 1e-9);
            (file, position)
        };
        let nanoseconds = match position {
            Position::Time(nanoseconds) => Some(nanoseconds),
            Position::Frame(frame) => file.time(frame),
            Position::None => None,
        };
        let reason = match (nanoseconds.map(|time| file.upright_motion(time, self.size)), position) {
            (Some(Ok(Some(motion))), _) => return Some(motion),
            (Some(Err(error)), _) => error.to_string(),
            (_, Position::None) => {
                "the host gives no time (ffmpeg: the width is no multiple of 64, see time-unit)".into()
            }
            (_, Position::Frame(frame)) => format!("no frame {frame}"),
            (_, Position::Time(time)) => format!("no motion at {:.3} s", time as f64 * 1e-9),
        };
        let mut state = lock(&self.state);
        let path = state.values.text(MOTION_FILE).map(path_of).unwrap_or_default();
        state.warn(&format!("{} of {}: {reason}", path.display(), file.clip().name));
        None
    }

    /// `None` where the planes are not those of a frame.
    fn warp(
        &self,
        motion: &FrameMotion,
        settings: &rsrectify::warp::WarpSettings,
        input: &[u8],
        output: &mut [u8],
    ) -> Option<()> {
        let [width, height] = self.size;
        let layout = PlaneLayout {
            stride: width * CHANNELS,
            step: CHANNELS,
            channels: CHANNELS,
            ..PlaneLayout::packed(width, height, SampleFormat::U8)
        };
        let (source, mut target) = (Plane::new(input, layout).ok()?, PlaneMut::new(output, layout).ok()?);
        let mut warper = lock(&self.warpers).pop().unwrap_or_default();
        let warped = warper.prepare(motion, settings).warp(&source, &mut target, SampleGrid::FULL);
        lock(&self.warpers).push(warper);
        warped.ok()
    }
}

impl State {
    /// Says why frames stay as they are; frei0r has no other way than the host's error output.
    #[allow(clippy::print_stderr)]
    fn warn(&mut self, reason: &str) {
        if !std::mem::replace(&mut self.has_warned, true) {
            eprintln!("rsrectify: frames stay as they are: {reason}");
        }
    }
}

/// The path that a host has given.
fn path_of(text: &CStr) -> PathBuf {
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStrExt;
        PathBuf::from(std::ffi::OsStr::from_bytes(text.to_bytes()))
    }
    #[cfg(not(unix))]
    PathBuf::from(text.to_string_lossy().into_owned())
}

/// Locks a mutex; a panic elsewhere does not make its data unreadable.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
