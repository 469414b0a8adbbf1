// SPDX-License-Identifier: MIT OR Apache-2.0

//! Pictures a person looks at: a frame as it arrived, rectified and true, and where they differ.

use super::runner::Task;
use crate::metrics::resample::rectified;
use crate::systems::registry::Entry;
use anyhow::{Context, Result, anyhow, ensure};
use baselines::correspondences::{Source, of_run};
use image::codecs::jpeg::JpegEncoder;
use image::{Rgb, RgbImage, imageops};
use plotters::prelude::*;
use render::footage::Footage;
use render::scene::Frame;
use render::sequence::{self, Settings};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// Sequences of which a frame is shown, of scene 1: of those that are run, and of those that are no part of the report.
const SEQUENCES: [&str; 4] = ["rot1_B0", "rot2_B40", "trans_rot1_B40", "shake_g042"];
const HARD: [&str; 3] = ["selfie", "thin", "driving"];
const SEED: u64 = 1;
/// Whose correction is shown, and whose is compared with it.
const SHOWN: [&str; 2] = ["rsrectify-4", "3d-rotation-3"];
/// The frame that is shown; the last one of a shorter clip.
const FRAME: usize = 11;
/// Colour distance (channels 0 to 1) at the upper end of the scale, the paper's threshold.
const MOST: f64 = 0.3;
/// Pixels between pictures, and JPEG quality.
const GAP: u32 = 6;
const QUALITY: u8 = 80;
/// Size of the scale's picture, and the steps of colour it is made of.
const SCALE: (u32, u32) = (420, 62);
const STEPS: u32 = 120;

/// Writes one JPEG for each of four sequences, where it is among the tasks, and of the hard ones if `with_hard`: above the
/// frame as it arrived, rectified and true; below the colour distance to the truth as it arrived, rectified, and
/// rectified by a calibrated 3D rotation, black where no pixel can be judged. The scale of the distances
/// is drawn beside them as `still-scale.svg`.
///
/// # Errors
/// Where a system fails or a file cannot be written.
pub fn write_all(
    tasks: &[Task],
    entries: &[Entry],
    footage: &dyn Fn(&Settings) -> Result<Footage>,
    folder: &Path,
    with_hard: bool,
) -> Result<()> {
    let shown = |settings: &Settings| settings.seed == SEED && SEQUENCES.contains(&settings.name.as_str());
    let hard = HARD.iter().filter(|_| with_hard).flat_map(|name| sequence::named(name));
    // As many frames beyond the one that is shown as a lookahead of four takes, and one more.
    let hard = hard.map(|settings| Settings { seed: SEED, frames: FRAME + 6, ..settings });
    let run = tasks.iter().map(|task| task.settings.clone()).filter(shown);
    for settings in run.chain(hard) {
        let sheet = sheet(&footage(&settings)?, entries)?;
        let file = BufWriter::new(File::create(folder.join(format!("still-{}.jpg", settings.name)))?);
        JpegEncoder::new_with_quality(file, QUALITY).encode_image(&sheet)?;
    }
    let path = folder.join("still-scale.svg");
    draw_scale(&path).map_err(|error| anyhow!("cannot draw {}: {error}", path.display()))
}

fn sheet(footage: &Footage, entries: &[Entry]) -> Result<RgbImage> {
    ensure!(!footage.frames.is_empty(), "a sequence without frames");
    let frame = FRAME.min(footage.frames.len() - 1);
    let runs = footage.runs();
    let pairs = runs.iter().map(|run| of_run(footage, run, Source::Sampler)).collect::<Result<Vec<_>>>()?;
    let before = &footage.frames[frame];
    let after = |id: &str| -> Result<Frame> {
        let entry = entries.iter().find(|entry| entry.id == id).context("a system of the stills is gone")?;
        Ok(rectified(before, entry.solve(footage, &pairs)?.0[frame].as_ref()).frame)
    };
    let [after, compared] = [after(SHOWN[0])?, after(SHOWN[1])?];
    let global =
        footage.truth[frame].global.as_ref().context("footage without pictures of a global shutter")?;
    let (truth, mask) = (&global.picture, &global.visible);
    let pictures = [
        picture(before),
        picture(&after),
        picture(truth),
        distances(before, truth, mask),
        distances(&after, truth, mask),
        distances(&compared, truth, mask),
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

/// The colours of [`distances`] with the numbers that they stand for.
fn draw_scale(path: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::new(path, SCALE).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .margin(8)
        .margin_left(20)
        .margin_right(60)
        .x_label_area_size(24)
        .build_cartesian_2d(0.0..MOST, 0.0..1.0)?;
    let step = |index: u32| MOST * f64::from(index) / f64::from(STEPS);
    chart.draw_series((0..STEPS).map(|index| {
        let Rgb([red, green, blue]) = heat((f64::from(index) + 0.5) / f64::from(STEPS));
        let corners = [(step(index), 0.0), (step(index + 1), 1.0)];
        Rectangle::new(corners, RGBColor(red, green, blue).filled())
    }))?;
    chart
        .configure_mesh()
        .disable_mesh()
        .x_labels(4)
        .x_label_formatter(&|distance| {
            format!("{distance:.1}{}", if *distance < MOST - 1e-9 { "" } else { " and more" })
        })
        .label_style(("sans-serif", 13))
        .draw()?;
    root.present()?;
    Ok(())
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
    fn the_scale_has_its_numbers() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scale.svg");
        draw_scale(&path).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        assert!(["0.0", "0.1", "0.2", "0.3 and more"].iter().all(|number| svg.contains(number)), "{svg}");
    }

    #[test]
    fn a_distance_at_the_threshold_is_the_end_of_the_scale() {
        let frame = |value: u8| Frame { width: 2, height: 1, rgb: vec![value, 0, 0, value, 0, 0] };
        let found = distances(&frame(77), &frame(0), &[true, false]);
        assert_eq!((found.get_pixel(0, 0), found.get_pixel(1, 0).0), (&heat(1.0), [0; 3]));
    }
}
