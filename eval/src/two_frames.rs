// SPDX-License-Identifier: MIT OR Apache-2.0

//! The second of two frames, rectified by these alone with the readout given: what a data set of pairs asks for.
//!
//! Two frames tell no acceleration, so that flow × time is a fair rival: each pixel moved by its flow to the first frame,
//! times the share of that time until the middle of the readout.

use crate::metrics::colour::psnr;
use crate::metrics::displacement;
use crate::metrics::resample::rectified;
use crate::systems::product::{self, Delay};
use anyhow::{Context, Result, ensure};
use baselines::methods::Correction;
use nalgebra::Vector2;
use render::footage::Footage;
use render::stats::{Stats, distances};
use rsrectify::rectifier::{Estimator, FrameSolution, Rectifier};
use std::fs;
use std::path::Path;

/// Frames from one pair to the next.
const EVERY: usize = 4;

/// Share of the width and the height over which the picture is judged, in the middle.
const INNER: f64 = 0.84;

/// The heading of the rows that [`row`] writes.
pub const HEADING: &str = "| sequence | uncorrected px | whole sequence: left | worst frame: left less uncorrected px \
    | pairs: uncorrected px | left | flow × time | uncorrected dB | rectified dB | flow × time dB |\n\
    |---|---|---|---|---|---|---|---|---|---|";

/// A displacement for each pixel of a frame, to its middle of the readout.
struct DisplacementField {
    size: [usize; 2],
    /// x and y of each pixel, row by row.
    values: Vec<[f32; 2]>,
}

impl DisplacementField {
    /// Reads pairs of `f32` in little-endian order.
    fn read(path: &Path, size: [usize; 2]) -> Result<Self> {
        let bytes = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        ensure!(
            bytes.len() == 8 * size[0] * size[1],
            "{} is not of {} × {} pixels",
            path.display(),
            size[0],
            size[1]
        );
        let (numbers, _) = bytes.as_chunks::<4>();
        let numbers: Vec<f32> = numbers.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        Ok(Self { size, values: numbers.as_chunks::<2>().0.to_vec() })
    }

    fn moved(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        let [width, height] = self.size;
        let place = |at: f64, length: usize| at.clamp(0.0, length as f64 - 1.0);
        let (x, y) = (place(pixel.x, width), place(pixel.y, height));
        let (column, row) = (x as usize, y as usize);
        let at = |column: usize, row: usize| {
            let value = self.values[row.min(height - 1) * width + column.min(width - 1)];
            Vector2::from(value).map(f64::from)
        };
        let along = |row: usize| at(column, row) * (1.0 - x.fract()) + at(column + 1, row) * x.fract();
        pixel + along(row) * (1.0 - y.fract()) + along(row + 1) * y.fract()
    }
}

/// Sums over pairs.
#[derive(Default)]
struct Sums {
    squares: f64,
    decibels: f64,
}

/// One row of the table; `against` holds a folder for each sequence with displacement fields by number of the frame.
///
/// # Errors
/// If the frames cannot be solved or a field cannot be read.
pub fn row(footage: &Footage, against: Option<&Path>) -> Result<String> {
    let settings = product::settings(footage.settings(), Delay::True, Estimator::Continuous, 4);
    let solutions = product::solve(footage, settings)?;
    let corrections = product::corrections(solutions);
    let worst = displacement::worst_above_input(&footage.truth, &corrections);
    let whole = displacement::left(&footage.truth, &corrections);

    let [mut input, mut ours, mut theirs] = [Sums::default(), Sums::default(), Sums::default()];
    let mut pairs = 0.0;
    for first in (0..footage.frames.len().saturating_sub(1)).step_by(EVERY) {
        let second = first + 1;
        let solution = second_of(footage, first, settings)?;
        judge(footage, second, &|pixel| pixel, &mut input);
        judge(footage, second, &move |pixel| product::corrected(&solution, pixel), &mut ours);
        if let Some(folder) = against {
            let path = folder.join(&footage.settings().name).join(format!("{second:04}.displacement"));
            let field =
                DisplacementField::read(&path, [footage.settings().width, footage.settings().height])?;
            judge(footage, second, &move |pixel| field.moved(pixel), &mut theirs);
        }
        pairs += 1.0;
    }
    let share = |sums: &Sums| 100.0 * (sums.squares / input.squares).sqrt();
    let told = |text: String| if against.is_some() { text } else { "–".into() };
    let all = footage.uncorrected();
    Ok(format!(
        "| {} | {:.2} | {:.1} % | {worst:+.2} | {:.2} | {:.1} % | {} | {:.2} | {:.2} | {} |",
        footage.settings().name,
        all.rms,
        100.0 * whole.rms / all.rms,
        (input.squares / pairs).sqrt(),
        share(&ours),
        told(format!("{:.1} %", share(&theirs))),
        input.decibels / pairs,
        ours.decibels / pairs,
        told(format!("{:.2}", theirs.decibels / pairs)),
    ))
}

/// The motion of the second of two frames.
fn second_of(
    footage: &Footage,
    first: usize,
    settings: rsrectify::rectifier::Settings,
) -> Result<FrameSolution> {
    let (width, height) = (footage.settings().width, footage.settings().height);
    let period = Some(1.0 / footage.settings().delivered_fps());
    let mut rectifier = Rectifier::new(settings, width, height, period)?;
    let range = first..first + 2;
    let pair = footage.frames[range.clone()].iter().zip(footage.stamps[range].iter().copied());
    let solutions = product::motions(&mut rectifier, pair)?;
    solutions.into_iter().last().context("two frames were pushed and none given out")
}

/// Displacement that is left of a frame, RMS in pixels.
fn left(footage: &Footage, index: usize, correction: &dyn Fn(Vector2<f64>) -> Vector2<f64>) -> f64 {
    Stats::of(distances(&footage.truth[index].samples, correction).collect()).rms
}

fn judge(footage: &Footage, index: usize, correction: &dyn Correction, sums: &mut Sums) {
    let (frame, truth) = (&footage.frames[index], &footage.truth[index]);
    let left = left(footage, index, &|pixel| correction.correct(pixel));
    sums.squares += left * left;
    let inner = |at: usize, length: usize| {
        (at as f64 + 0.5 - 0.5 * length as f64).abs() < 0.5 * INNER * length as f64
    };
    let Some(global) = &truth.global else { return };
    let mask: Vec<bool> = (0..frame.width * frame.height)
        .map(|k| {
            global.visible[k] && inner(k % frame.width, frame.width) && inner(k / frame.width, frame.height)
        })
        .collect();
    sums.decibels += psnr(&rectified(frame, correction).frame, &global.picture, &mask).unwrap_or(0.0);
}

#[cfg(test)]
mod tests {
    use super::*;
    use render::sequence::{Settings, named};

    #[test]
    fn a_field_is_read_and_interpolated() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("field");
        let values = [1.0f32, 0.0, 3.0, 0.0, 1.0, 4.0, 3.0, 4.0];
        fs::write(&path, values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>()).unwrap();
        let field = DisplacementField::read(&path, [2, 2]).unwrap();
        assert_eq!(field.moved(Vector2::new(0.5, 0.25)), Vector2::new(2.5, 1.25));
        assert_eq!(field.moved(Vector2::new(9.0, 9.0)), Vector2::new(12.0, 13.0));
        assert!(DisplacementField::read(&path, [3, 2]).is_err());
    }

    #[test]
    fn a_pair_is_better_than_it_came_and_the_truth_wins() {
        let settings = Settings { width: 160, height: 120, frames: 2, ..named("rot1_B40").unwrap() };
        let footage = Footage::of_settings(&settings).unwrap();
        let row = row(&footage, None).unwrap();
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        assert_eq!((cells[1], cells[7], cells.len()), ("rot1_B40", "–", 12));
        let number = |cell: usize| cells[cell].trim_end_matches(" %").parse::<f64>().unwrap();
        assert!(number(6) < 30.0 && number(9) > number(8) + 3.0, "{row}");
    }
}
