// SPDX-License-Identifier: MIT OR Apache-2.0

//! A real clip without truth: what can be said of the library on it all the same.

use crate::metrics::homography::{Homography, median};
use crate::metrics::readout::signed_ratio;
use crate::metrics::resample::{Rectified, rectified};
use crate::metrics::{harm, jitter, wobble};
use crate::shutter::Shutter;
use crate::systems::product::{corrections, motions};
use anyhow::{Context, Result, ensure};
use baselines::correspondences::Follower;
use baselines::methods::Corrections;
use indicatif::{ProgressBar, ProgressIterator, ProgressStyle};
use nalgebra::Vector2;
use render::media::Clip;
use render::scene::Frame;
use render::stats::Stats;
use rsrectify::Rectifier;
use rsrectify::correspond::Correspondence;
use rsrectify::readout::Readout;
use rsrectify::rectifier::{FrameSolution, Settings};
use std::fmt;
use std::fs;
use std::path::Path;

/// Stills that are written.
const STILLS: usize = 4;

/// How a clip fared.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// Pixels in a row, rows, frames.
    pub size: [usize; 3],
    /// Frames a second.
    pub fps: f64,
    /// The shutter that the last frame was solved with, told or found.
    pub readout: Readout,
    /// Wobble in pixels over the pairs of successive frames, as they arrive.
    pub wobble_before: Stats,
    /// The same of the rectified frames.
    pub wobble_after: Stats,
    /// Jitter of the content.
    pub jitter_content: Stats,
    /// Jitter of the correction.
    pub jitter_added: Stats,
    /// Median over the frames of the root mean square displacement that was taken out, in pixels.
    pub displacement: f64,
    /// Median confidence.
    pub confidence: f64,
}

/// Rectifies a clip, judges it, and writes stills, before and after side by side, to `out`: of each
/// quarter of the clip the frame that was displaced most.
///
/// # Errors
/// If the clip has fewer than three frames, the shutter is nonsense, or stills cannot be written.
pub fn judge(clip: &Clip, shutter: &Shutter, lookahead: usize, out: Option<&Path>) -> Result<Verdict> {
    ensure!(clip.frames.len() >= 3, "the clip has {} frames; it takes 3 or more", clip.frames.len());
    let solutions = solve(clip, shutter.settings(1.0 / clip.fps, lookahead)?)?;
    let readout = *solutions[solutions.len() - 1].motion.readout();
    let confidence = median(&mut solutions.iter().map(|solution| solution.confidence).collect::<Vec<_>>());
    let corrections = corrections(solutions);
    let size = [clip.width, clip.height];
    let displaced: Vec<f64> =
        corrections.chunks(1).map(|correction| harm::added(size, correction).rms).collect();
    let frames = clip.frames.iter().zip(&corrections);
    let before = seen(clip, readout, "measuring the input", clip.frames.iter().map(as_it_is))?;
    let after = seen(clip, readout, "measuring the output", frames.map(|(frame, c)| rectified(frame, &**c)))?;
    if let Some(folder) = out {
        write_stills(clip, &corrections, &displaced, folder)?;
    }
    Ok(Verdict {
        size: [clip.width, clip.height, clip.frames.len()],
        fps: clip.fps,
        readout,
        wobble_before: Stats::of(before.wobble),
        wobble_after: Stats::of(after.wobble),
        jitter_content: jitter::content(size, &before.motions),
        jitter_added: jitter::added(size, &corrections),
        displacement: median(&mut displaced.clone()),
        confidence,
    })
}

/// The motion of each frame of a clip.
pub(crate) fn solve(clip: &Clip, settings: Settings) -> Result<Vec<FrameSolution>> {
    let period = 1.0 / clip.fps;
    let mut rectifier = Rectifier::new(settings, clip.width, clip.height, Some(period))?;
    let stamped = clip.frames.iter().enumerate().map(|(k, frame)| (frame, k as f64 * period));
    motions(&mut rectifier, stamped.progress_with(bar(clip.frames.len(), "finding the motion")))
}

/// A bar on the standard error, unless that is no terminal.
fn bar(length: usize, message: &'static str) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg:22} {wide_bar} {pos}/{len}");
    let bar = ProgressBar::new(length as u64).with_message(message);
    style.map_or(bar.clone(), |style| bar.with_style(style))
}

/// What successive frames show.
#[derive(Default)]
pub(crate) struct Seen {
    /// Of each pair whose motion was found.
    pub wobble: Vec<f64>,
    /// From each frame to the next.
    pub motions: Vec<Option<Homography>>,
}

/// Follows successive pictures, leaving out what repeats their borders.
pub(crate) fn seen(
    clip: &Clip,
    readout: Readout,
    message: &'static str,
    pictures: impl Iterator<Item = Rectified>,
) -> Result<Seen> {
    let mut follower = Follower::new(clip.width, clip.height);
    let (mut seen, mut before) = (Seen::default(), Vec::new());
    for picture in pictures.progress_with(bar(clip.frames.len(), message)) {
        if let Some(mut pairs) = follower.follow(&picture.frame)? {
            pairs.retain(|pair| shows(&before, clip, pair.from) && shows(&picture.inside, clip, pair.to));
            seen.add(&pairs, &readout);
        }
        before = picture.inside;
    }
    Ok(seen)
}

impl Seen {
    fn add(&mut self, pairs: &[Correspondence], readout: &Readout) {
        self.wobble.extend(wobble::between(pairs, readout));
        self.motions.push(Homography::fit(pairs));
    }
}

/// A frame all of which is picture.
pub(crate) fn as_it_is(frame: &Frame) -> Rectified {
    Rectified { frame: frame.clone(), inside: vec![true; frame.width * frame.height] }
}

fn shows(inside: &[bool], clip: &Clip, at: Vector2<f64>) -> bool {
    let (x, y) = (at.x.round(), at.y.round());
    let within = x >= 0.0 && y >= 0.0 && x < clip.width as f64 && y < clip.height as f64;
    within && inside[y as usize * clip.width + x as usize]
}

fn write_stills(clip: &Clip, corrections: &Corrections, displaced: &[f64], folder: &Path) -> Result<()> {
    let unwritable = || format!("cannot write stills to {}", folder.display());
    fs::create_dir_all(folder).with_context(unwritable)?;
    for index in most_displaced(displaced) {
        let frame = &clip.frames[index];
        let still = side_by_side(frame, &rectified(frame, &*corrections[index]).frame);
        let path = folder.join(format!("frame-{index:05}.png"));
        let (width, height) = (still.width as u32, still.height as u32);
        image::save_buffer(path, &still.rgb, width, height, image::ColorType::Rgb8)
            .with_context(unwritable)?;
    }
    Ok(())
}

/// The frame with the greatest displacement in each of [`STILLS`] equal stretches.
fn most_displaced(displaced: &[f64]) -> Vec<usize> {
    let length = displaced.len().div_ceil(STILLS).max(1);
    let stretches = displaced.chunks(length).enumerate();
    let most = stretches.filter_map(|(stretch, displaced)| {
        let (index, _) = displaced.iter().enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b))?;
        Some(stretch * length + index)
    });
    most.collect()
}

fn side_by_side(left: &Frame, right: &Frame) -> Frame {
    let rows = left.rgb.chunks_exact(3 * left.width).zip(right.rgb.chunks_exact(3 * right.width));
    let rgb = rows.flat_map(|(left, right)| [left, right].concat()).collect();
    Frame { width: left.width + right.width, height: left.height, rgb }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [width, height, frames] = self.size;
        let share = |part: &Stats, of: &Stats| {
            part.share_of(of).map_or("–".into(), |share| format!("{:.0} %", 100.0 * share))
        };
        let (ratio, direction) = (signed_ratio(&self.readout, 1.0 / self.fps), self.readout.direction());
        writeln!(f, "clip            {width}×{height}, {frames} frames, {:.3} frames/s", self.fps)?;
        writeln!(f, "readout ratio   {ratio:+.3} ({direction:?})")?;
        writeln!(f, "confidence      {:.2} (median)", self.confidence)?;
        writeln!(f, "displacement    {:.2} px taken out (median over the frames)", self.displacement)?;
        let (before, after) = (&self.wobble_before, &self.wobble_after);
        writeln!(
            f,
            "wobble          {:.3} → {:.3} px RMS ({}), {:.3} → {:.3} px p95",
            before.rms,
            after.rms,
            share(after, before),
            before.p95,
            after.p95
        )?;
        let (content, added) = (&self.jitter_content, &self.jitter_added);
        writeln!(
            f,
            "jitter          {:.3} px RMS added ({} of the content's {:.3})",
            added.rms,
            share(added, content),
            content.rms
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use render::sequence::{Sequence, Settings, named};

    fn rendered(name: &str, frames: usize) -> Clip {
        let settings = Settings { width: 320, height: 240, frames, ..named(name).unwrap() };
        let sequence = Sequence::new(settings);
        Clip { width: 320, height: 240, fps: 30.0, frames: sequence.frames().unwrap().collect() }
    }

    #[test]
    fn a_still_clip_is_left_as_it_is() {
        let verdict = judge(&rendered("control_still", 3), &Shutter::default(), 1, None).unwrap();
        assert!(verdict.wobble_before.rms < 0.05 && verdict.wobble_after.rms < 0.05, "{verdict}");
        assert!(verdict.jitter_added.rms < 0.1 && verdict.displacement < 0.05, "{verdict}");
    }

    #[test]
    fn stills_show_the_clip_before_and_after() {
        let folder = tempfile::tempdir().unwrap();
        let clip = rendered("rot1_B0", 4);
        let global = Shutter { readout_ratio: Some(0.0), ..Shutter::default() };
        let verdict = judge(&clip, &global, 1, Some(folder.path())).unwrap();
        // Nothing is corrected where the readout takes no time.
        assert!(verdict.displacement < 1e-9 && verdict.jitter_added.rms < 1e-9, "{verdict}");
        assert!((verdict.wobble_before.rms - verdict.wobble_after.rms).abs() < 1e-9, "{verdict}");
        for (index, frame) in clip.frames.iter().enumerate() {
            let still = image::open(folder.path().join(format!("frame-{index:05}.png"))).unwrap().into_rgb8();
            assert_eq!(still.dimensions(), (640, 240));
            assert_eq!(still.into_raw(), side_by_side(frame, frame).rgb);
        }
    }

    #[test]
    fn the_most_displaced_frame_of_each_quarter_is_shown() {
        assert_eq!(most_displaced(&[0.0, 3.0, 1.0, 2.0, 9.0, 8.0, 0.5, 0.1]), [1, 3, 4, 6]);
        assert_eq!(most_displaced(&[1.0, 2.0]), [0, 1]);
    }

    #[test]
    fn clips_that_are_too_short_are_refused() {
        let error = judge(&rendered("control_still", 2), &Shutter::default(), 1, None).unwrap_err();
        assert!(error.to_string().contains("2 frames"), "{error}");
    }
}
