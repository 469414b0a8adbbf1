// SPDX-License-Identifier: MIT OR Apache-2.0

//! Values read from arbitrary bytes; where these end, the first of each choice.

use arbitrary::{Result, Unstructured};
use rsrectify::motion::Model;
use rsrectify::plane::SampleFormat;
use rsrectify::readout::{Readout, ReadoutDirection, ReadoutPrior, ReadoutTime};
use rsrectify::rectifier::{Estimator, Settings};

/// The directions of the readout.
pub const DIRECTIONS: [ReadoutDirection; 4] = [
    ReadoutDirection::TopToBottom,
    ReadoutDirection::BottomToTop,
    ReadoutDirection::LeftToRight,
    ReadoutDirection::RightToLeft,
];

/// The ways to store a sample.
pub const FORMATS: [SampleFormat; 5] =
    [SampleFormat::U8, SampleFormat::U10, SampleFormat::U10_HIGH, SampleFormat::U12, SampleFormat::U16];

const MODELS: [Model; 7] = [
    Model::Auto,
    Model::Translation,
    Model::Rotation,
    Model::Similarity,
    Model::Affine,
    Model::Homography,
    Model::Rotation3d,
];

const SPECIAL: [f64; 12] = [
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    -0.0,
    1.0,
    -1.0,
    f64::MAX,
    f64::MIN,
    f64::MIN_POSITIVE,
    5e-324,
    1e100,
    1e-100,
];

/// A number: mostly of a magnitude up to `scale`, now and then any, or one that breaks things.
pub fn real(u: &mut Unstructured<'_>, scale: f64) -> Result<f64> {
    Ok(match u.int_in_range(0..=15u8)? {
        14 => *u.choose(&SPECIAL)?,
        15 => f64::from_bits(u.arbitrary()?),
        _ => small(u, scale)?,
    })
}

/// A finite number of a magnitude up to `scale`.
pub fn small(u: &mut Unstructured<'_>, scale: f64) -> Result<f64> {
    Ok(scale * f64::from(u.arbitrary::<i16>()?) / 32768.0)
}

/// A size: mostly up to `most`, now and then up to the largest there is.
pub fn size(u: &mut Unstructured<'_>, most: usize) -> Result<usize> {
    if u.ratio(1, 16)? { Ok(usize::MAX >> u.int_in_range(0..=63u32)?) } else { u.int_in_range(0..=most) }
}

/// What a caller may ask of a rectifier, what cannot be included; its window and grid are small.
pub fn settings(u: &mut Unstructured<'_>) -> Result<Settings> {
    let mut settings = Settings::default();
    settings.grid_columns = if u.ratio(1, 8)? { u.int_in_range(0..=4)? } else { u.int_in_range(6..=14)? };
    settings.grid_rows = if u.ratio(1, 8)? { u.int_in_range(0..=4)? } else { u.int_in_range(6..=12)? };
    settings.lookahead = u.int_in_range(0..=6)?;
    settings.estimator = *u.choose(&[Estimator::Continuous, Estimator::Sequential])?;
    settings.model = *u.choose(&MODELS)?;
    settings.focal_length = if u.arbitrary()? { Some(real(u, 2.0)?) } else { None };
    settings.direction = if u.arbitrary()? { Some(*u.choose(&DIRECTIONS)?) } else { None };
    settings.readout_time = readout_time(u)?;
    if u.arbitrary()? {
        let direction = if u.arbitrary()? { Some(*u.choose(&DIRECTIONS)?) } else { None };
        settings.readout_prior = ReadoutPrior::new(real(u, 0.05)?, real(u, 0.01)?, direction).ok();
    }
    Ok(settings)
}

/// What is stated of a readout time.
pub fn readout_time(u: &mut Unstructured<'_>) -> Result<ReadoutTime> {
    Ok(match u.int_in_range(0..=3u8)? {
        0 => ReadoutTime::Unknown,
        1 => ReadoutTime::WholePeriod,
        2 => ReadoutTime::DelayRows(real(u, 100.0)?),
        _ => ReadoutTime::Seconds(real(u, 0.05)?),
    })
}

/// The shutter of frames `period` seconds apart; a readout time that cannot be counts as the whole period.
pub fn readout(
    [width, height]: [usize; 2],
    direction: ReadoutDirection,
    time: ReadoutTime,
    period: f64,
) -> Readout {
    let time = if time.check().is_ok() { time } else { ReadoutTime::WholePeriod };
    match Readout::new(width, height, direction, time, period) {
        Ok(readout) => readout,
        Err(error) => panic!("{error}"),
    }
}

/// Repeatable pseudo-random numbers (xorshift).
pub struct Random(u64);

impl Random {
    /// From a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed | 1)
    }

    /// The next number.
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    /// Bytes.
    pub fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| (self.next() >> 24) as u8).collect()
    }
}
