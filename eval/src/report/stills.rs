//! Pictures a person looks at: a frame as it arrived, rectified and true, and where they differ.

use crate::correspondences::{Source, of_run};
use crate::footage::Footage;
use crate::methods::registry::Entry;
use crate::metrics::resample::rectified;
use crate::scene::Frame;
use crate::sequence;
use anyhow::{Context, Result};
use image::codecs::jpeg::JpegEncoder;
use image::{Rgb, RgbImage, imageops};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// Sequences of which a frame is shown.
pub const SEQUENCES: [&str; 4] = ["rot1_B0", "rot2_B40", "trans_rot1_B40", "shake_g042"];
/// Whose correction is shown.
const SHOWN: &str = "rsrectify-4";
/// The frame that is shown, and as many as are rendered before and after it.
const FRAME: usize = 11;
const FRAMES: usize = 20;
/// Colour distance (channels 0 to 1) at the upper end of the scale, the paper's threshold.
const MOST: f64 = 0.3;
/// Pixels between pictures, height of the scale, and JPEG quality.
const GAP: u32 = 6;
const SCALE: u32 = 14;
const QUALITY: u8 = 80;

/// Writes one JPEG for each of [`SEQUENCES`]: above the frame as it arrived, rectified and true, below
/// the colour distance to the truth before and after, black where no pixel can be judged, and beside
/// them the scale of the distances, 0 at its left end and 0.3 or more at its right.
///
/// # Errors
/// Where the system fails or a file cannot be written.
pub fn write_all(entries: &[Entry], folder: &Path) -> Result<()> {
    let entry = entries.iter().find(|entry| entry.id == SHOWN).context("the system of the stills is gone")?;
    for name in SEQUENCES {
        let settings = sequence::named(name).with_context(|| format!("no sequence is named {name}"))?;
        // Never photographs: the pictures are published.
        let footage = Footage::of_settings(&sequence::Settings { frames: FRAMES, ..settings })?;
        let sheet = sheet(&footage, entry)?;
        let file = BufWriter::new(File::create(folder.join(format!("still-{name}.jpg")))?);
        JpegEncoder::new_with_quality(file, QUALITY).encode_image(&sheet)?;
    }
    Ok(())
}

fn sheet(footage: &Footage, entry: &Entry) -> Result<RgbImage> {
    let runs = footage.runs();
    let pairs = runs.iter().map(|run| of_run(footage, run, Source::Sampler)).collect::<Result<Vec<_>>>()?;
    let correction = &entry.corrections(footage, &pairs)?[FRAME];
    let before = &footage.frames[FRAME];
    let after = rectified(before, correction.as_ref()).frame;
    let (truth, mask) = (&footage.truth[FRAME].global, &footage.truth[FRAME].visible);
    let pictures = [
        picture(before),
        picture(&after),
        picture(truth),
        distances(before, truth, mask),
        distances(&after, truth, mask),
        scale(before.width as u32, before.height as u32),
    ];
    Ok(beside(
        &pictures.map(|picture| imageops::thumbnail(&picture, picture.width() / 2, picture.height() / 2)),
    ))
}

/// Six pictures of one size in two rows of three.
fn beside(pictures: &[RgbImage; 6]) -> RgbImage {
    let (width, height) = pictures[0].dimensions();
    let mut sheet = RgbImage::from_pixel(3 * width + 2 * GAP, 2 * height + GAP, Rgb([255, 255, 255]));
    for (index, picture) in pictures.iter().enumerate() {
        let (column, row) = (index as u32 % 3, index as u32 / 3);
        let (x, y) = (column * (width + GAP), row * (height + GAP));
        imageops::replace(&mut sheet, picture, i64::from(x), i64::from(y));
    }
    sheet
}

fn picture(frame: &Frame) -> RgbImage {
    RgbImage::from_fn(frame.width as u32, frame.height as u32, |x, y| Rgb(colour(frame, x, y)))
}

fn colour(frame: &Frame, x: u32, y: u32) -> [u8; 3] {
    let start = 3 * (y as usize * frame.width + x as usize);
    [0, 1, 2].map(|channel| frame.rgb[start + channel])
}

/// The colour distance of each pixel to the truth as heat.
fn distances(frame: &Frame, truth: &Frame, mask: &[bool]) -> RgbImage {
    RgbImage::from_fn(frame.width as u32, frame.height as u32, |x, y| {
        if !mask[y as usize * frame.width + x as usize] {
            return Rgb([0; 3]);
        }
        let (a, b) = (colour(frame, x, y), colour(truth, x, y));
        let squares: f64 = (0..3).map(|i| (f64::from(a[i]) - f64::from(b[i])).powi(2)).sum();
        heat(squares.sqrt() / 255.0 / MOST)
    })
}

/// The scale of [`distances`] in the middle of a white picture.
fn scale(width: u32, height: u32) -> RgbImage {
    let (left, right) = (width / 8, width - width / 8);
    let (top, bottom) = (height / 2 - SCALE, height / 2 + SCALE);
    RgbImage::from_fn(width, height, |x, y| {
        if (left..right).contains(&x) && (top..bottom).contains(&y) {
            heat(f64::from(x - left) / f64::from(right - left))
        } else {
            Rgb([255; 3])
        }
    })
}

/// From dark blue over red to light yellow, ever lighter, so that it is read without colour too.
fn heat(share: f64) -> Rgb<u8> {
    const STOPS: [[f64; 3]; 5] = [
        [10.0, 10.0, 60.0],
        [95.0, 20.0, 110.0],
        [200.0, 50.0, 70.0],
        [250.0, 140.0, 30.0],
        [255.0, 250.0, 170.0],
    ];
    let place = share.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let first = (place as usize).min(STOPS.len() - 2);
    let rest = place - first as f64;
    Rgb([0, 1, 2].map(|i| (STOPS[first][i] * (1.0 - rest) + STOPS[first + 1][i] * rest) as u8))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heat_grows_lighter_with_the_distance() {
        let light = |share| heat(share).0.iter().map(|channel| u32::from(*channel)).sum::<u32>();
        assert!((0..100).all(|i| light(f64::from(i) / 100.0) <= light(f64::from(i + 1) / 100.0)));
        assert_eq!((heat(0.0).0, heat(7.0).0), ([10, 10, 60], [255, 250, 170]));
    }

    #[test]
    fn a_distance_at_the_threshold_is_the_end_of_the_scale() {
        let frame = |value: u8| Frame { width: 2, height: 1, rgb: vec![value, 0, 0, value, 0, 0] };
        let found = distances(&frame(77), &frame(0), &[true, false]);
        assert_eq!((found.get_pixel(0, 0), found.get_pixel(1, 0).0), (&heat(1.0), [0; 3]));
    }
}
