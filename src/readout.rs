//! The shutter: when each point of a frame was exposed. The only place that knows it.
//!
//! A point is exposed at t = t_k + T·s, with t_k the frame's timestamp, T the readout time and
//! s the *elapsed share* of the readout at that point.

use thiserror::Error;

/// Which edge of the frame, as it arrives, is read first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ReadoutDirection {
    /// Row 0 first: what most cameras do when held upright.
    #[default]
    TopToBottom,
    /// The last row first: a camera upside down.
    BottomToTop,
    /// Column 0 first: a portrait clip.
    LeftToRight,
    /// The last column first: a portrait clip, turned the other way.
    RightToLeft,
}

impl ReadoutDirection {
    /// Whether rows (true) or columns (false) are read one after another.
    #[must_use]
    pub const fn is_by_rows(self) -> bool {
        matches!(self, Self::TopToBottom | Self::BottomToTop)
    }

    /// Whether the readout runs against growing coordinates.
    #[must_use]
    pub const fn is_reversed(self) -> bool {
        matches!(self, Self::BottomToTop | Self::RightToLeft)
    }
}

/// What is known of a camera's readout time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum ReadoutTime {
    /// To be found from the picture; where that is not possible, as the whole period.
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
    /// Whether the readout time need not be found from the picture; what cannot be is not known.
    pub(crate) fn is_known(&self) -> bool {
        *self != Self::Unknown && self.check().is_ok()
    }

    /// Refuses a time or a delay that is negative, infinite or not a number.
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

/// What a camera's readout is expected to be, as where its model is known: the evidence of the picture overrules it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadoutPrior {
    /// Finite and not negative, in seconds.
    time: f64,
    /// Finite and positive, in seconds.
    deviation: f64,
    direction: Option<ReadoutDirection>,
}

impl ReadoutPrior {
    /// A readout time of `time` ± `deviation` seconds (mean and standard deviation), read from an edge of the frame, as it
    /// arrives, or from any where none is expected.
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

    /// The edge that is expected to be read first; `None`: any.
    #[must_use]
    pub const fn direction(&self) -> Option<ReadoutDirection> {
        self.direction
    }
}

/// One way in which a sensor may be read, and how likely it is by what was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ReadoutHypothesis {
    /// The likeliest readout of this way.
    pub readout: Readout,
    /// Standard deviation of its time in seconds.
    pub deviation: f64,
    /// How likely it is; all hypotheses together 1.
    pub probability: f64,
}

/// What is believed of a readout that is sought: a mixture of normal densities of the signed readout time (negative where the
/// bottom row or the right column is read first), some for sensors that are read by rows, some for those read by columns.
///
/// Divided by the prior, which several streams of one camera have in common, it is what this stream says of the camera.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ReadoutPosterior {
    /// The mixture, the likeliest first.
    pub hypotheses: Vec<ReadoutHypothesis>,
    /// Standard deviation in seconds of the signed readout time about 0 before anything was seen.
    pub prior_deviation: f64,
    /// How likely it was before that the sensor is read by rows.
    pub prior_by_rows: f64,
}

/// Why there can be no such readout.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum ReadoutError {
    /// A readout time that is negative, infinite or not a number.
    #[error("readout time of {0} s: must be finite and not negative")]
    Time(f64),
    /// A standard deviation that is not positive, infinite or not a number.
    #[error("deviation of {0} s: must be finite and positive")]
    Deviation(f64),
    /// An inter-frame delay that is negative, infinite or not a number.
    #[error("inter-frame delay of {0} rows: must be finite and not negative")]
    Delay(f64),
    /// A frame period that is not positive, infinite or not a number.
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
    /// The shutter of frames of `width` × `height` pixels, `period` seconds apart.
    ///
    /// With N rows and a delay of B, T = period · N / (N + B). Unknown, T is the whole period.
    ///
    /// # Errors
    /// If the time, the delay or the period cannot be; see [`ReadoutError`].
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

    /// The same of a time that was checked and a period that is finite and positive.
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
    /// Runs from 0.5/N in the first row read to 1 − 0.5/N in the last, and goes on linearly
    /// outside the frame.
    #[must_use]
    pub fn share(&self, x: f64, y: f64) -> f64 {
        let (along, rows) = if self.direction.is_by_rows() { (y, self.height) } else { (x, self.width) };
        let share = (along + 0.5) / rows.max(1) as f64;
        if self.direction.is_reversed() { 1.0 - share } else { share }
    }

    /// Exposure time in seconds of a point (pixels) after its frame's timestamp: T·s.
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
    fn what_cannot_be_is_refused() {
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
    fn an_expectation_that_cannot_be_is_refused() {
        let prior = |time, deviation| ReadoutPrior::new(time, deviation, None);
        assert!(prior(0.02, 0.001).is_ok() && prior(0.0, 0.001).is_ok());
        for wrong in [-0.02, f64::NAN, f64::INFINITY] {
            assert!(matches!(prior(wrong, 0.001), Err(ReadoutError::Time(_))), "{wrong}");
            assert!(matches!(prior(0.02, wrong), Err(ReadoutError::Deviation(_))), "{wrong}");
        }
        assert_eq!(prior(0.02, 0.0), Err(ReadoutError::Deviation(0.0)));
    }
}
