// SPDX-License-Identifier: MIT OR Apache-2.0

//! Exact places of far points in successive frames, and how unsteady they are in what a system shows of these frames.

use crate::metrics::wobble;
use baselines::methods::Correction;
use nalgebra::{Matrix2, Vector2};
use render::stats::Stats;
use render::truth::Capture;
use rsrectify::correspond::Correspondence;
use rsrectify::readout::Readout;

/// Points are taken every so many pixels.
pub(super) const STEP: usize = 12;
/// Fewer points of a frame than these tell neither its wobble to the next one nor its distortion.
pub(super) const LEAST_POINTS: usize = 40;

/// A point that three successive frames see, each at a place of its own in pixels.
#[derive(Clone, Copy, Debug)]
struct Seen {
    frames: [usize; 3],
    places: [Vector2<f64>; 3],
}

/// Places of far points in frames.
#[derive(Clone, Debug, Default)]
pub struct Tracks {
    seen: Vec<Seen>,
}

/// The least distance of far points, and these: those that lie at least as far away as the median one, given with their distances.
pub(super) fn far<T>(mut points: Vec<(f64, T)>) -> (f64, impl Iterator<Item = T>) {
    points.sort_by(|a, b| b.0.total_cmp(&a.0));
    // Of points at one distance, all are far.
    let least = 0.999 * points.get(points.len() / 2).map_or(0.0, |point| point.0);
    let far = points.into_iter().take_while(move |point| point.0 >= least);
    (least, far.map(|(_, point)| point))
}

/// How unsteady what is shown is, RMS in pixels.
#[derive(Clone, Copy, Debug)]
pub struct Steadiness {
    /// Second difference of the places of far points.
    pub jitter: f64,
    /// What rows of far points are displaced by from frame to frame beside the motion of the picture.
    pub wobble: f64,
}

impl Tracks {
    /// Adds the points of successive frames, given with their indices, that lie at least as far away as the median one of their
    /// frame.
    pub fn add(&mut self, run: &[(usize, Capture<'_>)]) {
        for frames in run.windows(3) {
            let [_, (_, own), _] = frames else { continue };
            let [columns, rows] = own.places(STEP);
            let pixels = rows.iter().flat_map(|y| columns.iter().map(|x| Vector2::new(*x as f64, *y as f64)));
            let points = pixels.filter_map(|pixel| Some((own.distance(pixel)?, pixel)));
            self.add_points(frames, far(points.collect()).1);
        }
    }

    /// Adds these points of the second of three successive frames.
    pub fn add_points(
        &mut self,
        frames: &[(usize, Capture<'_>)],
        pixels: impl IntoIterator<Item = Vector2<f64>>,
    ) {
        let [(first, before), (middle, own), (last, after)] = frames else { return };
        self.seen.extend(pixels.into_iter().filter_map(|pixel| {
            let places = [own.seen_by(before, pixel)?, pixel, own.seen_by(after, pixel)?];
            Some(Seen { frames: [*first, *middle, *last], places })
        }));
    }

    /// How steady they are in the output of a system, given where it shows the pixels of each frame.
    pub fn steadiness(&self, shown: &[Box<dyn Correction>], readout: &Readout) -> Steadiness {
        let place = |seen: &Seen, index: usize| shown[seen.frames[index]].correct(seen.places[index]);
        let jitter =
            self.seen.iter().map(|seen| (place(seen, 2) - place(seen, 1) * 2.0 + place(seen, 0)).norm());
        let wobble = self.seen.chunk_by(|a, b| a.frames == b.frames).filter_map(|seen| {
            let pair = |seen: &Seen| Correspondence {
                from: place(seen, 1),
                to: place(seen, 2),
                texture: 1.0,
                residual: 0.0,
                covariance: Matrix2::zeros(),
            };
            let pairs: Vec<_> = seen.iter().map(pair).collect();
            (pairs.len() >= LEAST_POINTS).then(|| wobble::between(&pairs, readout))?
        });
        Steadiness { jitter: Stats::of(jitter.collect()).rms, wobble: Stats::of(wobble.collect()).rms }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.seen.is_empty()
    }
}
