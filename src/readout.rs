//! The shutter: when each point of a frame was exposed. The only place that knows it.
//!
//! A point is exposed at t = t_k + T·s, with t_k the frame's timestamp, T the readout time and
//! s the *elapsed share* of the readout at that point.

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
    pub const fn is_by_rows(self) -> bool {
        matches!(self, Self::TopToBottom | Self::BottomToTop)
    }

    /// Whether the readout runs against growing coordinates.
    pub const fn is_reversed(self) -> bool {
        matches!(self, Self::BottomToTop | Self::RightToLeft)
    }
}

/// What is known of a camera's readout time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ReadoutTime {
    /// To be found from the picture; where that is not possible, as the whole period.
    Unknown,
    /// The readout takes the whole frame period: the paper's assumption, inter-frame delay 0.
    WholePeriod,
    /// The paper's inter-frame delay B in rows (columns where read sideways); not negative.
    DelayRows(f64),
    /// The readout time T in seconds; survives any change of frame rate.
    Seconds(f64),
}

impl ReadoutTime {
    /// Whether it says something that can be: a time or delay is finite and not negative.
    pub fn is_valid(&self) -> bool {
        match self {
            Self::Unknown | Self::WholePeriod => true,
            Self::DelayRows(value) | Self::Seconds(value) => value.is_finite() && *value >= 0.0,
        }
    }

    /// Whether the readout time need not be found out; what cannot be is not known.
    pub fn is_known(&self) -> bool {
        *self != Self::Unknown && self.is_valid()
    }
}

/// The shutter of one stream: frame size, direction and readout time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Readout {
    /// Frame width in pixels.
    pub width: usize,
    /// Frame height in pixels.
    pub height: usize,
    /// Which edge is read first.
    pub direction: ReadoutDirection,
    /// Readout time T in seconds.
    pub time: f64,
}

impl Readout {
    /// Resolves what is known of the readout time for a stream with `period` seconds a frame.
    ///
    /// With N rows and a delay of B, T = period · N / (N + B). A time or delay that is not finite
    /// or negative counts as unknown, that is, as the whole period.
    pub fn new(
        width: usize,
        height: usize,
        direction: ReadoutDirection,
        time: ReadoutTime,
        period: f64,
    ) -> Self {
        let rows = if direction.is_by_rows() { height } else { width }.max(1) as f64;
        let time = match time {
            ReadoutTime::Seconds(seconds) if time.is_known() => seconds,
            ReadoutTime::DelayRows(delay) if time.is_known() => period * rows / (rows + delay),
            _ => period,
        };
        Self { width, height, direction, time }
    }

    /// Elapsed share s of the readout at a point given in pixels (pixel centres at integers).
    ///
    /// Runs from 0.5/N in the first row read to 1 − 0.5/N in the last, and goes on linearly
    /// outside the frame.
    pub fn share(&self, x: f64, y: f64) -> f64 {
        let (along, rows) = if self.direction.is_by_rows() { (y, self.height) } else { (x, self.width) };
        let share = (along + 0.5) / rows.max(1) as f64;
        if self.direction.is_reversed() { 1.0 - share } else { share }
    }

    /// Exposure time in seconds of a point (pixels) after its frame's timestamp: T·s.
    pub fn offset(&self, x: f64, y: f64) -> f64 {
        self.time * self.share(x, y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn share_runs_from_the_edge_that_is_read_first() {
        let share =
            |direction, x, y| Readout::new(8, 4, direction, ReadoutTime::WholePeriod, 1.0).share(x, y);
        assert_eq!(share(ReadoutDirection::TopToBottom, 3.0, 0.0), 0.125);
        assert_eq!(share(ReadoutDirection::BottomToTop, 3.0, 0.0), 0.875);
        assert_eq!(share(ReadoutDirection::LeftToRight, 0.0, 2.0), 0.0625);
        assert_eq!(share(ReadoutDirection::RightToLeft, 0.0, 2.0), 0.9375);
    }

    #[test]
    fn delay_counts_in_rows_of_the_read_edge() {
        let time = |direction| Readout::new(640, 480, direction, ReadoutTime::DelayRows(40.0), 0.04).time;
        assert!((time(ReadoutDirection::TopToBottom) - 0.04 * 480.0 / 520.0).abs() < 1e-15);
        assert!((time(ReadoutDirection::LeftToRight) - 0.04 * 640.0 / 680.0).abs() < 1e-15);
    }

    #[test]
    fn nonsense_counts_as_unknown() {
        for time in [
            ReadoutTime::Seconds(f64::NAN),
            ReadoutTime::Seconds(-1.0),
            ReadoutTime::DelayRows(-1.0),
            ReadoutTime::DelayRows(f64::INFINITY),
        ] {
            assert_eq!(Readout::new(4, 4, ReadoutDirection::TopToBottom, time, 0.04).time, 0.04);
        }
    }
}
