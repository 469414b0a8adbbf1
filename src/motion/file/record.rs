// SPDX-License-Identifier: MIT OR Apache-2.0

//! The record of one frame.

use super::error::RecordError;
use super::hash::fnv1a;
use super::packed::Integers;
use crate::area::PictureArea;
use crate::motion::path::Global;
use crate::motion::precision::{self, ELEMENTS, Steps};
use crate::motion::{FrameMotion, MotionPath, ResidualField, ResidualMesh, SampledPath, Twist};
use crate::readout::{Readout, ReadoutDirection, ReadoutTime};
use nalgebra::Matrix3;

/// Bytes of a record before what is packed.
pub(super) const FIXED_BYTES: usize = 126;
/// Bytes before the checksum.
const BEFORE_CHECKSUM: usize = FIXED_BYTES - 4;
/// Largest side of a frame in pixels, as of the rectifier.
const MAX_SIDE: u32 = 1 << 20;
/// Most samples of a path and nodes of a mesh. The rectifier's have 33, and 120 × 120.
const MAX_SAMPLES: usize = 1025;
const MAX_NODES: usize = 1 << 16;

const DIRECTIONS: [ReadoutDirection; 4] = [
    ReadoutDirection::TopToBottom,
    ReadoutDirection::BottomToTop,
    ReadoutDirection::LeftToRight,
    ReadoutDirection::RightToLeft,
];
/// Bytes of a placement: its homography but the last element, which is 1.
const PLACEMENT_BYTES: usize = 8 * ELEMENTS;
/// Bytes of a picture's place in its frame.
const AREA_BYTES: usize = 16;
/// What follows the fixed part of a record.
const HAS_PLACEMENT: usize = 1;
const HAS_AREA: usize = 2;
const UNIFORM: u8 = 0;
const SAMPLED: u8 = 1;

/// The motion of one frame of a clip, as a motion file holds it.
///
/// The motions of a [`Rectifier`](crate::Rectifier) come back from a file exactly; those of others are rounded, see
/// the format.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct MotionRecord {
    /// When the frame is shown, in nanoseconds of the clip.
    pub time: i64,
    /// The motion to rectify the frame with.
    pub motion: FrameMotion,
    /// Confidence in it, 0 to 1.
    pub confidence: f64,
    /// Expected root mean square error of the rectified frame in pixels; `None` if it is unknown.
    pub expected_error: Option<f64>,
}

impl MotionRecord {
    /// The motion of the frame that is shown at `time` nanoseconds of the clip, with full confidence.
    #[must_use]
    pub const fn new(time: i64, motion: FrameMotion) -> Self {
        Self { time, motion, confidence: 1.0, expected_error: None }
    }

    /// The same with another confidence, 0 to 1, and expected error in pixels.
    #[must_use]
    pub fn with_confidence(self, confidence: f64, expected_error: Option<f64>) -> Self {
        Self { confidence, expected_error, ..self }
    }

    /// The record as it is stored.
    pub(super) fn encode(&self) -> Result<Vec<u8>, RecordError> {
        let (readout, path) = (self.motion.readout(), self.motion.path());
        let [width, height] =
            [readout.width(), readout.height()].map(|side| u32::try_from(side).unwrap_or(u32::MAX));
        let area = *self.motion.area();
        if area.frame().into_iter().any(|side| side > MAX_SIDE as usize) {
            return Err(RecordError::TooLarge);
        }
        let mut integers = Integers::default();
        let (kind, samples, twist, path_time) = match path.global() {
            Global::Uniform { twist, readout_time } => (UNIFORM, 0, *twist, *readout_time),
            Global::Sampled(path) => {
                let samples = encode_path(path, readout, &mut integers.path)?;
                (SAMPLED, samples, Twist::ZERO, path.readout_time())
            }
        };
        let none = ResidualMesh { columns: 0, rows: 0, origin: [0.0; 2], spacing: [0.0; 2] };
        let mesh = path.residual().map_or(none, |field| *field.mesh());
        if let Some(field) = path.residual() {
            integers.mesh = encode_field(field)?;
        }
        let short = |count: usize| u16::try_from(count).map_err(|_| RecordError::TooLarge);
        let placement = self.motion.placement().map(placement_bytes).unwrap_or_default();
        let area = if area.is_whole() { Vec::new() } else { area_bytes(&area) };
        let packed = integers.pack(mesh.columns);
        let length = FIXED_BYTES + placement.len() + area.len() + packed.len();
        let mut bytes = Vec::with_capacity(length);
        let length = u32::try_from(length).map_err(|_| RecordError::TooLarge)?;
        let direction = DIRECTIONS.iter().position(|one| *one == readout.direction()).unwrap_or_default();
        [length, width, height].iter().for_each(|value| bytes.extend(value.to_le_bytes()));
        bytes.extend([direction as u8, kind]);
        let has = |bytes: &[u8], flag: usize| if bytes.is_empty() { 0 } else { flag };
        let parts = has(&placement, HAS_PLACEMENT) + has(&area, HAS_AREA);
        for value in [samples, short(mesh.columns)?, short(mesh.rows)?, short(parts)?] {
            bytes.extend(value.to_le_bytes());
        }
        let expected = self.expected_error.unwrap_or(f64::NAN);
        let numbers = [readout.time(), self.motion.weight(), self.confidence, expected, path_time];
        let numbers = numbers.into_iter().chain([twist.omega, twist.velocity.x, twist.velocity.y]);
        for value in numbers.chain(mesh.origin).chain(mesh.spacing) {
            bytes.extend(value.to_le_bytes());
        }
        bytes.extend((packed.len() as u32).to_le_bytes());
        bytes.extend(checksum(&bytes, &[&placement, &area, &packed]).to_le_bytes());
        [placement, area, packed].into_iter().for_each(|part| bytes.extend(part));
        Ok(bytes)
    }

    /// Reads a record that was stored for a frame at `time`; `bytes` may go on after it.
    pub(super) fn decode(time: i64, bytes: &[u8]) -> Result<Self, RecordError> {
        let mut fields = Fields(bytes);
        let length = fields.u32()? as usize;
        let [width, height] = [fields.u32()?, fields.u32()?];
        let [direction, kind] = fields.take::<2>()?;
        let [samples, columns, rows, parts] =
            [fields.u16()?, fields.u16()?, fields.u16()?, fields.u16()?].map(usize::from);
        let [readout_time, weight, confidence, expected, path_time] =
            [fields.f64()?, fields.f64()?, fields.f64()?, fields.f64()?, fields.f64()?];
        let twist = Twist::new(fields.f64()?, fields.f64()?, fields.f64()?);
        let origin = [fields.f64()?, fields.f64()?];
        let spacing = [fields.f64()?, fields.f64()?];
        let packed = fields.u32()? as usize;
        let expected_checksum = fields.u32()?;
        let placement = if parts & HAS_PLACEMENT > 0 { fields.slice(PLACEMENT_BYTES)? } else { &[] };
        let area = if parts & HAS_AREA > 0 { fields.slice(AREA_BYTES)? } else { &[] };
        let packed = fields.slice(packed)?;
        if length < FIXED_BYTES + placement.len() + area.len() + packed.len() || bytes.len() < length {
            return Err(RecordError::CutShort);
        }
        let before = bytes.get(..BEFORE_CHECKSUM).unwrap_or_default();
        if checksum(before, &[placement, area, packed]) != expected_checksum {
            return Err(RecordError::Checksum);
        }
        let nodes = columns * rows;
        if width.max(height) > MAX_SIDE || samples > MAX_SAMPLES || nodes > MAX_NODES {
            return Err(RecordError::TooLarge);
        }
        let direction = DIRECTIONS.get(usize::from(direction)).ok_or(RecordError::Kind(direction))?;
        let (width, height) = (width as usize, height as usize);
        let readout = Readout::new(width, height, *direction, ReadoutTime::Seconds(readout_time), 1.0)?;
        let samples = if kind == SAMPLED { samples } else { 0 };
        let Integers { path: steps, mesh: field } = Integers::unpack(packed, samples, [columns, rows]);
        let path = match kind {
            UNIFORM if twist.is_finite() && path_time.is_finite() => MotionPath::uniform(twist, path_time),
            UNIFORM => return Err(RecordError::NotFinite),
            SAMPLED => MotionPath::from(decode_path(&steps, samples, &readout, path_time)?),
            other => return Err(RecordError::Kind(other)),
        };
        let path = if nodes > 0 {
            path.with_residual(decode_field(field, ResidualMesh { columns, rows, origin, spacing })?)
        } else {
            path
        };
        if !(weight.is_finite() && confidence.is_finite()) {
            return Err(RecordError::NotFinite);
        }
        let placement = decode_placement(placement)?;
        let area = decode_area(area, [width, height])?;
        let motion =
            FrameMotion::new(readout, path).with_weight(weight).with_placement(placement).within(area);
        Ok(Self { time, motion, confidence, expected_error: expected.is_finite().then_some(expected) })
    }
}

/// Appends the integers of a path, element by element; the number of its samples.
fn encode_path(path: &SampledPath, readout: &Readout, integers: &mut Vec<i64>) -> Result<u16, RecordError> {
    let motions = path.motions();
    let samples = u16::try_from(motions.len()).ok().filter(|_| motions.len() <= MAX_SAMPLES);
    let radius = precision::radius(readout.width(), readout.height());
    let steps: Option<Vec<Steps>> = motions.iter().map(|motion| precision::steps(motion, radius)).collect();
    let steps = steps.ok_or(RecordError::Range)?;
    for element in 0..ELEMENTS {
        integers.extend(steps.iter().filter_map(|steps| steps.get(element)));
    }
    samples.ok_or(RecordError::TooLarge)
}

fn decode_path(
    integers: &[i64],
    samples: usize,
    readout: &Readout,
    path_time: f64,
) -> Result<SampledPath, RecordError> {
    let radius = precision::radius(readout.width(), readout.height());
    let mut all = vec![Steps::default(); samples];
    for (element, values) in integers.chunks(samples.max(1)).enumerate() {
        for (steps, value) in all.iter_mut().zip(values) {
            if let Some(step) = steps.get_mut(element) {
                *step = *value;
            }
        }
    }
    let motions: Vec<Matrix3<f64>> = all.iter().map(|steps| precision::homography(steps, radius)).collect();
    Ok(SampledPath::new(&motions, path_time)?)
}

/// The integers of a field, along each axis.
fn encode_field(field: &ResidualField) -> Result<[Vec<i64>; 2], RecordError> {
    let mesh = field.mesh();
    if field.velocities().len() > MAX_NODES {
        return Err(RecordError::TooLarge);
    }
    let along = |axis: usize, spacing: f64| -> Option<Vec<i64>> {
        let velocities = field.velocities().iter().filter_map(|velocity| velocity.get(axis));
        velocities.map(|velocity| precision::velocity_steps(*velocity, spacing)).collect()
    };
    let [across, down] = mesh.spacing;
    Ok([along(0, across).ok_or(RecordError::Range)?, along(1, down).ok_or(RecordError::Range)?])
}

fn decode_field([x, y]: [Vec<i64>; 2], mesh: ResidualMesh) -> Result<ResidualField, RecordError> {
    let [across, down] = mesh.spacing;
    let velocity = |(x, y)| [precision::velocity(x, across), precision::velocity(y, down)];
    Ok(ResidualField::new(mesh, x.into_iter().zip(y).map(velocity).collect())?)
}

/// A placement as it is stored: its elements but the last, row by row.
fn placement_bytes(placement: &Matrix3<f64>) -> Vec<u8> {
    placement.transpose().iter().take(ELEMENTS).flat_map(|value| value.to_le_bytes()).collect()
}

/// The placement that is stored, if there is one.
fn decode_placement(bytes: &[u8]) -> Result<Option<Matrix3<f64>>, RecordError> {
    let (elements, _) = bytes.as_chunks::<8>();
    if elements.is_empty() {
        return Ok(None);
    }
    let elements = elements.iter().map(|bytes| f64::from_le_bytes(*bytes)).chain([1.0]);
    let placement = Matrix3::from_row_iterator(elements);
    placement.iter().all(|value| value.is_finite()).then_some(Some(placement)).ok_or(RecordError::NotFinite)
}

/// A picture's place in its frame as it is stored; sides are at most [`MAX_SIDE`].
fn area_bytes(area: &PictureArea) -> Vec<u8> {
    area.frame().into_iter().chain(area.origin()).flat_map(|side| (side as u32).to_le_bytes()).collect()
}

/// The place that is stored, if there is one, of a picture of `size`.
fn decode_area(bytes: &[u8], size: [usize; 2]) -> Result<PictureArea, RecordError> {
    if bytes.is_empty() {
        return Ok(PictureArea::whole(size[0], size[1]));
    }
    let mut fields = Fields(bytes);
    let [width, height, x, y] = [fields.u32()?, fields.u32()?, fields.u32()?, fields.u32()?];
    if width.max(height) > MAX_SIDE {
        return Err(RecordError::TooLarge);
    }
    let [frame, origin] = [[width, height], [x, y]].map(|pair| pair.map(|side| side as usize));
    PictureArea::new(frame, origin, size).ok_or(RecordError::Area)
}

/// The checksum of a record: of all but its length, which later versions change, and the checksum itself.
fn checksum(before: &[u8], after: &[&[u8]]) -> u32 {
    fnv1a(before.iter().skip(4).chain(after.iter().copied().flatten()).copied()) as u32
}

/// What is left of a record's bytes.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn slice(&mut self, count: usize) -> Result<&'a [u8], RecordError> {
        let (first, rest) = self.0.split_at_checked(count).ok_or(RecordError::CutShort)?;
        self.0 = rest;
        Ok(first)
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], RecordError> {
        let (first, rest) = self.0.split_first_chunk::<N>().ok_or(RecordError::CutShort)?;
        self.0 = rest;
        Ok(*first)
    }

    fn u16(&mut self) -> Result<u16, RecordError> {
        self.take().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, RecordError> {
        self.take().map(u32::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, RecordError> {
        self.take().map(f64::from_le_bytes)
    }
}
