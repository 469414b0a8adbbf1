// SPDX-License-Identifier: MIT OR Apache-2.0

//! Planes of any layout, and their rectification by any motion at every CPU level.

use super::input::{DIRECTIONS, FORMATS, Random, readout, readout_time, real, size, small};
use arbitrary::{Result, Unstructured};
use nalgebra::Matrix3;
use rsrectify::motion::{FrameMotion, MotionPath, ResidualField, ResidualMesh, SampledPath, Twist};
use rsrectify::plane::{Plane, PlaneLayout, PlaneMut};
use rsrectify::readout::Readout;
use rsrectify::warp::{BorderMode, CpuLevel, Fill, Interpolation, SampleGrid, WarpSettings, Warper};

const INTERPOLATIONS: [Interpolation; 4] =
    [Interpolation::Cubic, Interpolation::Nearest, Interpolation::Linear, Interpolation::Lanczos];
const BORDERS: [BorderMode; 3] =
    [BorderMode::Replicate, BorderMode::Mirror, BorderMode::Constant(Fill::packed([200, 100, 50, 65535]))];
/// What the bytes hold that the warp must not write.
const UNTOUCHED: u8 = 0xa5;

/// - A layout is accepted if and only if the bytes hold all its samples and none twice.
/// - All CPU levels rectify alike, write every sample of the plane and nothing else, and leave a plain picture plain.
pub fn check(data: &[u8]) {
    let mut u = Unstructured::new(data);
    // Bytes that end make the rest of a case its defaults; they are no failure.
    let _ = layouts(&mut u).and_then(|()| rectified(&mut u));
}

fn layouts(u: &mut Unstructured<'_>) -> Result<()> {
    let layout = PlaneLayout {
        width: size(u, 40)?,
        height: size(u, 20)?,
        stride: size(u, 300)?,
        step: size(u, 6)?,
        channels: size(u, 5)?,
        format: *u.choose(&FORMATS)?,
    };
    let mut bytes = vec![0; u.int_in_range(0..=8192)?];
    let valid = is_valid(&layout, bytes.len());
    let plane = Plane::new(&bytes, layout);
    assert_eq!(plane.is_ok(), valid, "{layout:?} in {} bytes", bytes.len());
    if let Ok(plane) = plane {
        for y in [0, 1, layout.height / 2, layout.height.wrapping_sub(1), layout.height, usize::MAX] {
            let own = || ((layout.width - 1) * layout.step + layout.channels) * layout.format.bytes();
            let expected = if y < layout.height && layout.width > 0 { own() } else { 0 };
            assert_eq!(plane.row(y).len(), expected, "row {y} of {layout:?}");
        }
    }
    let plane = PlaneMut::new(&mut bytes, layout);
    assert_eq!(plane.is_ok(), valid, "{layout:?}");
    if let Ok(mut plane) = plane {
        let source = vec![1; plane.data_mut().len()];
        let source = Plane::new(&source, layout);
        let still = FrameMotion::new(Readout::global_shutter(layout.width, layout.height), MotionPath::STILL);
        let mut warper = Warper::new();
        let frame = warper.prepare(&still, &WarpSettings::default());
        let copied = source.map(|source| frame.warp(&source, &mut plane, SampleGrid::FULL));
        assert_eq!(copied, Ok(Ok(())), "{layout:?}");
    }
    Ok(())
}

/// The definition of a layout, in numbers that do not overflow.
fn is_valid(layout: &PlaneLayout, len: usize) -> bool {
    let PlaneLayout { width, height, stride, step, channels, format } = *layout;
    let [width, height, stride, step, channels, bytes] =
        [width, height, stride, step, channels, format.bytes()].map(|value| value as u128);
    if !(1..=4).contains(&channels) || step < channels {
        return false;
    }
    if width == 0 || height == 0 {
        return true;
    }
    let row = ((width - 1) * step + channels).saturating_mul(bytes);
    (height == 1 || stride >= row) && ((height - 1) * stride).saturating_add(row) <= len as u128
}

fn rectified(u: &mut Unstructured<'_>) -> Result<()> {
    let from = layout(u)?;
    let to = {
        let step = from.channels + u.int_in_range(0..=3usize)?;
        let stride = from.width * step * from.format.bytes() + u.int_in_range(0..=19usize)?;
        PlaneLayout { step, stride, ..from }
    };
    let motion = motion(u, &from)?;
    let mut settings = WarpSettings::default();
    settings.interpolation = *u.choose(&INTERPOLATIONS)?;
    settings.border = *u.choose(&BORDERS)?;
    settings.reference_row = real(u, 1.0)?;
    settings.strength = real(u, 1.0)?;
    settings.zoom = real(u, 4.0)?;
    let grid = match u.int_in_range(0..=3u8)? {
        0 | 1 => SampleGrid::FULL,
        2 => SampleGrid::CHROMA_420,
        _ => SampleGrid { scale: [real(u, 4.0)?, real(u, 4.0)?], offset: [real(u, 9.0)?, real(u, 9.0)?] },
    };
    // Views of packed pictures start anywhere.
    let offset = u.int_in_range(0..=8usize)?;
    let mut random = Random::new(u.arbitrary()?);
    let plain = u.ratio(1, 4)?.then(|| (random.next() >> 13) as u16 & from.format.max_value());
    if let (BorderMode::Constant(fill), Some(value)) = (&mut settings.border, plain) {
        *fill = Fill::packed([value; 4]);
    }
    let source = {
        let len = offset + from.required_bytes().unwrap_or(0);
        match plain {
            None => random.bytes(len),
            Some(value) => stored(value, &from, offset, len),
        }
    };
    let Ok(source) = Plane::new(&source[offset..], from) else { panic!("{from:?} is a layout") };
    let mut reference: Option<Vec<u8>> = None;
    for level in CpuLevel::supported() {
        let mut warper = Warper::with_cpu(level);
        let frame = warper.prepare(&motion, &settings);
        let mut bytes = vec![UNTOUCHED; offset + to.required_bytes().unwrap_or(0) + 5];
        let Ok(mut target) = PlaneMut::new(&mut bytes[offset..], to) else { panic!("{to:?} is a layout") };
        if frame.warp(&source, &mut target, grid).is_err() {
            return Ok(());
        }
        verify(&bytes, &to, offset, plain);
        match &reference {
            Some(reference) => {
                let differs = reference.iter().zip(&bytes).position(|(a, b)| a != b);
                assert_eq!(differs, None, "{level} rectifies {from:?} differently at {grid:?}");
            }
            None => reference = Some(bytes),
        }
    }
    Ok(())
}

fn layout(u: &mut Unstructured<'_>) -> Result<PlaneLayout> {
    let format = *u.choose(&FORMATS)?;
    let channels = u.int_in_range(1..=4usize)?;
    let step = channels + u.int_in_range(0..=3usize)?;
    let (width, height) = (u.int_in_range(0..=80usize)?, u.int_in_range(0..=50usize)?);
    let stride = width * step * format.bytes() + u.int_in_range(0..=39usize)?;
    Ok(PlaneLayout { width, height, stride, step, channels, format })
}

/// A picture of one value, stored at `offset`; between its samples lies something else.
fn stored(value: u16, layout: &PlaneLayout, offset: usize, len: usize) -> Vec<u8> {
    let word = (value << layout.format.shift()).to_le_bytes();
    let sample = layout.format.bytes();
    let mut bytes = vec![UNTOUCHED; len];
    for (row, pixel) in (0..layout.height).flat_map(|row| (0..layout.width).map(move |pixel| (row, pixel))) {
        let at = offset + row * layout.stride + pixel * layout.step * sample;
        for stored in bytes[at..at + layout.channels * sample].chunks_mut(sample) {
            stored.copy_from_slice(&word[..sample]);
        }
    }
    bytes
}

/// That own samples hold what a plain picture holds and all other bytes what they held.
fn verify(bytes: &[u8], layout: &PlaneLayout, offset: usize, plain: Option<u16>) {
    let sample = layout.format.bytes();
    let mut own = vec![false; bytes.len()];
    for (row, pixel) in (0..layout.height).flat_map(|row| (0..layout.width).map(move |pixel| (row, pixel))) {
        let at = offset + row * layout.stride + pixel * layout.step * sample;
        let pixel = at..at + layout.channels * sample;
        own[pixel.clone()].fill(true);
        if let Some(value) = plain {
            let expected = (value << layout.format.shift()).to_le_bytes();
            assert!(
                bytes[pixel].chunks(sample).all(|stored| *stored == expected[..sample]),
                "row {row} of {layout:?} is not plain"
            );
        }
    }
    assert!(bytes.iter().zip(own).all(|(byte, own)| own || *byte == UNTOUCHED), "beside {layout:?}");
}

/// A motion of any kind and degree.
fn motion(u: &mut Unstructured<'_>, layout: &PlaneLayout) -> Result<FrameMotion> {
    let width = if u.ratio(1, 8)? { size(u, 200)?.min(1 << 14) } else { layout.width };
    let height = if u.ratio(1, 8)? { size(u, 200)?.min(1 << 14) } else { layout.height };
    let readout = readout([width, height], *u.choose(&DIRECTIONS)?, readout_time(u)?, 1.0);
    let mut path = if u.arbitrary()? {
        let twist = Twist::new(real(u, 0.6)?, real(u, 60.0)?, real(u, 60.0)?);
        MotionPath::uniform(twist, readout.time())
    } else {
        let element = if u.ratio(1, 8)? { real } else { small };
        let mut motions = Vec::new();
        for _ in 0..u.int_in_range(5..=9u8)? {
            let mut motion = Matrix3::identity();
            for (index, scale) in
                [(0, 0.1), (1, 0.1), (3, 0.1), (4, 0.1), (2, 1e-3), (5, 1e-3), (6, 20.0), (7, 20.0)]
            {
                motion[index] += element(u, scale)?;
            }
            motions.push(motion);
        }
        SampledPath::new(&motions, readout.time()).map_or(MotionPath::STILL, MotionPath::from)
    };
    if u.ratio(1, 3)? {
        let (columns, rows) = (u.int_in_range(1..=4usize)?, u.int_in_range(1..=4usize)?);
        let mesh = ResidualMesh {
            columns,
            rows,
            origin: [real(u, 40.0)?, real(u, 40.0)?],
            spacing: [real(u, 40.0)?, real(u, 40.0)?],
        };
        let mut velocities = Vec::new();
        for _ in 0..columns * rows {
            velocities.push([real(u, 30.0)? as f32, small(u, 30.0)? as f32]);
        }
        if let Ok(field) = ResidualField::new(mesh, velocities) {
            path = path.with_residual(field);
        }
    }
    Ok(FrameMotion::new(readout, path).with_weight(if u.arbitrary()? { real(u, 1.0)? } else { 1.0 }))
}
