// SPDX-License-Identifier: MIT OR Apache-2.0

//! The shutter: when each point of a frame was exposed. No other module computes exposure times.
//!
//! A point is exposed at t = t_k + T·s, with t_k the frame's timestamp, T the readout time and
//! s the *elapsed share* of the readout at that point.

use thiserror::Error;

/// Which edge of the frame, as it arrives, is read first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ReadoutDirection {
    /// Row 0 first: most cameras held upright.
    #[default]
    TopToBottom,
    /// The last row first: a camera held upside down.
    BottomToTop,
    /// Column 0 first: a portrait clip.
    LeftToRight,
    /// The last column first: a portrait clip, turned the other way.
    RightToLeft,
}

impl ReadoutDirection {
    /// Whether the sensor is read row by row (true) or column by column (false).
    #[must_use]
    pub const fn is_by_rows(self) -> bool {
        matches!(self, Self::TopToBottom | Self::BottomToTop)
    }

    /// The direction in the frame turned clockwise by a quarter: the first row becomes the last column.
    #[must_use]
    pub const fn turned(self) -> Self {
        match self {
            Self::TopToBottom => Self::RightToLeft,
            Self::RightToLeft => Self::BottomToTop,
            Self::BottomToTop => Self::LeftToRight,
            Self::LeftToRight => Self::TopToBottom,
        }
    }

    /// Whether the readout runs from the last row or column to the first.
    #[must_use]
    pub const fn is_reversed(self) -> bool {
        matches!(self, Self::BottomToTop | Self::RightToLeft)
    }
}

/// A camera's readout time, if known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum ReadoutTime {
    /// Estimated from the picture; if that is not possible, the whole frame period.
    #[default]
    Unknown,
    /// The readout takes the whole frame period: the paper's assumption, inter-frame delay 0.
    WholePeriod,
    /// The paper's inter-frame delay B in rows (columns where read sideways); not negative.
    DelayRows(f64),
    /// The readout time T in seconds; survives any change of frame rate.
    Seconds(f64),
}

impl ReadoutTime {
    /// Whether the readout time is given; an invalid value counts as unknown.
    pub(crate) fn is_known(&self) -> bool {
        *self != Self::Unknown && self.check().is_ok()
    }

    /// Returns an error if the time or the delay is negative, infinite or NaN.
    ///
    /// # Errors
    /// [`ReadoutError::Time`] and [`ReadoutError::Delay`].
    pub fn check(&self) -> Result<(), ReadoutError> {
        let is_valid = |value: f64| value.is_finite() && value >= 0.0;
        match *self {
            Self::Seconds(time) if !is_valid(time) => Err(ReadoutError::Time(time)),
            Self::DelayRows(delay) if !is_valid(delay) => Err(ReadoutError::Delay(delay)),
            _ => Ok(()),
        }
    }
}

/// Prior of a camera's readout, for example from its model; combined with the likelihood of the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadoutPrior {
    /// Finite and not negative, in seconds.
    time: f64,
    /// Finite and positive, in seconds.
    deviation: f64,
    direction: Option<ReadoutDirection>,
}

impl ReadoutPrior {
    /// A readout time of `time` ± `deviation` seconds (mean and standard deviation), and the edge of the
    /// frame, as it arrives, that is read first; `None` for any edge.
    ///
    /// # Errors
    /// [`ReadoutError::Time`] and [`ReadoutError::Deviation`].
    pub fn new(time: f64, deviation: f64, direction: Option<ReadoutDirection>) -> Result<Self, ReadoutError> {
        ReadoutTime::Seconds(time).check()?;
        if !(deviation.is_finite() && deviation > 0.0) {
            return Err(ReadoutError::Deviation(deviation));
        }
        Ok(Self { time, deviation, direction })
    }

    /// Mean in seconds, finite and not negative.
    #[must_use]
    pub const fn time(&self) -> f64 {
        self.time
    }

    /// Standard deviation in seconds, finite and positive.
    #[must_use]
    pub const fn deviation(&self) -> f64 {
        self.deviation
    }

    /// The edge expected to be read first; `None`: any.
    #[must_use]
    pub const fn direction(&self) -> Option<ReadoutDirection> {
        self.direction
    }
}

/// A readout hypothesis with its posterior probability.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ReadoutHypothesis {
    /// The most probable readout under this hypothesis.
    pub readout: Readout,
    /// Standard deviation of its time in seconds.
    pub deviation: f64,
    /// Posterior probability; sums to 1 over all hypotheses.
    pub probability: f64,
}

/// Posterior of an unknown readout: a mixture of normal densities of the signed readout time (negative if the
/// bottom row or the right column is read first), with components for sensors read by rows and for sensors
/// read by columns.
///
/// Divided by the prior, which is common to all streams of one camera, it is the likelihood of this stream.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ReadoutPosterior {
    /// The components of the mixture, the most probable first.
    pub hypotheses: Vec<ReadoutHypothesis>,
    /// Prior standard deviation of the signed readout time about 0, in seconds.
    pub prior_deviation: f64,
    /// Prior probability that the sensor is read by rows.
    pub prior_by_rows: f64,
}

/// Why a readout is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum ReadoutError {
    /// A readout time that is negative, infinite or NaN.
    #[error("readout time of {0} s: must be finite and not negative")]
    Time(f64),
    /// A standard deviation that is not positive, infinite or NaN.
    #[error("deviation of {0} s: must be finite and positive")]
    Deviation(f64),
    /// An inter-frame delay that is negative, infinite or NaN.
    #[error("inter-frame delay of {0} rows: must be finite and not negative")]
    Delay(f64),
    /// A frame period that is not positive, infinite or NaN.
    #[error("frame period of {0} s: must be finite and positive")]
    Period(f64),
}

/// The shutter of one stream: frame size, direction and readout time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Readout {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) direction: ReadoutDirection,
    /// Finite and not negative.
    pub(crate) time: f64,
}

impl Readout {
    /// Seconds of readout below which the rows are as good as exposed at once: it bends nothing that could be seen.
    pub const MIN_VISIBLE_TIME: f64 = 1e-3;
    /// Standard deviation of an estimated readout time, in frame periods, up to which it can be relied on.
    pub const MAX_KNOWN_DEVIATION: f64 = 0.1;

    /// The shutter of frames of `width` × `height` pixels, `period` seconds apart.
    ///
    /// With N rows and a delay of B, T = period · N / (N + B). If unknown, T is the whole period.
    ///
    /// # Errors
    /// If the time, the delay or the period is invalid; see [`ReadoutError`].
    pub fn new(
        width: usize,
        height: usize,
        direction: ReadoutDirection,
        time: ReadoutTime,
        period: f64,
    ) -> Result<Self, ReadoutError> {
        time.check()?;
        if !(period.is_finite() && period > 0.0) {
            return Err(ReadoutError::Period(period));
        }
        Ok(Self::resolved(width, height, direction, time, period))
    }

    /// A global shutter: frames of `width` × `height` pixels, each exposed at one instant.
    #[must_use]
    pub const fn global_shutter(width: usize, height: usize) -> Self {
        Self { width, height, direction: ReadoutDirection::TopToBottom, time: 0.0 }
    }

    /// As [`new`](Self::new), for a valid time and a finite, positive period.
    pub(crate) fn resolved(
        width: usize,
        height: usize,
        direction: ReadoutDirection,
        time: ReadoutTime,
        period: f64,
    ) -> Self {
        let rows = if direction.is_by_rows() { height } else { width }.max(1) as f64;
        let time = match time {
            ReadoutTime::Seconds(seconds) => seconds,
            ReadoutTime::DelayRows(delay) => period * rows / (rows + delay),
            ReadoutTime::Unknown | ReadoutTime::WholePeriod => period,
        };
        Self { width, height, direction, time }
    }

    /// Frame width in pixels.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Frame height in pixels.
    #[must_use]
    pub const fn height(&self) -> usize {
        self.height
    }

    /// Which edge is read first.
    #[must_use]
    pub const fn direction(&self) -> ReadoutDirection {
        self.direction
    }

    /// Readout time T in seconds, finite and not negative; 0 for a global shutter.
    #[must_use]
    pub const fn time(&self) -> f64 {
        self.time
    }

    /// Elapsed share s of the readout at a point given in pixels (pixel centres at integers).
    ///
    /// Runs from 0.5/N in the first row read to 1 − 0.5/N in the last; linear outside the frame, too.
    #[must_use]
    pub fn share(&self, x: f64, y: f64) -> f64 {
        let (along, rows) = if self.direction.is_by_rows() { (y, self.height) } else { (x, self.width) };
        let share = (along + 0.5) / rows.max(1) as f64;
        if self.direction.is_reversed() { 1.0 - share } else { share }
    }

    /// Exposure time of a point (pixels) in seconds after its frame's timestamp: T·s.
    #[must_use]
    pub fn offset(&self, x: f64, y: f64) -> f64 {
        self.time * self.share(x, y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn share_runs_from_the_edge_that_is_read_first() {
        let share = |direction, x, y| {
            Readout::new(8, 4, direction, ReadoutTime::WholePeriod, 1.0).unwrap().share(x, y)
        };
        assert_eq!(share(ReadoutDirection::TopToBottom, 3.0, 0.0), 0.125);
        assert_eq!(share(ReadoutDirection::BottomToTop, 3.0, 0.0), 0.875);
        assert_eq!(share(ReadoutDirection::LeftToRight, 0.0, 2.0), 0.0625);
        assert_eq!(share(ReadoutDirection::RightToLeft, 0.0, 2.0), 0.9375);
    }

    #[test]
    fn delay_counts_in_rows_of_the_read_edge() {
        let time =
            |direction| Readout::new(640, 480, direction, ReadoutTime::DelayRows(40.0), 0.04).unwrap().time;
        assert!((time(ReadoutDirection::TopToBottom) - 0.04 * 480.0 / 520.0).abs() < 1e-15);
        assert!((time(ReadoutDirection::LeftToRight) - 0.04 * 640.0 / 680.0).abs() < 1e-15);
    }

    #[test]
    fn invalid_values_are_refused() {
        let new = |time, period| Readout::new(4, 4, ReadoutDirection::TopToBottom, time, period);
        for value in [f64::NAN, -1.0, -1e-300, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(matches!(new(ReadoutTime::Seconds(value), 0.04), Err(ReadoutError::Time(_))));
            assert!(matches!(new(ReadoutTime::DelayRows(value), 0.04), Err(ReadoutError::Delay(_))));
            assert!(matches!(new(ReadoutTime::Unknown, value), Err(ReadoutError::Period(_))));
        }
        assert_eq!(new(ReadoutTime::WholePeriod, 0.0), Err(ReadoutError::Period(0.0)));
        assert_eq!(new(ReadoutTime::Seconds(0.0), 0.04).map(|readout| readout.time()), Ok(0.0));
        assert_eq!(new(ReadoutTime::Unknown, 0.04).map(|readout| readout.time()), Ok(0.04));
    }

    #[test]
    fn an_invalid_prior_is_refused() {
        let prior = |time, deviation| ReadoutPrior::new(time, deviation, None);
        assert!(prior(0.02, 0.001).is_ok() && prior(0.0, 0.001).is_ok());
        for wrong in [-0.02, f64::NAN, f64::INFINITY] {
            assert!(matches!(prior(wrong, 0.001), Err(ReadoutError::Time(_))), "{wrong}");
            assert!(matches!(prior(0.02, wrong), Err(ReadoutError::Deviation(_))), "{wrong}");
        }
        assert_eq!(prior(0.02, 0.0), Err(ReadoutError::Deviation(0.0)));
    }
}
