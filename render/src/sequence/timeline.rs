// SPDX-License-Identifier: MIT OR Apache-2.0

//! Which capture each delivered frame shows, and when it claims to have been taken.

use serde::Serialize;

/// How the captures of a camera become the frames of a clip.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum Timeline {
    /// Every capture is a frame.
    Whole,
    /// These captures are lost; the timestamps of the others keep the gap.
    Drops(Vec<usize>),
    /// In place of each of these captures the frame before it is shown again, with the timestamp of
    /// the capture that is missing.
    Duplicates(Vec<usize>),
    /// Converted to so many frames a second by showing the nearest capture, as a frame-rate converter
    /// does. The timestamps are regular again: they no longer tell when a frame was captured.
    Resampled(f64),
    /// Converted to so many frames a second by blending the two captures around each instant.
    Blended(f64),
}

/// A frame as it is delivered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Delivery {
    /// The capture that it shows.
    pub capture: usize,
    /// Its timestamp in seconds: the start of its readout, unless the clip was resampled.
    pub stamp: f64,
    /// The share of the capture after it that is blended in.
    pub blend: f64,
}

impl Timeline {
    /// The frames made of `captures` captures, `fps` of which are taken a second.
    pub fn deliveries(&self, captures: usize, fps: f64) -> Vec<Delivery> {
        let own = |capture: usize| Delivery { capture, stamp: capture as f64 / fps, blend: 0.0 };
        match self {
            Self::Whole => (0..captures).map(own).collect(),
            Self::Drops(lost) => (0..captures).filter(|k| !lost.contains(k)).map(own).collect(),
            Self::Duplicates(lost) => {
                let shown = |k: usize| (0..=k).rev().find(|earlier| !lost.contains(earlier)).unwrap_or(k);
                (0..captures).map(|k| Delivery { capture: shown(k), ..own(k) }).collect()
            }
            Self::Resampled(rate) => {
                let stamps = (0..).map(|frame| f64::from(frame) / rate);
                let nearest =
                    |stamp: f64| Delivery { capture: (stamp * fps).round() as usize, stamp, blend: 0.0 };
                stamps.map(nearest).take_while(|delivery| delivery.capture < captures).collect()
            }
            Self::Blended(rate) => {
                let blended = |frame| {
                    let stamp = f64::from(frame) / rate;
                    // To a millionth, so that an instant of a capture is that capture alone.
                    let place = (stamp * fps * 1e6).round() / 1e6;
                    Delivery { capture: place as usize, stamp, blend: place.fract() }
                };
                let last = |delivery: &Delivery| delivery.capture + usize::from(delivery.blend > 0.0);
                (0..).map(blended).take_while(|delivery| last(delivery) < captures).collect()
            }
        }
    }

    /// Captures that make at least so many frames, `fps` of which are taken a second.
    pub fn captures(&self, frames: usize, fps: f64) -> usize {
        let count = (0..).find(|captures| self.deliveries(*captures, fps).len() >= frames);
        count.unwrap_or(frames)
    }

    /// Whether some frames show what the one before them shows.
    pub fn repeats_frames(&self) -> bool {
        matches!(self, Self::Duplicates(_) | Self::Resampled(_))
    }

    /// Frames a second of the clip, where `fps` are captured.
    pub fn fps(&self, fps: f64) -> f64 {
        match self {
            Self::Resampled(rate) | Self::Blended(rate) => *rate,
            _ => fps,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn captures(timeline: &Timeline, count: usize) -> Vec<usize> {
        timeline.deliveries(count, 30.0).iter().map(|delivery| delivery.capture).collect()
    }

    fn stamps(timeline: &Timeline, count: usize, unit: f64) -> Vec<f64> {
        let stamps = timeline.deliveries(count, 30.0);
        stamps.iter().map(|delivery| (delivery.stamp * unit * 1e9).round() / 1e9).collect()
    }

    #[test]
    fn a_drop_leaves_a_gap_in_time() {
        let timeline = Timeline::Drops(vec![1, 3]);
        assert_eq!(captures(&timeline, 6), [0, 2, 4, 5]);
        assert_eq!(stamps(&timeline, 6, 30.0), [0.0, 2.0, 4.0, 5.0]);
        assert_eq!(timeline.captures(4, 30.0), 6);
    }

    #[test]
    fn a_duplicate_has_its_own_timestamp() {
        let timeline = Timeline::Duplicates(vec![2, 3]);
        assert_eq!(captures(&timeline, 5), [0, 1, 1, 1, 4]);
        assert_eq!(stamps(&timeline, 5, 30.0), [0.0, 1.0, 2.0, 3.0, 4.0]);
    }

    #[test]
    fn every_sixth_capture_is_lost_at_25_frames_a_second() {
        // Frame j shows the capture nearest to 1.2 j.
        let timeline = Timeline::Resampled(25.0);
        assert_eq!(captures(&timeline, 12), [0, 1, 2, 4, 5, 6, 7, 8, 10, 11]);
        assert_eq!(stamps(&timeline, 4, 25.0), [0.0, 1.0, 2.0]);
        assert_eq!(timeline.fps(30.0), 25.0);
        assert_eq!(timeline.captures(10, 30.0), 12);
    }

    #[test]
    fn every_fifth_capture_is_shown_twice_from_25_to_30() {
        let repeated = Timeline::Resampled(30.0).deliveries(8, 25.0);
        let captures: Vec<usize> = repeated.iter().map(|delivery| delivery.capture).collect();
        assert_eq!(captures, [0, 1, 2, 3, 3, 4, 5, 6, 7]);
    }

    #[test]
    fn one_of_five_captures_is_lost_at_24_frames_a_second() {
        let timeline = Timeline::Resampled(24.0);
        assert_eq!(captures(&timeline, 11), [0, 1, 3, 4, 5, 6, 8, 9, 10]);
        assert_eq!(stamps(&timeline, 4, 24.0), [0.0, 1.0, 2.0]);
    }

    #[test]
    fn one_frame_of_six_is_a_capture_alone_where_25_are_blended_to_30() {
        let blended = Timeline::Blended(30.0).deliveries(8, 25.0);
        let shown: Vec<(usize, f64)> =
            blended.iter().map(|delivery| (delivery.capture, (delivery.blend * 6.0).round())).collect();
        let expected =
            [(0, 0.0), (0, 5.0), (1, 4.0), (2, 3.0), (3, 2.0), (4, 1.0), (5, 0.0), (5, 5.0), (6, 4.0)];
        assert_eq!(shown, expected);
    }

    #[test]
    fn captures_are_shown_twice_at_60_frames_a_second() {
        // Frame j shows the capture nearest to j / 2, the later one in between.
        let timeline = Timeline::Resampled(60.0);
        assert_eq!(captures(&timeline, 4), [0, 1, 1, 2, 2, 3, 3]);
        assert_eq!(stamps(&timeline, 3, 60.0), [0.0, 1.0, 2.0, 3.0, 4.0]);
    }
}
