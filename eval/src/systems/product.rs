// SPDX-License-Identifier: MIT OR Apache-2.0

//! The library under test, called as any program would call it.

use anyhow::{Context, Result};
use baselines::methods::{Correction, Corrections};
use nalgebra::Vector2;
use render::footage::{Footage, direction};
use render::scene::Frame;
use render::sequence;
use rsrectify::motion::{FrameMotion, image_centre};
use rsrectify::plane::{Luma, Plane, PlaneLayout, SampleFormat};
use rsrectify::readout::ReadoutTime;
use rsrectify::rectifier::{Duplicate, Estimator, FrameSolution, Rectifier, Settings};
use std::ops::Range;

/// What the product is told of the readout time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delay {
    /// Nothing, not the direction either.
    Unknown,
    /// That the inter-frame delay is 0.
    Zero,
    /// The truth.
    True,
}

/// The library's settings for a sequence.
pub fn settings(
    sequence: &sequence::Settings,
    delay: Delay,
    estimator: Estimator,
    lookahead: usize,
) -> Settings {
    let readout_time = match delay {
        Delay::Unknown => ReadoutTime::Unknown,
        Delay::Zero => ReadoutTime::WholePeriod,
        Delay::True => ReadoutTime::Seconds(sequence.delivered_readout_time()),
    };
    let direction = (delay != Delay::Unknown).then(|| direction(sequence.first));
    let mut settings = Settings::default();
    settings.estimator = estimator;
    settings.lookahead = lookahead;
    settings.direction = direction;
    settings.readout_time = readout_time;
    settings
}

/// Pushes the frames of a sequence and collects the motion of each.
pub fn solve(footage: &Footage, settings: Settings) -> Result<Vec<FrameSolution>> {
    solve_frames(footage, 0..footage.frames.len(), settings)
}

/// The same of some of its frames, as if there were no others.
pub fn solve_frames(
    footage: &Footage,
    frames: Range<usize>,
    settings: Settings,
) -> Result<Vec<FrameSolution>> {
    let (width, height) = (footage.settings().width, footage.settings().height);
    let period = Some(1.0 / footage.settings().delivered_fps());
    let mut rectifier = Rectifier::new(settings, width, height, period)?;
    let all = footage.frames.iter().zip(footage.stamps.iter().copied());
    motions(&mut rectifier, all.skip(frames.start).take(frames.len()))
}

/// Pushes frames, each with its timestamp in seconds, and collects the motion of each.
pub fn motions<'a>(
    rectifier: &mut Rectifier,
    frames: impl IntoIterator<Item = (&'a Frame, f64)>,
) -> Result<Vec<FrameSolution>> {
    let (mut solutions, mut pushed) = (Vec::new(), 0);
    for (frame, stamp) in frames {
        let luma = frame.luma();
        let layout = PlaneLayout::packed(frame.width, frame.height, SampleFormat::U8);
        rectifier.push(&Luma::from(Plane::new(&luma, layout)?), Some(stamp), Duplicate::Detect)?;
        solutions.extend(std::iter::from_fn(|| rectifier.pop()));
        pushed += 1;
    }
    rectifier.drain();
    solutions.extend(std::iter::from_fn(|| rectifier.pop()));
    (solutions.len() == pushed)
        .then_some(solutions)
        .context("the rectifier gave out another number of motions than it was given frames")
}

/// The corrections that solutions stand for.
pub fn corrections(solutions: Vec<FrameSolution>) -> Corrections {
    let correction = |solution| Box::new(move |pixel| corrected(&solution, pixel)) as Box<dyn Correction>;
    solutions.into_iter().map(correction).collect()
}

/// Where a solution takes a pixel: to the middle of the readout, as far as it is applied.
pub fn corrected(solution: &FrameSolution, pixel: Vector2<f64>) -> Vector2<f64> {
    carried(&solution.motion, pixel)
}

/// Where a motion takes a pixel: to the middle of the readout, as far as it is applied, and to where a frame that is stabilised
/// is placed.
pub fn carried(motion: &FrameMotion, pixel: Vector2<f64>) -> Vector2<f64> {
    let (readout, path) = (motion.readout(), motion.path());
    let centre = image_centre(readout.width(), readout.height());
    let share = readout.share(pixel.x, pixel.y);
    let carried = path.carry(pixel - centre, share, 0.5) + centre;
    let rectified = pixel + (carried - pixel) * motion.weight();
    motion.placement().map_or(rectified, |placement| {
        let shown = placement * (rectified - centre).push(1.0);
        shown.xy() / shown.z + centre
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rsrectify::motion::{MotionPath, Twist};
    use rsrectify::readout::{Readout, ReadoutDirection};

    #[test]
    fn a_known_path_carries_to_the_middle_of_the_readout() {
        let time = ReadoutTime::Seconds(0.02);
        let readout = Readout::new(64, 48, ReadoutDirection::BottomToTop, time, 0.04).unwrap();
        let path = MotionPath::uniform(Twist::new(0.0, 100.0, 0.0), 0.02);
        let mut rectifier = Rectifier::new(Settings::default(), 64, 48, None).unwrap();
        let layout = PlaneLayout::packed(64, 48, SampleFormat::U8);
        rectifier.push(&Plane::new(&[0; 64 * 48], layout).unwrap().into(), None, Duplicate::Detect).unwrap();
        let mut solution = rectifier.pop_early().unwrap();
        solution.motion = FrameMotion::new(readout, path);
        // Row 0 is read last, at share 1 − 0.5/48: half a readout (1 px) back, less half a row.
        let seen = Vector2::new(10.0, 0.0);
        let truth = Vector2::new(10.0 - 2.0 * (0.5 - 0.5 / 48.0), 0.0);
        assert!((corrected(&solution, seen) - truth).norm() < 1e-12);
    }

    #[test]
    fn every_frame_gets_its_motion() {
        let settings =
            sequence::Settings { width: 160, height: 120, frames: 5, ..sequence::named("btt_g085").unwrap() };
        let footage = Footage::of_settings(&settings).unwrap();
        for lookahead in [0, 3, 12] {
            let settings = super::settings(footage.settings(), Delay::True, Estimator::Continuous, lookahead);
            let solutions = solve(&footage, settings).unwrap();
            assert_eq!(solutions.len(), 5);
            assert!((solutions[2].motion.readout().time() - 0.85 / 30.0).abs() < 1e-12);
            assert_eq!(solutions[2].motion.readout().direction(), ReadoutDirection::BottomToTop);
        }
    }
}
