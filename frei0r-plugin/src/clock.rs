// SPDX-License-Identifier: MIT OR Apache-2.0

//! The host's time → the clip's.
//!
//! By the interface hosts give seconds, and MLT and GStreamer do. ffmpeg gives milliseconds; and where its frames have padded rows, as
//! with widths that are no multiple of 64, it loses their times and gives a huge negative number.

/// What a host counts time in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unit {
    Seconds,
    Milliseconds,
    /// The host has no times.
    Frames,
}

/// How a host counts time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClockSettings {
    /// `None`: found from the steps between frames.
    pub(crate) unit: Option<Unit>,
    /// Seconds of the clip at which the host's time 0 is.
    pub(crate) start: f64,
    /// Seconds of the clip in one of the host's.
    pub(crate) speed: f64,
}

/// Steps between frames, in intervals between frames of the file, that are those of a clock in seconds; a clock in milliseconds
/// has a thousand times as many. A speed of 16 and one of 1/16 lie between.
const STEPS: std::ops::Range<f64> = 1.0 / 30.0..30.0;
/// A time before this, in any unit, is none: ffmpeg's for frames that have no time is -2⁶³ ticks.
const NO_TIME: f64 = -1e12;

/// The host's clock, as far as it is known.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Clock {
    last: Option<f64>,
    /// What the steps show.
    found: Option<Unit>,
    frames: usize,
}

/// Which frame of the file is meant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Position {
    /// The one that is shown at this time, in nanoseconds of the clip.
    Time(i64),
    /// The one with this number.
    Frame(usize),
    /// The host gives no time.
    None,
}

impl Clock {
    /// The position of the next frame of a host, by its time; `interval` is the file's between frames, in seconds.
    pub(crate) fn next(&mut self, time: f64, settings: &ClockSettings, interval: f64) -> Position {
        let frame = self.frames;
        self.frames += 1;
        if settings.unit == Some(Unit::Frames) {
            return Position::Frame(frame);
        }
        let has_time = time.is_finite() && time > NO_TIME;
        if !has_time {
            return Position::None;
        }
        if let Some(last) = self.last.replace(time) {
            let steps = (time - last).abs() * settings.speed / interval;
            if STEPS.contains(&steps) {
                self.found = Some(Unit::Seconds);
            } else if STEPS.contains(&(steps * 1e-3)) && self.found.is_none() {
                self.found = Some(Unit::Milliseconds);
            }
        }
        let unit = match settings.unit.or(self.found) {
            Some(Unit::Milliseconds) => 1e-3,
            _ => 1.0,
        };
        let seconds = settings.start + time * unit * settings.speed;
        // What is beyond all times saturates, and is in no file.
        Position::Time((seconds * 1e9).round() as i64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AUTO: ClockSettings = ClockSettings { unit: None, start: 0.0, speed: 1.0 };
    const INTERVAL: f64 = 0.04;

    fn positions(settings: ClockSettings, times: &[f64]) -> Vec<Position> {
        let mut clock = Clock::default();
        times.iter().map(|time| clock.next(*time, &settings, INTERVAL)).collect()
    }

    fn at(seconds: &[f64]) -> Vec<Position> {
        seconds.iter().map(|seconds| Position::Time((seconds * 1e9).round() as i64)).collect()
    }

    #[test]
    fn the_unit_is_found_from_the_steps() {
        assert_eq!(positions(AUTO, &[0.0, 0.04, 0.08]), at(&[0.0, 0.04, 0.08]));
        assert_eq!(positions(AUTO, &[0.0, 40.0, 80.0]), at(&[0.0, 0.04, 0.08]));
        // Gone to elsewhere in an editor.
        assert_eq!(positions(AUTO, &[0.0, 0.04, 40.04, 40.08]), at(&[0.0, 0.04, 40.04, 40.08]));
        // A step of 40 s, and then of a frame.
        assert_eq!(positions(AUTO, &[0.0, 40.0, 40.04]), at(&[0.0, 0.04, 40.04]));
        let stated = ClockSettings { unit: Some(Unit::Milliseconds), ..AUTO };
        assert_eq!(positions(stated, &[0.08, 1000.0]), at(&[0.000_08, 1.0]));
    }

    #[test]
    fn trimmed_and_faster_clips_have_their_times() {
        let settings = ClockSettings { start: 3.0, speed: 2.0, ..AUTO };
        assert_eq!(positions(settings, &[0.0, 0.04]), at(&[3.0, 3.08]));
    }

    #[test]
    fn a_host_without_times_is_told_or_its_frames_counted() {
        let none = [-7.68e17, f64::NAN, f64::INFINITY];
        assert_eq!(positions(AUTO, &none), [Position::None; 3]);
        let counted = ClockSettings { unit: Some(Unit::Frames), ..AUTO };
        assert_eq!(positions(counted, &none), [0, 1, 2].map(Position::Frame));
    }
}
