// SPDX-License-Identifier: MIT OR Apache-2.0

//! One pair of frames: its matches, and the tracks that they continue.

use super::dominant::DominantMotion;
use super::matches::Match;
use crate::correspond::Correspondence;
use crate::robust::motion::Quadratic;
use crate::solve::pairs::{MAX_INTERVAL, MIN_MATCHES};
use nalgebra::Vector2;

/// Prior probability of the scene for an inlier of the dominant motion, and of an object for an outlier.
const SCENE_PRIOR: f64 = 0.9;
/// More matches than this are thinned out.
const MAX_MATCHES: usize = 400;
/// A pair counts as at most this many independent matches, as residuals of neighbours are correlated.
pub const INDEPENDENT_MATCHES: f64 = 25.0;
/// Points further from the centre, in radii, are invalid.
const MAX_COORDINATE: f64 = 1e3;
/// Greatest distance between the ends of matches that a track joins, in mean spacings of points.
const TRACK_DISTANCE: f64 = 0.8;
/// Timestamps beyond this many frame periods do not resolve lines.
const MAX_STAMP: f64 = 1e12;

/// Whether frames with these timestamps are near enough to make a pair.
fn are_near([first, second]: [f64; 2]) -> bool {
    (second - first).abs() <= MAX_INTERVAL && first.abs() < MAX_STAMP
}

/// A match of the pair before that ends about where a match of this pair begins.
#[derive(Clone, Copy, Debug)]
pub struct Track {
    pub before: Match,
    /// Timestamps of that pair in frame periods.
    pub stamps: [f64; 2],
    /// Whether `before` shared the dominant motion.
    pub is_dominant: bool,
}

/// Matches of a pair and the timestamps of its frames in frame periods.
#[derive(Clone, Debug)]
pub struct FramePair {
    pub matches: Vec<Match>,
    /// The track that each match continues, if any.
    pub tracks: Vec<Option<Track>>,
    /// Prior probability of each match to show the scene, not a moving object.
    pub prior: Vec<f64>,
    pub stamps: [f64; 2],
    /// Number of correspondences that were measured, overlays included.
    pub measured: usize,
    dominant: DominantMotion,
    /// Valid matches before thinning, sorted by `to.y`.
    found: Vec<Match>,
}

impl FramePair {
    /// From correspondences in pixels; `None` if they are too few or the frames too far apart.
    pub fn new(
        found: &[Correspondence],
        centre: Vector2<f64>,
        radius: f64,
        stamps: [f64; 2],
        before: Option<&Self>,
    ) -> Option<Self> {
        let measured = found.len();
        let point = |pixel: Vector2<f64>| (pixel - centre) / radius;
        let valid = |found: &Correspondence| {
            let m = Match { from: point(found.from), to: point(found.to), covariance: found.covariance };
            let is_near = m.from.iter().chain(&m.to).all(|coordinate| coordinate.abs() < MAX_COORDINATE);
            (is_near && m.covariance.iter().all(|element| element.is_finite())).then_some(m)
        };
        let mut found: Vec<Match> = found.iter().filter_map(valid).collect();
        if found.len() < MIN_MATCHES || !are_near(stamps) {
            return None;
        }
        let matches: Vec<Match> = found.iter().copied().step_by(found.len().div_ceil(MAX_MATCHES)).collect();
        let tracks = before.map_or_else(|| vec![None; matches.len()], |before| before.continued(&matches));
        let eligible: Vec<bool> =
            tracks.iter().map(|track| track.as_ref().is_none_or(|track| track.is_dominant)).collect();
        let dominant = DominantMotion::of(&matches, &eligible);
        let prior = |m: &Match| if dominant.is_inlier(m) { SCENE_PRIOR } else { 1.0 - SCENE_PRIOR };
        let prior = matches.iter().map(prior).collect();
        found.sort_by(|a, b| a.to.y.total_cmp(&b.to.y));
        Some(Self { tracks, matches, prior, stamps, measured, dominant, found })
    }

    /// For each match of the next pair, the nearest match that ends where it begins.
    fn continued(&self, next: &[Match]) -> Vec<Option<Track>> {
        let limit = TRACK_DISTANCE * self.spacing();
        let nearest = |from: Vector2<f64>| {
            let first = self.found.partition_point(|m| m.to.y < from.y - limit);
            let near = self.found.iter().skip(first).take_while(|m| m.to.y <= from.y + limit);
            let (mut found, mut least) = (None, limit * limit);
            for m in near {
                let distance = (m.to - from).norm_squared();
                if distance < least {
                    (found, least) = (Some(m), distance);
                }
            }
            found.map(|m: &Match| Track {
                before: *m,
                stamps: self.stamps,
                is_dominant: self.dominant.is_inlier(m),
            })
        };
        next.iter().map(|m| nearest(m.from)).collect()
    }

    /// Mean spacing of the end points in radii.
    fn spacing(&self) -> f64 {
        let none = [f64::INFINITY, f64::NEG_INFINITY].map(Vector2::repeat);
        let [low, high] = self.found.iter().fold(none, |[low, high], m| [low.inf(&m.to), high.sup(&m.to)]);
        let area = (high - low).x * (high - low).y;
        if area.is_finite() { (area / self.found.len() as f64).sqrt() } else { 0.0 }
    }

    /// The pair in frame periods shorter by `factor`; `None` if its frames are then too far apart.
    pub fn scale_time(mut self, factor: f64) -> Option<Self> {
        let tracks = self.tracks.iter_mut().flatten().map(|track| &mut track.stamps);
        tracks.chain([&mut self.stamps]).flatten().for_each(|stamp| *stamp *= factor);
        are_near(self.stamps).then_some(self)
    }

    /// The pair with its frames at other times, those of the pair before at `before`.
    pub fn at(mut self, stamps: [f64; 2], before: Option<[f64; 2]>) -> Option<Self> {
        self.stamps = stamps;
        if let Some(before) = before {
            self.tracks.iter_mut().flatten().for_each(|track| track.stamps = before);
        }
        are_near(stamps).then_some(self)
    }

    /// The displacement that most matches share, in radii.
    pub fn dominant_motion(&self) -> Quadratic {
        self.dominant.motion
    }

    /// Number of valid matches before thinning.
    pub fn count(&self) -> usize {
        self.found.len()
    }

    /// First and last exposure of either frame, in frame periods.
    pub fn span(&self, gamma: f64) -> [f64; 2] {
        let [a, b] = self.stamps;
        [a.min(b) + gamma.min(0.0), a.max(b) + gamma.max(0.0)]
    }

    /// Mean squared displacement of the matches, in squared radii.
    pub fn moved(&self) -> f64 {
        let squares: f64 = self.matches.iter().map(|m| m.displacement().norm_squared()).sum();
        squares / self.matches.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix2;

    /// A row of points ten pixels apart that move down by 100.
    fn row(first: [f64; 2], stamps: [f64; 2], before: Option<&FramePair>) -> FramePair {
        let at = |k: usize| Vector2::new(first[0] + 10.0 * (k % 5) as f64, first[1] + 10.0 * (k / 5) as f64);
        let found: Vec<Correspondence> = (0..20)
            .map(|k| {
                let to = at(k) + Vector2::new(0.0, 100.0);
                Correspondence { from: at(k), to, texture: 1.0, residual: 0.0, covariance: Matrix2::zeros() }
            })
            .collect();
        FramePair::new(&found, Vector2::zeros(), 10.0, stamps, before).unwrap()
    }

    #[test]
    fn a_match_continues_the_nearest_that_ends_where_it_begins() {
        let before = row([0.0, 0.0], [0.0, 1.0], None);
        // Two and three pixels beside the end points, the last column and row beyond them.
        let now = row([12.0, 113.0], [1.0, 2.0], Some(&before));
        for (m, track) in now.matches.iter().zip(&now.tracks) {
            let arrived = (m.from - Vector2::new(0.2, 0.3)).map(|coordinate| coordinate.round());
            let is_there = arrived.x <= 4.0 && arrived.y <= 13.0;
            assert_eq!(track.is_some(), is_there, "{m:?}");
            if let Some(track) = track {
                assert!((track.before.to - arrived).norm() < 1e-9 && track.stamps == [0.0, 1.0], "{track:?}");
            }
        }
        let far = row([900.0, 0.0], [0.0, 1.0], None);
        assert!(row([12.0, 113.0], [1.0, 2.0], Some(&far)).tracks.iter().all(Option::is_none));
    }
}
