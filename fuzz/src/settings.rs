// SPDX-License-Identifier: MIT OR Apache-2.0

//! Settings and sizes, possible and impossible.

use super::input::{real, settings, size};
use arbitrary::{Result, Unstructured};
use rsrectify::plane::{Luma, Plane, PlaneLayout, SampleFormat};
use rsrectify::readout::{Readout, ReadoutTime};
use rsrectify::rectifier::{Duplicate, Rectifier, Settings};

/// Pixels of a frame, at most, in whose stream frames are pushed.
const MOST_PIXELS: usize = 1 << 12;
/// Nodes of a grid, at most, in whose stream frames are pushed.
const MOST_NODES: usize = 1 << 8;

/// A rectifier is made if and only if the settings can be, and then it counts its frames.
pub fn check(data: &[u8]) {
    let mut u = Unstructured::new(data);
    // Bytes that end make the rest of a case its defaults; they are no failure.
    let _ = settled(&mut u);
}

fn settled(u: &mut Unstructured<'_>) -> Result<()> {
    let mut settings = settings(u)?;
    if u.arbitrary()? {
        (settings.grid_columns, settings.grid_rows) = (size(u, 40)?, size(u, 40)?);
    }
    if u.arbitrary()? {
        settings.lookahead = size(u, 9)?;
    }
    let (width, height) = (size(u, 80)?, size(u, 60)?);
    let period = if u.arbitrary()? { Some(real(u, 0.1)?) } else { None };
    let rectifier = Rectifier::new(settings, width, height, period);
    assert_eq!(rectifier.is_ok(), is_valid(&settings, [width, height]), "{settings:?} {width}x{height}");
    let small = width.saturating_mul(height) <= MOST_PIXELS;
    let coarse = settings.grid_columns.saturating_mul(settings.grid_rows) <= MOST_NODES;
    let Some(mut rectifier) = rectifier.ok().filter(|_| small && coarse) else { return Ok(()) };
    let layout = PlaneLayout::packed(width, height, SampleFormat::U8);
    let frames = u.int_in_range(0..=4usize)?;
    for k in 0..frames {
        let pixels: Vec<u8> = (0..width * height).map(|i| ((i + 3 * k) * 37 % 251) as u8).collect();
        let Ok(plane) = Plane::new(&pixels, layout) else { panic!("{layout:?} is packed") };
        assert_eq!(rectifier.push(&Luma::from(plane), Some(0.04 * k as f64), Duplicate::Detect), Ok(()));
    }
    let early = std::iter::from_fn(|| rectifier.pop()).count();
    assert_eq!(early, frames.saturating_sub(settings.lookahead));
    rectifier.drain();
    assert_eq!(early + std::iter::from_fn(|| rectifier.pop()).count(), frames);
    Ok(())
}

/// What the documentation says of settings.
fn is_valid(settings: &Settings, size: [usize; 2]) -> bool {
    let known = match settings.readout_time {
        ReadoutTime::Seconds(value) | ReadoutTime::DelayRows(value) => (0.0..f64::INFINITY).contains(&value),
        _ => true,
    };
    let readout = Readout::new(64, 48, Default::default(), settings.readout_time, 0.04);
    assert_eq!(readout.is_ok(), known, "{readout:?}");
    assert!(readout.is_ok_and(|readout| (0.0..f64::INFINITY).contains(&readout.time())) == known);
    let focal = settings.focal_length.is_none_or(|focal| focal > 0.0 && focal < f64::INFINITY);
    let grid = settings.grid_columns <= 1024 && settings.grid_rows <= 1024;
    known && focal && grid && size.iter().all(|side| *side <= 1 << 20)
}
