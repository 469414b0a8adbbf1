// SPDX-License-Identifier: MIT OR Apache-2.0

//! What was done with a clip, in numbers: for people, and as JSON.

mod tally;

use crate::as_recorded::AsRecorded;
use crate::estimate::Estimate;
use crate::property_values::{Direction, name_of};
use crate::readout::{Doubt, Found};
use rsrectify::readout;
use serde::Serialize;
use std::fmt;
use std::time::Duration;
pub use tally::Tally;
use tally::{Entry, LastReadout};

/// Where the readout comes from.
#[derive(Clone, Debug)]
pub enum Source {
    Given,
    MotionFile,
    /// It was looked for beforehand, with this result, if any, and then while the frames came.
    Sought(Option<Box<Found>>),
}

/// How sure the readout is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Certainty {
    Given,
    MotionFile,
    Found,
    NotFound,
    /// By what was done to the frames after it.
    Hidden,
}

/// The readout with which the frames were rectified.
#[derive(Clone, Debug, Serialize)]
pub struct Readout {
    pub certainty: Certainty,
    /// Milliseconds, negative where the bottom row or the right column is read first; `None` where it is not known.
    pub signed_ms: Option<f64>,
    /// The interval of 95 %, where it was found.
    pub interval_ms: Option<[f64; 2]>,
    pub direction: Option<String>,
}

/// The corrections of the frames that were corrected, in pixels: of each frame the largest displacement in the picture.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Pixels {
    pub median: f64,
    pub largest: f64,
    /// The frame with the largest, counted from 0 over those that were written.
    pub largest_frame: usize,
}

/// Frames in a row that were left as they were recorded.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stretch {
    pub frames: usize,
    /// Seconds after the first frame that was written.
    pub start_s: f64,
    pub duration_s: f64,
    /// That of most of them.
    pub reason: String,
}

/// What was done with a clip.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    pub frames: usize,
    /// Since the clip was opened.
    pub seconds: f64,
    pub frames_per_second: f64,
    /// Seconds from one frame to the next, in the mean; 0 where it is not known.
    #[serde(skip)]
    pub period: f64,
    pub readout: Readout,
    /// Frames of which any sample was moved by the correction.
    pub corrected_frames: usize,
    pub correction_px: Option<Pixels>,
    /// Median over all frames; `None` where the motion was given.
    pub confidence: Option<f64>,
    /// By how much the picture was enlarged to hide its borders.
    pub zoom: f64,
    /// The longest one.
    pub as_recorded: Option<Stretch>,
}

impl Summary {
    /// Of so many frames, after so much time.
    pub fn new(tally: &Tally, source: &Source, frames: usize, time: Duration, zoom: f64) -> Self {
        let entries = tally.entries();
        let period = period(&entries);
        let corrected: Vec<f64> =
            entries.iter().map(|entry| entry.pixels).filter(|pixels| *pixels > 0.0).collect();
        // Of several the first.
        let pixels = entries.iter().map(|entry| entry.pixels).enumerate().rev();
        let (largest_frame, largest) = pixels.max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or_default();
        let seconds = time.as_secs_f64();
        Self {
            frames,
            seconds,
            frames_per_second: frames as f64 / seconds.max(1e-3),
            period,
            readout: Readout::new(source, tally.last_readout(), period),
            corrected_frames: corrected.len(),
            correction_px: median(corrected).map(|median| Pixels { median, largest, largest_frame }),
            confidence: median(entries.iter().filter_map(|entry| entry.confidence).collect()),
            zoom,
            as_recorded: longest_left(&entries, frames, period),
        }
    }
}

impl Readout {
    fn new(source: &Source, last: Option<LastReadout>, period: f64) -> Self {
        let direction =
            |readout: &rsrectify::readout::Readout| name_of(&Direction::from(readout.direction()));
        let of_last = |certainty, has_interval| {
            let estimate =
                last.map(|last| Estimate::of_readout(&last.readout, last.deviation * period * 1e3));
            Self {
                certainty,
                signed_ms: estimate.map(|estimate| estimate.value),
                interval_ms: estimate.filter(|_| has_interval).map(|estimate| estimate.interval()),
                direction: last.map(|last| direction(&last.readout)),
            }
        };
        let nothing = |certainty| Self { certainty, signed_ms: None, interval_ms: None, direction: None };
        match source {
            Source::Given => of_last(Certainty::Given, false),
            Source::MotionFile => of_last(Certainty::MotionFile, false),
            Source::Sought(Some(found)) if found.doubt().is_none() => Self {
                certainty: Certainty::Found,
                signed_ms: Some(found.estimate().value),
                interval_ms: Some(found.estimate().interval()),
                direction: Some(name_of(&Direction::from(found.direction))),
            },
            Source::Sought(found) => {
                let doubt = found.as_ref().and_then(|found| found.doubt());
                let is_hidden = matches!(doubt, Some(Doubt::Stabilised | Doubt::Blended))
                    || last.is_some_and(|last| last.timing.is_stabilised() || last.timing.is_blended());
                let is_sure = |last: LastReadout| {
                    last.deviation > 0.0 && last.deviation <= readout::Readout::MAX_KNOWN_DEVIATION
                };
                match (is_hidden, last.is_some_and(is_sure)) {
                    (true, _) => nothing(Certainty::Hidden),
                    (false, true) => of_last(Certainty::Found, true),
                    (false, false) => nothing(Certainty::NotFound),
                }
            }
        }
    }
}

/// Mean time from one frame to the next in seconds; 0 where it is not known.
fn period(entries: &[Entry]) -> f64 {
    let times: Vec<f64> = entries.iter().filter_map(|entry| entry.time).collect();
    let span = times.last().zip(times.first()).map_or(0.0, |(last, first)| last - first);
    span.abs() / times.len().saturating_sub(1).max(1) as f64
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// The longest stretch of frames that were left as they were recorded, of so many frames in all.
fn longest_left(entries: &[Entry], frames: usize, period: f64) -> Option<Stretch> {
    if entries.is_empty() {
        // Interlaced, or too large: a warning says it.
        let reason = "they were not analysed".to_owned();
        return (frames > 0).then_some(Stretch { frames, start_s: 0.0, duration_s: 0.0, reason });
    }
    let mut longest = 0..0;
    let mut begin = 0;
    for run in entries.chunk_by(|one, next| one.as_recorded.is_some() == next.as_recorded.is_some()) {
        let end = begin + run.len();
        if run.iter().all(|entry| entry.as_recorded.is_some()) && run.len() > longest.len() {
            longest = begin..end;
        }
        begin = end;
    }
    let run = entries.get(longest.clone()).filter(|run| !run.is_empty())?;
    let mut reasons: Vec<(AsRecorded, usize)> = Vec::new();
    for reason in run.iter().filter_map(|entry| entry.as_recorded) {
        match reasons.iter_mut().find(|(known, _)| *known == reason) {
            Some((_, count)) => *count += 1,
            None => reasons.push((reason, 1)),
        }
    }
    let (reason, _) = reasons.into_iter().max_by_key(|(_, count)| *count)?;
    let time = |index: usize| {
        let by_count = index as f64 * period;
        let first = entries.first().and_then(|entry| entry.time);
        entries
            .get(index)
            .and_then(|entry| entry.time)
            .zip(first)
            .map_or(by_count, |(time, first)| time - first)
    };
    let start_s = time(longest.start);
    // The last frame lasts as long as the others.
    let duration_s = time(longest.end - 1) + period - start_s;
    Some(Stretch { frames: run.len(), start_s, duration_s, reason: reason.to_string() })
}

impl fmt::Display for Readout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(ms) = self.signed_ms else {
            return f.write_str(match self.certainty {
                Certainty::Hidden => "hidden by what was done to the frames after it",
                _ => "not found",
            });
        };
        if ms.abs() * 1e-3 < readout::Readout::MIN_VISIBLE_TIME {
            write!(f, "{:.1} ms, as good as a global shutter", ms.abs())?;
        } else {
            write!(f, "{ms:.1} ms")?;
            if let Some([low, high]) = self.interval_ms {
                write!(f, ", 95 %: {low:.1} to {high:.1}")?;
            }
            if let Some(direction) = &self.direction {
                write!(f, ", {direction}")?;
            }
        }
        f.write_str(match self.certainty {
            Certainty::Given => ", as given",
            Certainty::MotionFile => ", as in the motion file",
            _ => "",
        })
    }
}

impl fmt::Display for Stretch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { frames, start_s, duration_s, reason } = self;
        let long = match frames {
            1 => "1 frame".to_owned(),
            _ if *duration_s < 1.0 => format!("{frames} frames"),
            _ => format!("{duration_s:.1} s"),
        };
        match *start_s > 0.0 {
            true => write!(f, "{long} from {start_s:.1} s on")?,
            false => write!(f, "the first {long}")?,
        }
        write!(f, ": {reason}")
    }
}

impl Summary {
    /// Everything but the number of frames and the time: name and text of each.
    pub fn rows(&self) -> Vec<(&'static str, String)> {
        let Self { frames, corrected_frames, .. } = self;
        let share = 100.0 * *corrected_frames as f64 / (*frames).max(1) as f64;
        // 100 % are all of them.
        let share = if corrected_frames < frames { share.min(99.0) } else { share };
        let mut corrected = format!("{share:.0} % of the frames");
        if let Some(Pixels { median, largest, .. }) = self.correction_px {
            corrected += &format!(", by {median:.1} px in the median, {largest:.1} px at most");
        }
        if let Some(confidence) = self.confidence {
            corrected += &format!("; confidence {confidence:.2}");
        }
        if self.zoom > 1.0 {
            corrected += &format!("; zoom {:.3}", self.zoom);
        }
        let recorded = self.as_recorded.as_ref().map(|stretch| match stretch.frames == *frames {
            true => format!("all of it: {}", stretch.reason),
            false => stretch.to_string(),
        });
        let rows = [("readout time", self.readout.to_string()), ("corrected", corrected)];
        rows.into_iter().chain(recorded.map(|recorded| ("as recorded", recorded))).collect()
    }
}

/// In lines below that of the file.
impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { frames, seconds, frames_per_second, .. } = self;
        write!(f, "{frames} frames in {seconds:.1} s, {frames_per_second:.1} frames/s")?;
        self.rows().iter().try_for_each(|(name, text)| write!(f, "\n  {name:12}  {text}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rsrectify::rectifier;

    fn entries(as_recorded: &[Option<AsRecorded>]) -> Vec<Entry> {
        let entry = |(index, as_recorded): (usize, &Option<AsRecorded>)| Entry {
            time: Some(5.0 + 0.1 * index as f64),
            pixels: if as_recorded.is_some() { 0.0 } else { 2.0 },
            confidence: Some(1.0),
            as_recorded: *as_recorded,
        };
        as_recorded.iter().enumerate().map(entry).collect()
    }

    #[test]
    fn the_longest_stretch_is_found_with_the_reason_of_most_frames() {
        let [still, unknown] = [rectifier::AsRecorded::NothingMoved, rectifier::AsRecorded::UnknownReadout]
            .map(|reason| Some(AsRecorded::Analysed(reason)));
        let entries = entries(&[still, still, None, unknown, still, unknown, unknown, None, still]);
        let stretch = longest_left(&entries, 9, 0.1).unwrap();
        assert_eq!((stretch.frames, stretch.reason.as_str()), (4, "the readout was not known"));
        assert!((stretch.start_s - 0.3).abs() < 1e-9 && (stretch.duration_s - 0.4).abs() < 1e-9);
        assert_eq!(stretch.to_string(), "4 frames from 0.3 s on: the readout was not known");
        let first = longest_left(&entries[..4], 4, 0.1).unwrap();
        assert_eq!(first.to_string(), "the first 2 frames: nothing moved");
        assert_eq!(longest_left(&entries[2..3], 1, 0.1), None);
        let long = Stretch { frames: 261, start_s: 0.0, duration_s: 8.7, reason: "nothing moved".to_owned() };
        assert_eq!(long.to_string(), "the first 8.7 s: nothing moved");
    }
}
