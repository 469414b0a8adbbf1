// SPDX-License-Identifier: MIT OR Apache-2.0

//! The motion of a clip from a file, applied instead of being looked for.

use crate::rectifier_options::{Crop, RectifierOptions};
use crate::steady;
use anyhow::{Context, Result, bail};
use gst::prelude::*;
use gstrsrectify::rsrectify::RsRectify;
use rsrectify::motion::FrameMotion;
use rsrectify::motion::file::MotionFile;
use rsrectify::warp::least_zoom;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// A motion file that is applied to a clip.
#[derive(Clone, Debug)]
pub struct Motions(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    path: PathBuf,
    file: MotionFile,
    /// Frames that were asked for, and those of them that the file has.
    frames: AtomicUsize,
    covered: AtomicUsize,
    /// The first error.
    error: Mutex<Option<String>>,
}

impl Motions {
    /// Opens a file.
    pub fn open(path: &Path) -> Result<Self> {
        let file = MotionFile::open(path).with_context(|| format!("cannot use {}", path.display()))?;
        let (frames, covered, error) = Default::default();
        Ok(Self(Arc::new(Inner { path: path.to_owned(), file, frames, covered, error })))
    }

    /// That the file was written of another one than the clip, if it was.
    pub fn other_clip(&self, clip: &Path) -> Option<String> {
        let (Inner { path, file, .. }, bytes) = (&*self.0, std::fs::metadata(clip).ok()?.len());
        let of = file.clip();
        (of.bytes != bytes).then(|| {
            format!("{} is of {} with {} bytes: it is applied by time", path.display(), of.name, of.bytes)
        })
    }

    /// Sets the crop: that of the file, unless another one, or another border, is asked for; with `auto`, and where the file has none, the
    /// least that hides the borders of all frames. What is to be said of it.
    pub fn set_crop(&self, options: &mut RectifierOptions) -> Result<Option<String>> {
        let file = &self.0.file;
        let is_asked = options.steadiness.crop.is_some() || options.border_mode.is_some();
        if file.clip().zoom > 1.0 && (!is_asked || options.crop() == Some(Crop::Auto)) {
            // As it was asked for, or found, before it became a zoom.
            let crop = 100.0 * (1.0 - 1.0 / file.clip().zoom);
            options.steadiness.crop = Some(Crop::PerCent((crop * 1e6).round() / 1e6));
        } else if options.crop() == Some(Crop::Auto) {
            let warp = steady::warp_settings(options);
            let zooms = (0..file.frames())
                .map(|frame| file.record(frame).map(|record| least_zoom(&record.motion, &warp)));
            let zoom = zooms.reduce(|a, b| Ok(a?.max(b?))).transpose()?;
            return steady::crop_for(zoom.unwrap_or(1.0), options).map(Some);
        }
        Ok(None)
    }

    /// Has a rectifier apply the motions. Its frames come `later` by so many nanoseconds than in the clip; `note` is given the motion
    /// of each, if there is one, and its time.
    pub fn apply(
        &self,
        rectifier: &gst::Element,
        later: Arc<AtomicU64>,
        note: impl Fn(Option<gst::ClockTime>, Option<&FrameMotion>) + Send + Sync + 'static,
    ) -> Result<()> {
        let rectifier = rectifier.downcast_ref::<RsRectify>().context("the rectifier is another element")?;
        let inner = self.0.clone();
        inner.frames.store(0, Ordering::Relaxed);
        inner.covered.store(0, Ordering::Relaxed);
        rectifier.set_motion_source(move |time, size| {
            let later = later.load(Ordering::Relaxed);
            let in_clip = time.and_then(|time| i64::try_from(time.nseconds().checked_sub(later)?).ok());
            let motion = inner.motion(in_clip, size);
            note(time, motion.as_ref());
            motion
        });
        Ok(())
    }

    /// An error where the file has nothing for the clip; what is to be said where it does not have all.
    pub fn check(&self) -> Result<Option<String>> {
        let Inner { path, frames, covered, error, .. } = &*self.0;
        let (path, error) = (path.display(), error.lock().unwrap_or_else(PoisonError::into_inner));
        let (frames, covered) = (frames.load(Ordering::Relaxed), covered.load(Ordering::Relaxed));
        match &*error {
            Some(error) => bail!("{path} cannot be applied: {error}"),
            None if covered == 0 && frames > 0 => {
                bail!("{path} is of another clip: it has none of the frames' times")
            }
            None if covered < frames => Ok(Some(format!(
                "{path} does not have {} of {frames} frames: they stay as they are",
                frames - covered
            ))),
            None => Ok(None),
        }
    }
}

impl Inner {
    fn motion(&self, time: Option<i64>, size: [usize; 2]) -> Option<FrameMotion> {
        self.frames.fetch_add(1, Ordering::Relaxed);
        let motion = self.file.motion(time?, size);
        match &motion {
            Ok(Some(_)) => {
                self.covered.fetch_add(1, Ordering::Relaxed);
            }
            Ok(None) => {}
            Err(error) => {
                let mut first = self.error.lock().unwrap_or_else(PoisonError::into_inner);
                first.get_or_insert_with(|| error.to_string());
            }
        }
        motion.ok().flatten()
    }
}
