// SPDX-License-Identifier: MIT OR Apache-2.0

//! How far the library's dense flow is from the exact one, and how long it takes.

use crate::speed::median_ms;
use anyhow::Result;
use baselines::correspondences::GRID;
use nalgebra::Vector2;
use render::footage::Footage;
use render::scene::Frame;
use render::truth::Capture;
use rsrectify::correspond::{Correspondence, Sampler};
use rsrectify::flow::DenseFlow;
use rsrectify::plane::{Luma, Plane, PlaneLayout, SampleFormat};
use rsrectify::pyramid::{Pyramid, Reducer};
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

/// From this confidence on a displacement counts as trusted.
const TRUSTED: f64 = 0.5;

/// The heading of the rows that [`row`] writes.
pub const HEADING: &str = "| sequence | flow error px: median | p90 | trusted | of these: median | p90 | wrong by > 2 px \
    | pyramid ms: fastest | both directions ms: fastest | median |\n|---|---|---|---|---|---|---|---|---|---|";

/// What was measured of a sequence.
#[derive(Clone, Debug, Default)]
pub struct Measured {
    /// Distance of each point's displacement from the truth in pixels, and the confidence stated.
    pub errors: Vec<(f64, f64)>,
    /// Time of each frame's pyramid.
    pub pyramids: Vec<Duration>,
    /// Time of each pair's flow, both directions.
    pub flows: Vec<Duration>,
}

/// The heading of the rows that [`points_row`] writes.
pub const POINTS_HEADING: &str = "| sequence | sampled from flow: points | error px: median | p90 | > 1 px \
    | normalised variance | beyond 5 σ | all: fastest ms |\n|---|---|---|---|---|---|---|---|";

/// Errors of correspondences against the truth.
#[derive(Clone, Debug, Default)]
struct Points {
    /// Distance from the truth in pixels.
    errors: Vec<f64>,
    /// eᵀ·C⁻¹·e, C the covariance stated.
    squares: Vec<f64>,
    /// How many were found, with or without truth.
    found: usize,
}

impl Points {
    fn add(&mut self, pair: [Capture<'_>; 2], point: &Correspondence) {
        self.found += 1;
        let Some(truth) = pair[0].seen_by(&pair[1], point.from) else { return };
        let error = point.to - truth;
        self.errors.push(error.norm());
        if let Some(inverse) = point.covariance.try_inverse() {
            self.squares.push(error.dot(&(inverse * error)));
        }
    }

    fn cells(&mut self, pairs: usize) -> String {
        let wrong = self.errors.iter().filter(|error| **error > 1.0).count() as f64;
        let wrong = wrong / self.errors.len().max(1) as f64;
        format!(
            " {} | {:.3} | {:.3} | {:.1} % |",
            self.found / pairs.max(1),
            quantile(&mut self.errors, 0.5),
            quantile(&mut self.errors, 0.9),
            100.0 * wrong
        )
    }
}

/// One row of the table of correspondences.
///
/// The normalised variance is the median of eᵀ·C⁻¹·e over that of χ² with two degrees of freedom, so that outliers
/// have no say.
///
/// # Errors
/// If the frames have no pixels.
pub fn points_row(footage: &Footage) -> Result<String> {
    /// Median of χ² with two degrees of freedom: 2·ln 2.
    const MEDIAN: f64 = 2.0 * std::f64::consts::LN_2;
    let settings = footage.settings();
    let mut sampler = Sampler::new(settings.width, settings.height, GRID[0], GRID[1]);
    let (mut sampled, mut pairs) = (Points::default(), 0);
    let (mut fastest, mut measurements) = (Duration::MAX, Vec::new());
    for run in footage.runs() {
        let mut before: Option<(usize, Pyramid)> = None;
        for index in run {
            let frame = &footage.frames[index];
            let luma = frame.luma();
            let layout = PlaneLayout::packed(frame.width, frame.height, SampleFormat::U8);
            let mut now = Pyramid::new();
            sampler.build(&Luma::from(Plane::new(&luma, layout)?), &mut now);
            if let Some((first, before)) = &before {
                let pair = [footage.capture(*first), footage.capture(index)];
                let started = Instant::now();
                sampler.correspond(before, &now, |point| point, &mut measurements);
                fastest = fastest.min(started.elapsed());
                for found in &measurements {
                    sampled.add(pair, found);
                }
                pairs += 1;
            }
            before = Some((index, now));
        }
    }
    let far = sampled.squares.iter().filter(|square| **square > 25.0).count() as f64;
    let far = far / sampled.squares.len().max(1) as f64;
    Ok(format!(
        "| {} |{} {:.2} | {:.1} % | {:.2} |",
        settings.name,
        sampled.cells(pairs),
        quantile(&mut sampled.squares, 0.5) / MEDIAN,
        100.0 * far,
        fastest.as_secs_f64() * 1e3,
    ))
}

/// The error that `share` of some errors do not exceed; not a number for none.
pub fn quantile(errors: &mut [f64], share: f64) -> f64 {
    if errors.is_empty() {
        return f64::NAN;
    }
    let rank = ((share * errors.len() as f64) as usize).min(errors.len() - 1);
    *errors.select_nth_unstable_by(rank, f64::total_cmp).1
}

/// The pyramid of a frame, and the time it took.
///
/// # Errors
/// If the frame has no pixels.
pub fn pyramid(reducer: &Reducer, frame: &Frame) -> Result<(Pyramid, Duration)> {
    let luma = frame.luma();
    let layout = PlaneLayout::packed(frame.width, frame.height, SampleFormat::U8);
    let mut pyramid = Pyramid::new();
    let plane = Luma::from(Plane::new(&luma, layout)?);
    let started = Instant::now();
    reducer.build(&plane, &mut pyramid);
    Ok((pyramid, started.elapsed()))
}

/// Measures the flow between successive frames, forward, without a prediction.
///
/// # Errors
/// If the frames have no pixels.
pub fn measure(footage: &Footage) -> Result<Measured> {
    let settings = footage.settings();
    let reducer = Reducer::new(settings.width, settings.height);
    let mut flow = DenseFlow::new(&reducer);
    let mut measured = Measured::default();
    for run in footage.runs() {
        let mut before: Option<(usize, Pyramid)> = None;
        for index in run {
            let (now, time) = pyramid(&reducer, &footage.frames[index])?;
            measured.pyramids.push(time);
            if let Some((first, before)) = &before {
                let started = Instant::now();
                flow.estimate(before, &now, |point: Vector2<f64>| point);
                measured.flows.push(started.elapsed());
                measured.errors.extend(errors(footage, *first, &flow));
            }
            before = Some((index, now));
        }
    }
    Ok(measured)
}

/// Writes frames and the exact flow between successive ones for other programs: `0000.pgm` and so on, and for each pair
/// `0000_0001.truth` with lines of x, y and the displacement in x and y, in pixels.
///
/// # Errors
/// If the files cannot be written.
pub fn export(footage: &Footage, folder: &Path) -> Result<()> {
    fs::create_dir_all(folder)?;
    let readout = footage.readout();
    let ratio = readout.time() * footage.settings().delivered_fps();
    fs::write(folder.join("readout.txt"), format!("{ratio} {:?}\n", readout.direction()))?;
    for run in footage.runs() {
        for index in &run {
            let frame = &footage.frames[*index];
            let header = format!("P5 {} {} 255\n", frame.width, frame.height);
            fs::write(folder.join(format!("{index:04}.pgm")), [header.as_bytes(), &frame.luma()].concat())?;
        }
        for pair in run.windows(2) {
            let lines = truth(footage, pair[0]);
            let lines = lines.map(|(pixel, [u, v])| format!("{} {} {u} {v}\n", pixel.x, pixel.y));
            fs::write(
                folder.join(format!("{:04}_{:04}.truth", pair[0], pair[1])),
                lines.collect::<String>(),
            )?;
        }
    }
    Ok(())
}

/// The points of a frame with truth, and where the next frame of the run sees them.
fn truth(footage: &Footage, index: usize) -> impl Iterator<Item = (Vector2<f64>, [f32; 2])> {
    footage.truth[index].forward.iter().flat_map(|map| {
        map.values.iter().enumerate().filter_map(|(index, value)| Some((map.pixel(index), (*value)?)))
    })
}

fn errors<'a>(
    footage: &'a Footage,
    index: usize,
    flow: &'a DenseFlow,
) -> impl Iterator<Item = (f64, f64)> + 'a {
    truth(footage, index).filter_map(|(pixel, [u, v])| {
        let ([x, y], confidence) = flow.forward().sample(pixel.x, pixel.y)?;
        Some(((x - f64::from(u)).hypot(y - f64::from(v)), confidence))
    })
}

/// One row of the table.
///
/// # Errors
/// Those of [`measure`].
pub fn row(footage: &Footage) -> Result<String> {
    let measured = measure(footage)?;
    let mut all: Vec<f64> = measured.errors.iter().map(|(error, _)| *error).collect();
    let trusted = measured.errors.iter().filter(|(_, confidence)| *confidence >= TRUSTED);
    let mut trusted: Vec<f64> = trusted.map(|(error, _)| *error).collect();
    let share = trusted.len() as f64 / all.len().max(1) as f64;
    let wrong = trusted.iter().filter(|error| **error > 2.0).count() as f64 / trusted.len().max(1) as f64;
    let fastest = |times: &[Duration]| times.iter().min().map_or(f64::NAN, |time| time.as_secs_f64() * 1e3);
    Ok(format!(
        "| {} | {:.2} | {:.2} | {:.1} % | {:.2} | {:.2} | {:.2} % | {:.2} | {:.2} | {:.2} |",
        footage.settings().name,
        quantile(&mut all, 0.5),
        quantile(&mut all, 0.9),
        100.0 * share,
        quantile(&mut trusted, 0.5),
        quantile(&mut trusted, 0.9),
        100.0 * wrong,
        fastest(&measured.pyramids),
        fastest(&measured.flows),
        median_ms(measured.flows.iter().copied()),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use render::footage::STEP;
    use render::sequence::named;

    #[test]
    fn quantiles_are_those_of_the_sorted_errors() {
        let mut errors = [3.0, 1.0, 2.0, 5.0, 4.0];
        assert_eq!((quantile(&mut errors, 0.5), quantile(&mut errors, 0.9)), (3.0, 5.0));
        assert!(quantile(&mut [], 0.5).is_nan());
    }

    #[test]
    fn a_small_sequence_is_measured_at_every_point_with_truth() {
        let settings =
            render::sequence::Settings { width: 160, height: 120, frames: 3, ..named("hand_g08").unwrap() };
        let footage = Footage::of_settings(&settings).unwrap();
        let measured = measure(&footage).unwrap();
        let points = (160 / STEP) * (120 / STEP);
        assert_eq!((measured.pyramids.len(), measured.flows.len()), (3, 2));
        assert!(measured.errors.len() > points && measured.errors.len() <= 2 * points);
        let mut errors: Vec<f64> = measured.errors.iter().map(|(error, _)| *error).collect();
        assert!(quantile(&mut errors, 0.5) < 1.0);
    }
}
