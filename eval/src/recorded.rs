// SPDX-License-Identifier: MIT OR Apache-2.0

//! Measurements of a sequence, recorded once, from which estimators are run: all see the same correspondences and flow.

use crate::systems::product::{self, Delay};
use anyhow::{Context, Result};
use baselines::methods::Corrections;
use render::footage::Footage;
use rsrectify::correspond::{Correspondence, Pyramid, Sampler};
use rsrectify::flow::FlowField;
use rsrectify::motion::FrameMotion;
use rsrectify::plane::{Luma, Plane, PlaneLayout, SampleFormat};
use rsrectify::readout::Readout;
use rsrectify::rectifier::{self, Settings};
use rsrectify::solve::continuous::Continuous;
use rsrectify::solve::residual::LocalMotions;
use std::ops::Range;

/// What was measured between a frame and the next.
struct Pair {
    grid: Vec<Correspondence>,
    flow: [FlowField; 2],
}

/// The measurements of successive frames.
pub struct Recording {
    size: [usize; 2],
    pixel_scale: f64,
    period: f64,
    /// Seconds.
    stamps: Vec<f64>,
    /// Mean square of the gradient of each frame.
    sharpness: Vec<f64>,
    pairs: Vec<Pair>,
}

/// A frame as an estimator sees it.
pub struct Estimate {
    /// Its motion; `None` where nothing is known of it.
    pub motion: Option<FrameMotion>,
    /// The shutter as far as it is known.
    pub readout: Readout,
    /// Standard deviation that is stated of the readout ratio.
    pub readout_deviation: f64,
    /// Error that is expected of the rectified frame in pixels.
    pub expected: Option<f64>,
}

impl Recording {
    /// Measures a sequence, with the true readout known, which predicts where points go.
    ///
    /// # Errors
    /// If a frame is not of the sequence's size.
    pub fn of(footage: &Footage) -> Result<Self> {
        let settings = footage.settings();
        let (width, height) = (settings.width, settings.height);
        let told = product::settings(settings, Delay::True, rectifier::Estimator::Continuous, 0);
        let mut sampler = Sampler::new(width, height, told.grid_columns, told.grid_rows);
        let pixel_scale = sampler.pixel_scale();
        let period = 1.0 / settings.delivered_fps();
        let mut recording = Self {
            size: [width, height],
            pixel_scale,
            period,
            stamps: footage.stamps.clone(),
            sharpness: Vec::new(),
            pairs: Vec::new(),
        };
        let mut estimator = recording.estimator(&told);
        let (mut before, mut now) = (Pyramid::default(), Pyramid::default());
        for (frame, stamp) in footage.frames.iter().zip(&footage.stamps) {
            let luma = frame.luma();
            let layout = PlaneLayout::packed(width, height, SampleFormat::U8);
            sampler.build(&Luma::from(Plane::new(&luma, layout)?), &mut now);
            let pair = (!before.is_empty()).then(|| {
                let mut grid = Vec::new();
                sampler.correspond(&before, &now, |pixel| estimator.path.expected(pixel), &mut grid);
                let flow = sampler.flow();
                Pair { grid, flow: [flow.forward().clone(), flow.backward().clone()] }
            });
            let sharpness = sampler.sharpness(&now);
            estimator.push(pair.as_ref(), *stamp, period, sharpness);
            estimator.settle();
            recording.sharpness.push(sharpness);
            recording.pairs.extend(pair);
            std::mem::swap(&mut before, &mut now);
        }
        Ok(recording)
    }

    fn estimator(&self, settings: &Settings) -> Estimator {
        let path = Continuous::new(settings.into(), self.size[0], self.size[1], self.pixel_scale);
        Estimator { path, local: LocalMotions::default() }
    }

    /// Estimates the motion of some of the frames, as if there were no others.
    ///
    /// # Errors
    /// If there are too few.
    pub fn estimate(&self, frames: Range<usize>, settings: &Settings) -> Result<Vec<Estimate>> {
        let mut estimator = self.estimator(settings);
        let mut estimates = Vec::new();
        for index in frames.clone() {
            let frame = self.stamps.get(index).zip(self.sharpness.get(index));
            let (stamp, sharpness) = frame.context("too few frames were recorded")?;
            let pair = index.checked_sub(1).filter(|before| *before >= frames.start);
            let pair = pair.and_then(|before| self.pairs.get(before));
            estimator.push(pair, *stamp, self.period, *sharpness);
            if index - frames.start >= settings.lookahead {
                estimates.push(estimator.settle());
            }
        }
        while estimates.len() < frames.len() {
            estimates.push(estimator.settle());
        }
        Ok(estimates)
    }
}

/// The continuous estimator of the path, and that of the motions beside it.
struct Estimator {
    path: Continuous,
    local: LocalMotions,
}

impl Estimator {
    fn push(&mut self, pair: Option<&Pair>, stamp: f64, period: f64, sharpness: f64) {
        self.path.push(pair.map(|pair| pair.grid.as_slice()), stamp, period, sharpness);
        self.local.push(pair.map(|pair| pair.flow.each_ref()));
    }

    fn settle(&mut self) -> Estimate {
        let solution = self.path.settle(&mut self.local);
        let (readout, readout_deviation) = self.path.belief();
        let expected = solution.as_ref().and_then(|solution| solution.expected_error);
        Estimate { motion: solution.map(|solution| solution.motion), readout, readout_deviation, expected }
    }
}

/// The corrections that estimates stand for.
pub fn corrections(estimates: Vec<Estimate>) -> Corrections {
    let correction = |estimate: Estimate| -> Box<dyn baselines::methods::Correction> {
        match estimate.motion {
            Some(motion) => Box::new(move |pixel| product::carried(&motion, pixel)),
            None => Box::new(|pixel| pixel),
        }
    };
    estimates.into_iter().map(correction).collect()
}
