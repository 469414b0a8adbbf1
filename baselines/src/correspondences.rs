// SPDX-License-Identifier: MIT OR Apache-2.0

//! Where the correspondences come from that every method is given.

use crate::flow::image::Image;
use crate::flow::{Prepared, points};
use anyhow::Result;
use nalgebra::Matrix2;
use render::footage::Footage;
use render::scene::Frame;
use render::truth::Capture;
use rsrectify::correspond::{Correspondence, Pyramid, Sampler, certain};
use rsrectify::plane::{Luma, Plane, PlaneLayout, SampleFormat};
use serde::{Deserialize, Serialize};

/// Columns and rows of the sampling grid.
pub const GRID: [usize; 2] = [32, 24];

/// Texture given to exact correspondences: as good as a patch of full contrast.
const EXACT_TEXTURE: f32 = 1000.0;

/// Where correspondences come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Source {
    /// The library's own sampler.
    Sampler,
    /// Dense optical flow, at the centres of the grid's cells.
    Flow,
    /// The truth: without error, so that what is left is the model's.
    Exact,
}

/// The correspondences from each frame of a run to the one after it.
pub fn of_run(footage: &Footage, run: &[usize], source: Source) -> Result<Vec<Vec<Correspondence>>> {
    match source {
        Source::Sampler => sampled(footage, run),
        Source::Flow => Ok(flowed(footage, run)),
        Source::Exact => Ok(exact_of_run(footage, run)),
    }
}

fn exact_of_run(footage: &Footage, run: &[usize]) -> Vec<Vec<Correspondence>> {
    let capture = |index: usize| footage.capture(index);
    run.windows(2).map(|pair| exact(&capture(pair[0]), &capture(pair[1]), GRID)).collect()
}

/// The correspondences from a frame to another one of the same take, without error, at the centres of the cells of a grid
/// of so many columns and rows.
pub fn exact(frame: &Capture<'_>, next: &Capture<'_>, [columns, rows]: [usize; 2]) -> Vec<Correspondence> {
    let matches = frame.exact_matches(next, columns, rows).into_iter();
    matches
        .map(|found| Correspondence {
            from: found.from,
            to: found.to,
            texture: EXACT_TEXTURE,
            residual: 0.0,
            covariance: Matrix2::zeros(),
        })
        .collect()
}

fn sampled(footage: &Footage, run: &[usize]) -> Result<Vec<Vec<Correspondence>>> {
    let mut follower = Follower::new(footage.settings().width, footage.settings().height);
    let found = run.iter().map(|index| follower.follow(&footage.frames[*index]));
    found.filter_map(Result::transpose).collect()
}

/// Measures the correspondences of successive frames with the library's sampler.
pub struct Follower {
    size: [usize; 2],
    sampler: Sampler,
    before: Option<Pyramid>,
}

impl Follower {
    /// For frames of `width` × `height` pixels.
    pub fn new(width: usize, height: usize) -> Self {
        let sampler = Sampler::new(width, height, GRID[0], GRID[1]);
        Self { size: [width, height], sampler, before: None }
    }

    /// The correspondences from the frame before to this one; `None` for the first.
    ///
    /// # Errors
    /// If the frame is of another size.
    pub fn follow(&mut self, frame: &Frame) -> Result<Option<Vec<Correspondence>>> {
        let [width, height] = self.size;
        let luma = frame.luma();
        let plane = Plane::new(&luma, PlaneLayout::packed(width, height, SampleFormat::U8))?;
        let mut now = Pyramid::new();
        self.sampler.build(&Luma::from(plane), &mut now);
        let found = self.before.as_ref().map(|before| {
            let mut found = Vec::new();
            self.sampler.correspond(before, &now, |pixel| pixel, &mut found);
            let mut kept = Vec::with_capacity(found.len());
            certain(&found, self.sampler.pixel_scale(), &mut kept);
            kept
        });
        self.before = Some(now);
        Ok(found)
    }
}

fn flowed(footage: &Footage, run: &[usize]) -> Vec<Vec<Correspondence>> {
    let (width, height) = (footage.settings().width, footage.settings().height);
    let prepared = |index: usize| {
        let luma = footage.frames[index].luma();
        Prepared::new(Image::new(width, height, luma.into_iter().map(f32::from).collect()))
    };
    let mut pairs = Vec::with_capacity(run.len().saturating_sub(1));
    let mut before: Option<Prepared> = None;
    for index in run {
        let now = prepared(*index);
        if let Some(before) = &before {
            pairs.push(points::correspondences(before, &now, GRID));
        }
        before = Some(now);
    }
    pairs
}
