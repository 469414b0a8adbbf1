//! One pair of frames: its correspondences, and the tracks that they continue.

use super::dominant::Dominant;
use super::matches::Match;
use crate::correspond::Correspondence;
use nalgebra::Vector2;

/// How probable it is that a match shows the scene if it shares the dominant motion, and that it does not if it does not.
const SCENE: f64 = 0.9;
/// More matches than this are thinned out.
const MOST_MATCHES: usize = 400;
/// Fewer say nothing.
const FEWEST_MATCHES: usize = 16;
/// No point that is further from the centre, in units of the radius, was measured.
const FARTHEST: f64 = 1e3;
/// A match continues one that arrives within so many times the usual distance of points.
const REACH: f64 = 0.8;
/// Frame periods from one frame of a pair to the other, at most: what the path does in a longer gap is
/// anyone's guess, and costs unknowns.
const LONGEST: f64 = 16.0;
/// Frame periods after which a timestamp no longer tells one line from the next.
const LATEST: f64 = 1e12;

/// Whether frames with these timestamps are near enough to make a pair.
fn are_near([first, second]: [f64; 2]) -> bool {
    (second - first).abs() <= LONGEST && first.abs() < LATEST
}

/// A match of the pair before that ends about where one sets out.
#[derive(Clone, Copy, Debug)]
pub struct Track {
    pub before: Match,
    /// Timestamps of that pair in frame periods.
    pub stamps: [f64; 2],
    /// Whether it shared the dominant motion.
    pub is_scene: bool,
}

/// Correspondences of a pair and the timestamps of its frames in frame periods.
#[derive(Clone, Debug)]
pub struct FramePair {
    pub matches: Vec<Match>,
    /// The track that each of them continues, where there is one.
    pub tracks: Vec<Option<Track>>,
    /// How probably each of them shows the scene, not something that moves on its own, before any path is known.
    pub scene: Vec<f64>,
    pub stamps: [f64; 2],
    /// Correspondences that were measured, those that the path does not stand for too.
    pub measured: usize,
    dominant: Dominant,
    /// Before they were thinned out, by the height at which they arrive.
    found: Vec<Match>,
}

impl FramePair {
    /// Takes the correspondences (pixels) of a pair that follows another one, if any; `None` where there are too few to
    /// say anything or the frames are too far apart.
    pub fn new(
        found: &[Correspondence],
        centre: Vector2<f64>,
        radius: f64,
        stamps: [f64; 2],
        before: Option<&Self>,
    ) -> Option<Self> {
        let measured = found.len();
        let point = |pixel: Vector2<f64>| (pixel - centre) / radius;
        let matches = found.iter().map(|found| Match {
            from: point(found.from),
            to: point(found.to),
            covariance: found.covariance,
        });
        let is_sound = |m: &Match| {
            let is_near = m.from.iter().chain(&m.to).all(|coordinate| coordinate.abs() < FARTHEST);
            is_near && m.covariance.iter().all(|element| element.is_finite())
        };
        let mut found: Vec<Match> = matches.filter(is_sound).collect();
        if found.len() < FEWEST_MATCHES || !are_near(stamps) {
            return None;
        }
        let matches: Vec<Match> = found.iter().copied().step_by(found.len().div_ceil(MOST_MATCHES)).collect();
        let tracks = before.map_or_else(|| vec![None; matches.len()], |before| before.continued(&matches));
        let votes: Vec<bool> = tracks.iter().map(|track| track.as_ref().is_none_or(|t| t.is_scene)).collect();
        let dominant = Dominant::of(&matches, &votes);
        let prior = |m: &Match| if dominant.holds(m) { SCENE } else { 1.0 - SCENE };
        let scene = matches.iter().map(prior).collect();
        found.sort_by(|a, b| a.to.y.total_cmp(&b.to.y));
        Some(Self { tracks, matches, scene, stamps, measured, dominant, found })
    }

    /// The tracks that matches of the next pair continue: to each the nearest that arrives where it sets out.
    fn continued(&self, next: &[Match]) -> Vec<Option<Track>> {
        let reach = REACH * self.spacing();
        let nearest = |from: Vector2<f64>| {
            let first = self.found.partition_point(|m| m.to.y < from.y - reach);
            let near = self.found.iter().skip(first).take_while(|m| m.to.y <= from.y + reach);
            let distances = near.map(|m| (m, (m.to - from).norm_squared()));
            let (m, distance) = distances.min_by(|a, b| a.1.total_cmp(&b.1))?;
            let track = Track { before: *m, stamps: self.stamps, is_scene: self.dominant.holds(m) };
            (distance < reach * reach).then_some(track)
        };
        next.iter().map(|m| nearest(m.from)).collect()
    }

    /// How far the points that were found are apart where they arrive.
    fn spacing(&self) -> f64 {
        let (low, high) =
            self.found.iter().fold(
                (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY)),
                |(low, high), m| (low.inf(&m.to), high.sup(&m.to)),
            );
        let area = (high - low).x * (high - low).y;
        if area.is_finite() { (area / self.found.len() as f64).sqrt() } else { 0.0 }
    }

    /// The same in frame periods that are shorter by `factor`; `None` where its frames are then too far apart.
    pub fn scale_time(mut self, factor: f64) -> Option<Self> {
        let tracks = self.tracks.iter_mut().flatten().map(|track| &mut track.stamps);
        tracks.chain([&mut self.stamps]).flatten().for_each(|stamp| *stamp *= factor);
        are_near(self.stamps).then_some(self)
    }

    /// Correspondences before they were thinned out.
    pub fn count(&self) -> usize {
        self.found.len()
    }

    /// First and last instant, in frame periods, at which a line of either frame is exposed.
    pub fn span(&self, readout: f64) -> [f64; 2] {
        let [a, b] = self.stamps;
        [a.min(b) + readout.min(0.0), a.max(b) + readout.max(0.0)]
    }

    /// Mean square distance by which matches moved, in squared units of the radius.
    pub fn moved(&self) -> f64 {
        let squares: f64 = self.matches.iter().map(|m| (m.to - m.from).norm_squared()).sum();
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
    fn a_match_continues_the_nearest_that_arrives_where_it_sets_out() {
        let before = row([0.0, 0.0], [0.0, 1.0], None);
        // Two and three pixels beside where the points arrive, the last column and row beyond them.
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
