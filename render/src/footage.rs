// SPDX-License-Identifier: MIT OR Apache-2.0

//! A sequence in memory: its frames as they arrive, and what is known of each.

use crate::scene::{FirstEdge, Frame};
use crate::sequence::{Sequence, Settings};
use crate::stats::{self, Stats};
use crate::truth::{Capture, DisplacementMap, Sample};
use anyhow::Result;
use rsrectify::readout::{Readout, ReadoutDirection, ReadoutTime};
use std::collections::BTreeMap;

/// Truth is sampled every so many pixels.
pub const STEP: usize = 8;

/// A sequence in memory.
pub struct Footage {
    /// What it was rendered from.
    pub sequence: Sequence,
    /// The frames as they arrive.
    pub frames: Vec<Frame>,
    /// The timestamp of each frame in seconds: the start of its readout, unless the clip was resampled.
    pub stamps: Vec<f64>,
    /// The capture that each frame shows.
    pub captures: Vec<usize>,
    /// The truth of each frame: that of the capture it shows.
    pub truth: Vec<FrameTruth>,
}

/// How much of the truth is wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Truth {
    /// Displacements and what a global shutter sees.
    Whole,
    /// Displacements alone: the picture of a global shutter takes as long to render as the frame.
    Displacements,
}

/// What a global shutter sees.
#[derive(Clone, Debug, PartialEq)]
pub struct GlobalView {
    /// Its frame.
    pub picture: Frame,
    /// For each pixel, row by row, whether the rolling shutter's frame shows what is seen there.
    pub visible: Vec<bool>,
}

/// What is known of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameTruth {
    /// Width and height in pixels.
    pub size: [usize; 2],
    /// Where every [`STEP`]th pixel belongs at the reference instant, where that can be judged. There are none of a
    /// frame that shows two instants at once: it is to be left as it is.
    pub samples: Vec<Sample>,
    /// What a global shutter sees at the reference instant; `None` unless [`Truth::Whole`] was wanted.
    pub global: Option<GlobalView>,
    /// To where points are at the first instant of the readout, every [`STEP`]th pixel.
    pub first: DisplacementMap,
    /// To where they are at its last instant.
    pub last: DisplacementMap,
    /// To where the next frame of the run sees them; `None` for the last one.
    pub forward: Option<DisplacementMap>,
    /// To where the frame before it in the run sees them; `None` for the first one.
    pub backward: Option<DisplacementMap>,
}

impl FrameTruth {
    /// The truth of a capture, and of its displacement to the captures shown before and after it.
    fn of(sequence: &Sequence, capture: usize, [before, after]: [Option<usize>; 2], wanted: Truth) -> Self {
        let own = sequence.capture(capture);
        let to = |other: usize| own.displacement_to(&sequence.capture(other), STEP);
        let global = || GlobalView { picture: sequence.global(capture), visible: own.visibility() };
        Self {
            size: [sequence.settings.width, sequence.settings.height],
            samples: own.samples(STEP),
            global: (wanted == Truth::Whole).then(global),
            first: own.displacement_to_share(0.0, STEP),
            last: own.displacement_to_share(1.0, STEP),
            forward: after.map(to),
            backward: before.map(to),
        }
    }
}

impl Footage {
    /// Renders the sequence of the settings with procedural textures.
    ///
    /// # Errors
    /// Where the settings ask for H.264 and it is not to be had.
    pub fn of_settings(settings: &Settings) -> Result<Self> {
        Self::render(Sequence::new(settings.clone()), Truth::Whole)
    }

    /// Renders a sequence.
    ///
    /// # Errors
    /// Where the settings ask for H.264 and it is not to be had.
    pub fn render(sequence: Sequence, wanted: Truth) -> Result<Self> {
        let frames = sequence.frames()?.collect();
        let footage = Self::of(sequence, frames, Vec::new());
        let (sequence, captures) = (&footage.sequence, &footage.captures);
        let mut truth: BTreeMap<usize, FrameTruth> = BTreeMap::new();
        for run in footage.runs() {
            for (place, index) in run.iter().enumerate() {
                let shown = |place: Option<usize>| Some(captures[*run.get(place?)?]);
                let neighbours = [shown(place.checked_sub(1)), shown(Some(place + 1))];
                truth
                    .insert(captures[*index], FrameTruth::of(sequence, captures[*index], neighbours, wanted));
            }
        }
        let truth = captures.iter().map(|capture| truth[capture].clone()).collect();
        Ok(Self::of(footage.sequence, footage.frames, truth))
    }

    /// Puts together frames and their truth, which are there already.
    pub(crate) fn of(sequence: Sequence, frames: Vec<Frame>, truth: Vec<FrameTruth>) -> Self {
        let deliveries = sequence.deliveries();
        let (captures, stamps) = deliveries.iter().map(|delivery| (delivery.capture, delivery.stamp)).unzip();
        let mut footage = Self { sequence, frames, stamps, captures, truth };
        let blended = footage.truth.iter_mut().zip(deliveries).filter(|(_, delivery)| delivery.blend > 0.0);
        blended.for_each(|(truth, _)| truth.samples.clear());
        footage
    }

    /// The truth of frame `index`, computed from the geometry on demand.
    pub fn capture(&self, index: usize) -> Capture<'_> {
        self.sequence.capture(self.captures[index])
    }

    /// What determines the footage.
    pub fn settings(&self) -> &Settings {
        &self.sequence.settings
    }

    /// The true shutter.
    pub fn readout(&self) -> Readout {
        let settings = self.settings();
        let time = ReadoutTime::Seconds(settings.delivered_readout_time());
        let direction = direction(settings.first);
        Readout::new(settings.width, settings.height, direction, time, 1.0 / settings.delivered_fps())
            .expect("a readout ratio of at least 0 and a frame rate")
    }

    /// The stretches of frames over which motion can be followed: frames of one take, in order and
    /// each picture once. Every frame that shows a picture of its own is in one of them.
    pub fn runs(&self) -> Vec<Vec<usize>> {
        let mut frames: Vec<usize> = (0..self.captures.len()).collect();
        frames.dedup_by_key(|index| self.captures[*index]);
        let take = |index: &usize| self.sequence.take_index(self.captures[*index]);
        frames.chunk_by(|a, b| take(a) == take(b)).map(<[usize]>::to_vec).collect()
    }

    /// The displacement of the footage as it arrives.
    pub fn uncorrected(&self) -> Stats {
        stats::uncorrected(self.truth.iter().flat_map(|truth| truth.samples.iter().copied()))
    }
}

/// What the library calls the edge that is exposed first.
pub fn direction(first: FirstEdge) -> ReadoutDirection {
    match first {
        FirstEdge::Top => ReadoutDirection::TopToBottom,
        FirstEdge::Bottom => ReadoutDirection::BottomToTop,
        FirstEdge::Left => ReadoutDirection::LeftToRight,
        FirstEdge::Right => ReadoutDirection::RightToLeft,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sequence::{Timeline, named};

    fn footage(settings: Settings) -> Footage {
        Footage::of_settings(&Settings { width: 96, height: 72, ..settings }).unwrap()
    }

    fn phone(timeline: Timeline, cut: Option<usize>) -> Footage {
        footage(Settings { frames: 6, timeline, cut, ..named("cut").unwrap() })
    }

    #[test]
    fn runs_hold_each_picture_once_and_stop_at_cuts() {
        let runs = |timeline, cut| phone(timeline, cut).runs();
        assert_eq!(runs(Timeline::Whole, None), [vec![0, 1, 2, 3, 4, 5]]);
        assert_eq!(runs(Timeline::Whole, Some(2)), [vec![0, 1], vec![2, 3, 4, 5]]);
        // The captures shown are 0 0 2 2 2 | 5, then 0 1 | 3 4 5.
        assert_eq!(runs(Timeline::Duplicates(vec![1, 3, 4]), Some(5)), [vec![0, 2], vec![5]]);
        assert_eq!(runs(Timeline::Drops(vec![2]), Some(3)), [vec![0, 1], vec![2, 3, 4]]);
    }

    #[test]
    fn duplicates_repeat_frame_and_truth() {
        let footage = phone(Timeline::Duplicates(vec![2]), None);
        assert_eq!(footage.captures, [0, 1, 1, 3, 4, 5]);
        assert_eq!((&footage.frames[2], &footage.truth[2]), (&footage.frames[1], &footage.truth[1]));
        assert_ne!(footage.frames[2], footage.frames[3]);
        assert_eq!(footage.capture(2).start, footage.stamps[1]);
    }

    #[test]
    fn a_repeated_frame_equals_its_source_at_the_instant_of_its_capture() {
        let repeated = footage(Settings { frames: 6, bitrate: None, ..named("duplicated_30_walk").unwrap() });
        assert_eq!(repeated.captures, [0, 1, 2, 3, 3, 4, 5]);
        assert_eq!((&repeated.frames[4], &repeated.truth[4]), (&repeated.frames[3], &repeated.truth[3]));
        assert_ne!(repeated.frames[4], repeated.frames[5]);
        // Stamped 4/30 s, captured at 3/25 s with the camera's own readout.
        assert_eq!((repeated.stamps[4], repeated.capture(4).start), (4.0 / 30.0, 3.0 / 25.0));
        assert!((repeated.readout().time() - 0.8 / 25.0).abs() < 1e-12);
    }

    #[test]
    fn blended_frames_are_to_be_left_as_they_are() {
        let settings = Settings { frames: 7, bitrate: None, ..named("blended_30_walk").unwrap() };
        let whole = footage(Settings { timeline: Timeline::Whole, ..settings.clone() });
        let blended = footage(settings);
        let judged: Vec<bool> = blended.truth.iter().map(|truth| !truth.samples.is_empty()).collect();
        assert_eq!(judged, [true, false, false, false, false, false, true, false]);
        assert_eq!(
            (&blended.frames[6], &blended.truth[6].samples),
            (&whole.frames[5], &whole.truth[5].samples)
        );
        // Frame 3 lies half-way between captures 2 and 3.
        let halves = whole.frames[2].rgb.iter().zip(&whole.frames[3].rgb);
        let is_mean = |(half, (a, b)): (&u8, (&u8, &u8))| {
            (2 * i16::from(*half) - i16::from(*a) - i16::from(*b)).abs() <= 1
        };
        assert!(blended.frames[3].rgb.iter().zip(halves).all(is_mean));
    }

    #[test]
    fn a_crop_leaves_its_share_of_the_readout() {
        let settings = named("eis_sim_walk").unwrap();
        let readout = footage(Settings { frames: 2, bitrate: None, ..settings }).readout();
        assert!((readout.time() - 0.8 / 30.0 / 1.22).abs() < 1e-12);
    }

    #[test]
    fn coded_footage_differs_from_its_source() {
        let source = phone(Timeline::Whole, None);
        let coded = footage(Settings { bitrate: Some(300), ..source.settings().clone() });
        assert_eq!(coded.frames.len(), 6);
        assert_ne!(coded.frames, source.frames);
        assert_eq!(coded.truth, source.truth);
    }
}
