// SPDX-License-Identifier: MIT OR Apache-2.0

//! The solvers on correspondences that no sampler would measure.

use super::input::{DIRECTIONS, readout, real, settings, small};
use arbitrary::{Result, Unstructured};
use nalgebra::{Matrix2, Vector2};
use rsrectify::correspond::Correspondence;
use rsrectify::flow::{Cell, FlowField};
use rsrectify::motion::{Twist, image_centre};
use rsrectify::readout::Readout;
use rsrectify::solve::continuous::Continuous;
use rsrectify::solve::residual::{FrameFlow, LocalMotions, ResidualSolver, Still};
use rsrectify::solve::sequential::link::{FitBuffers, KnownFrame};
use rsrectify::solve::{FrameSolution, Link, Window};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
/// Frames in a window, at most.
const FRAMES: usize = 14;
/// Deviation of a measured coordinate in pixels.
const NOISE: f64 = 0.1;

/// Not a number, infinities, duplicates, points on a line or in one place: no solver panics, and no motion that one
/// gives out is anything but finite.
pub fn check(data: &[u8]) {
    let mut u = Unstructured::new(data);
    // Bytes that end make the rest of a case its defaults; they are no failure.
    let _ = window(&mut u);
}

fn window(u: &mut Unstructured<'_>) -> Result<()> {
    let settings = settings(u)?;
    let mut continuous = Continuous::new((&settings).into(), WIDTH, HEIGHT, 1.0);
    let mut local = LocalMotions::default();
    let mut sequential = Window::default();
    let mut residual = ResidualSolver::default();
    let direction = *u.choose(&DIRECTIONS)?;
    let (mut time, mut waiting) = (0.0, 0);
    for _ in 0..FRAMES {
        let pair = measured(u)?;
        let fields = [flow(u)?, flow(u)?];
        let period = if u.ratio(1, 8)? { small(u, 10.0)?.abs().max(1e-6) } else { 0.04 };
        let interval = if u.ratio(1, 4)? { real(u, 0.3)? } else { 0.04 };
        time += interval;
        let readout = readout([WIDTH, HEIGHT], direction, settings.readout_time, period);

        let is_joined = !u.ratio(1, 8)?;
        let sharpness = small(u, 1e4)?;
        continuous.push(is_joined.then_some(pair.as_slice()), time, period, sharpness);
        local.push(is_joined.then_some(fields.each_ref()));
        waiting += 1;
        let expected = continuous.expected(Vector2::new(small(u, 640.0)?, small(u, 480.0)?));
        assert!(expected.iter().all(|coordinate| coordinate.is_finite()), "{expected}");
        while waiting > settings.lookahead {
            continuous.settle(&mut local).iter().for_each(verify);
            waiting -= 1;
        }

        one_pair(u, &pair, &readout, interval)?;
        sequential.push(Some(Link::new(&pair, &readout, interval, NOISE)));
        if u.arbitrary()? {
            let settled = sequential.settle();
            assert!(settled.is_none_or(|settled| settled.fit.twist.is_finite()), "{settled:?}");
        }

        let [there, back] = &fields;
        let flows = [FrameFlow { field: there, interval }, FrameFlow { field: back, interval: -interval }];
        let cells = residual.solve(&readout, &flows, &Still);
        assert!(cells.velocities.iter().flatten().all(|velocity| velocity.is_finite()));
        let regions = residual.regions();
        assert!(regions.iter().all(|region| region.error >= 0.0), "{regions:?}");
        if u.ratio(1, 16)? {
            continuous.restart();
            local.restart();
            sequential.reset();
            waiting = 0;
        }
        if u.is_empty() {
            break;
        }
    }
    for _ in 0..waiting {
        continuous.settle(&mut local).iter().for_each(verify);
    }
    Ok(())
}

fn one_pair(
    u: &mut Unstructured<'_>,
    pair: &[Correspondence],
    readout: &Readout,
    interval: f64,
) -> Result<()> {
    let (link, mut scratch) = (Link::new(pair, readout, interval, NOISE), FitBuffers::default());
    let known = Twist::new(real(u, 1.0)?, real(u, 100.0)?, real(u, 100.0)?);
    let uniform = link.uniform(&mut scratch);
    let stepped =
        [KnownFrame::First, KnownFrame::Second].map(|side| link.sequential_step(side, known, &mut scratch));
    for fit in stepped.into_iter().chain([uniform]).flatten() {
        assert!(fit.twist.is_finite() && fit.energy.is_finite() && fit.energy >= 0.0, "{fit:?}");
        assert!((0.0..=1.0).contains(&fit.confidence) && fit.inliers <= fit.correspondences, "{fit:?}");
    }
    Ok(())
}

fn verify(solution: &FrameSolution) {
    let FrameSolution { motion, confidence, correspondences, inliers, residual, readout_deviation, .. } =
        solution;
    for share in [0.0, 0.3, 1.0] {
        let moved = motion.path().carry(Vector2::new(100.0, -80.0), share, 0.5);
        assert!(moved.iter().all(|coordinate| coordinate.is_finite()), "{motion:?}");
    }
    assert!((0.0..=1.0).contains(confidence), "{confidence}");
    assert!(residual.is_finite() && *residual >= 0.0, "{residual}");
    let readout = motion.readout();
    assert!(readout.time().is_finite() && readout.time() >= 0.0, "{readout:?}");
    assert!(readout_deviation.is_finite() && *readout_deviation >= 0.0, "{readout_deviation}");
    assert!(inliers <= correspondences, "{inliers} of {correspondences}");
}

/// A few large cells, some of which say nonsense; none now and then.
fn flow(u: &mut Unstructured<'_>) -> Result<FlowField> {
    if !u.ratio(1, 4)? {
        return Ok(FlowField::default());
    }
    let broken = u.ratio(1, 2)?;
    let cell = |u: &mut Unstructured<'_>| -> Result<Cell> {
        let number = |u: &mut Unstructured<'_>| -> Result<f32> {
            Ok(if broken { real(u, 100.0)? as f32 } else { small(u, 20.0)? as f32 })
        };
        let flow = [number(u)?, number(u)?];
        let (a, b) = (number(u)?.abs(), number(u)?.abs());
        Ok(Cell {
            flow,
            confidence: f32::from(u.arbitrary::<u8>()?) / 255.0,
            information: [a, 0.5 * a.min(b), b],
        })
    };
    let cells = (0..12).map(|_| cell(u)).collect::<Result<Vec<_>>>()?;
    Ok(FlowField::new(4, 160.0, cells).unwrap_or_default())
}

/// Correspondences of a motion, some of them broken, or all in one place or on a line.
fn measured(u: &mut Unstructured<'_>) -> Result<Vec<Correspondence>> {
    let count = u.int_in_range(0..=80usize)?;
    let twist = Twist::new(small(u, 2.0)?, small(u, 900.0)?, small(u, 900.0)?).after(0.04);
    let centre = image_centre(WIDTH, HEIGHT);
    let shape = u.int_in_range(0..=7u8)?;
    let broken = u.ratio(1, 2)?;
    let mut pair = Vec::with_capacity(count);
    for index in 0..count {
        let along = index as f64 / count as f64;
        let from = match shape {
            // All in one place, on a line, on a row, on a column; otherwise scattered.
            0 => Vector2::new(100.0, 100.0),
            1 => Vector2::new(640.0 * along, 480.0 * along),
            2 => Vector2::new(640.0 * along, 200.0),
            3 => Vector2::new(300.0, 480.0 * along),
            _ => Vector2::new((index * 167 % 640) as f64, (index * 211 % 480) as f64),
        };
        let to = twist.apply(from - centre) + centre;
        let covariance = Matrix2::identity() * if u.ratio(1, 4)? { real(u, 4.0)? } else { 0.01 };
        let mut found = Correspondence { from, to, texture: 50.0, residual: 1.0, covariance };
        if broken && u.ratio(1, 4)? {
            match u.int_in_range(0..=6u8)? {
                0 => found.from.x = real(u, 700.0)?,
                1 => found.from.y = real(u, 500.0)?,
                2 => found.to.x = real(u, 700.0)?,
                3 => found.to.y = real(u, 500.0)?,
                4 => found.texture = real(u, 100.0)? as f32,
                5 => found.covariance[u.int_in_range(0..=3usize)?] = real(u, 10.0)?,
                _ => found.residual = real(u, 100.0)? as f32,
            }
        }
        pair.push(found);
    }
    Ok(pair)
}
