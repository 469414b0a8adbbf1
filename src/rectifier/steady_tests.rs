// SPDX-License-Identifier: MIT OR Apache-2.0

//! Stabilisation of pictures whose motion is known in closed form.

use super::film::{HEIGHT, PERIOD, WIDTH, pops, push, texture};
use super::*;
use crate::plane::{Plane, PlaneLayout, PlaneMut, SampleFormat};
use crate::readout::{ReadoutDirection, ReadoutTime};
use crate::warp::{BorderMode, Fill, SampleGrid, WarpSettings, Warper, least_zoom};
use nalgebra::Vector2;
use std::f64::consts::TAU;

const FRAMES: usize = 70;
const MARGIN: f64 = 0.08;

/// Where the picture has moved to, in pixels: a shake of up to 9 px at 2.2 and 4.1 cycles a second.
fn place(t: f64) -> Vector2<f64> {
    let swing = |cycles: f64, phase: f64| (TAU * cycles * t + phase).sin();
    Vector2::new(7.0 * swing(2.2, 0.3) + 2.0 * swing(4.1, 1.0), 6.0 * swing(2.7, 2.0))
}

/// A frame of the shaken picture, read top to bottom over a whole period; never black.
fn shaken(k: usize) -> Vec<u8> {
    let pixels = (0..HEIGHT).flat_map(|row| (0..WIDTH).map(move |column| (row, column)));
    let value = |(row, column): (usize, usize)| {
        let exposed = (k as f64 + (row as f64 + 0.5) / HEIGHT as f64) * PERIOD;
        let at = Vector2::new(column as f64, row as f64) - place(exposed);
        texture(at.x, at.y).round().clamp(60.0, 255.0) as u8
    };
    pixels.map(value).collect()
}

fn rectifier(stabilization: f64, lookahead: usize) -> Rectifier {
    let settings = Settings {
        lookahead,
        direction: Some(ReadoutDirection::TopToBottom),
        readout_time: ReadoutTime::WholePeriod,
        stabilization,
        margin: MARGIN,
        ..Settings::default()
    };
    Rectifier::new(settings, WIDTH, HEIGHT, Some(PERIOD)).unwrap()
}

fn solved(rectifier: &mut Rectifier, frames: &[Vec<u8>]) -> Vec<FrameSolution> {
    let mut solutions = Vec::new();
    for (k, frame) in frames.iter().enumerate() {
        push(rectifier, frame, k as f64 * PERIOD, Duplicate::Detect);
        solutions.extend(pops(rectifier));
    }
    rectifier.drain();
    solutions.extend(pops(rectifier));
    solutions
}

/// Second differences, RMS from frame 10 on, of where the output shows the point that is at the centre without shake.
fn jitter(solutions: &[FrameSolution]) -> f64 {
    let shown = |(k, solution): (usize, &FrameSolution)| {
        let seen = place((k as f64 + 0.5) * PERIOD);
        let placed = solution.motion.placement().map(|placement| placement * seen.push(1.0));
        placed.map_or(seen, |placed| placed.xy() / placed.z)
    };
    let places: Vec<Vector2<f64>> = solutions.iter().enumerate().map(shown).collect();
    let seconds = places[10..FRAMES - 10].windows(3).map(|p| (p[0] - p[1] * 2.0 + p[2]).norm_squared());
    (seconds.sum::<f64>() / (FRAMES - 22) as f64).sqrt()
}

#[test]
fn a_shaken_picture_is_steady_and_shows_no_border() {
    let frames: Vec<Vec<u8>> = (0..FRAMES).map(shaken).collect();
    let still = jitter(&solved(&mut rectifier(0.0, 4), &frames));
    let settings = WarpSettings {
        border: BorderMode::Constant(Fill::default()),
        zoom: 1.0 / (1.0 - 2.0 * MARGIN),
        ..WarpSettings::default()
    };
    let mut warper = Warper::new();
    for (lookahead, share) in [(40, 0.05), (4, 0.5)] {
        let solutions = solved(&mut rectifier(0.4, lookahead), &frames);
        assert_eq!(solutions.len(), FRAMES);
        let steady = jitter(&solutions);
        assert!(steady < share * still, "lookahead {lookahead}: {steady} of {still} px");
        for (k, (solution, frame)) in solutions.iter().zip(&frames).enumerate() {
            assert!(least_zoom(&solution.motion, &settings) < settings.zoom + 0.02, "frame {k}");
            let layout = PlaneLayout::packed(WIDTH, HEIGHT, SampleFormat::U8);
            let mut out = vec![0; frame.len()];
            let mut target = PlaneMut::new(&mut out, layout).unwrap();
            let source = Plane::new(frame, layout).unwrap();
            let prepared = warper.prepare(&solution.motion, &settings);
            prepared.warp(&source, &mut target, SampleGrid::FULL).unwrap();
            // Cubic interpolation may undershoot, but not to black.
            assert!(out.iter().all(|value| *value > 5), "frame {k} shows its border");
        }
    }
}

#[test]
fn frames_wait_for_the_lookahead_and_no_longer() {
    let frames: Vec<Vec<u8>> = (0..30).map(shaken).collect();
    let mut rectifier = rectifier(0.3, 20);
    for (k, frame) in frames.iter().enumerate() {
        push(&mut rectifier, frame, k as f64 * PERIOD, Duplicate::Detect);
        assert_eq!(pops(&mut rectifier).len(), usize::from(k >= 20), "frame {k}");
    }
    assert!(rectifier.pop_early().is_some());
    rectifier.drain();
    assert_eq!(pops(&mut rectifier).len(), 19);
    // Discarded frames come out no more, and the next stretch begins anew.
    push(&mut rectifier, &frames[0], 9.0, Duplicate::Detect);
    rectifier.reset();
    push(&mut rectifier, &frames[1], 10.0, Duplicate::Detect);
    rectifier.drain();
    assert_eq!(pops(&mut rectifier).len(), 1);
}

#[test]
fn stabilisation_that_is_switched_on_does_not_jump() {
    let frames: Vec<Vec<u8>> = (0..FRAMES).map(shaken).collect();
    let mut rectifier = rectifier(0.0, 8);
    let mut solutions = Vec::new();
    for (k, frame) in frames.iter().enumerate() {
        match k {
            20 => rectifier.set_stabilization(0.3, MARGIN),
            40 => rectifier.set_stabilization(0.0, MARGIN),
            _ => {}
        }
        push(&mut rectifier, frame, k as f64 * PERIOD, Duplicate::Detect);
        solutions.extend(pops(&mut rectifier));
    }
    let offset = |solution: &FrameSolution| {
        solution.motion.placement().map_or(Vector2::zeros(), |placement| placement.column(2).xy())
    };
    let step =
        solutions.windows(2).map(|pair| (offset(&pair[1]) - offset(&pair[0])).norm()).fold(0.0, f64::max);
    let motion = |k: usize| (place((k as f64 + 1.5) * PERIOD) - place((k as f64 + 0.5) * PERIOD)).norm();
    let most = (0..FRAMES).map(motion).fold(0.0, f64::max);
    assert!(step < 1.1 * most, "a step of {step} px where the picture moves by {most}");
    assert!(solutions.iter().take(12).all(|solution| solution.motion.placement().is_none()));
    assert!(offset(&solutions[30]).norm() > 0.1);
}
