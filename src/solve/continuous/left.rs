//! What a path leaves of a pair.

use super::flow::Flow;
use super::pair::{Match, Pair, Reading};
use super::path::SplinePath;
use crate::motion::generators::{TURNS, fields};
use crate::solve::median::{MEDIAN_TO_VARIANCE, median};
use nalgebra::Vector2;

/// What a pair is held against.
pub(super) struct View<'a> {
    pub path: &'a SplinePath,
    pub flow: &'a Flow,
    pub reading: Reading,
    /// Blocks to a frame period.
    pub tempo: f64,
    /// Signed readout time in frame periods.
    pub readout: f64,
    /// Pixels to the unit of points.
    pub radius: f64,
    /// Least standard deviation of a coordinate in pixels.
    pub noise: f64,
    /// Whether what goes its own way in the pair is left out.
    pub scene_alone: bool,
}

/// A match as the path sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leg {
    pub m: Match,
    /// Blocks at which both ends are exposed.
    pub times: [f64; 2],
    /// What the path leaves of it, in pixels.
    pub residual: Vector2<f64>,
    /// What the generators other than the turns move it by, in pixels: at twice the inverse depth, so much again.
    pub parallax: Vector2<f64>,
}

/// What the path leaves of a pair.
#[derive(Clone, Debug, Default)]
pub(super) struct Left {
    /// Match by match.
    pub legs: Vec<Leg>,
    /// The matches of the pair before that they continue.
    pub before: Vec<Option<Leg>>,
    /// Standard deviation of a coordinate of the residuals in pixels, by their median.
    pub sigma: f64,
    /// Correspondences within three of them.
    pub inliers: usize,
    squares: Vec<f64>,
}

impl View<'_> {
    /// Blocks at which both ends of a match are exposed.
    pub fn times(&self, stamps: [f64; 2], m: &Match) -> [f64; 2] {
        let places = [self.reading.place(m.from), self.reading.place(m.to)];
        [0, 1].map(|end| self.tempo * (stamps[end] + self.readout * places[end]))
    }

    fn leg(&self, stamps: [f64; 2], m: &Match) -> Leg {
        let times = self.times(stamps, m);
        let [from, to] = times;
        let fields = fields((m.from + m.to) / 2.0, self.path.kappa);
        let moved = self.flow.values(to) - self.flow.values(from);
        Leg {
            m: *m,
            times,
            residual: (m.to - self.flow.carry(m.from, from, to)) * self.radius,
            parallax: (TURNS..moved.len()).map(|j| fields.column(j) * moved[j]).sum(),
        }
    }

    /// Follows the path along a pair, and along the tracks that it continues if that is wanted.
    pub fn left(&self, pair: &Pair, tracks: bool, out: &mut Left) {
        out.legs.clear();
        out.before.clear();
        for (m, track) in pair.followed(self.scene_alone) {
            out.legs.push(self.leg(pair.stamps, m));
            out.before.push(track.filter(|_| tracks).map(|track| self.leg(track.stamps, &track.before)));
        }
        out.squares.clear();
        out.squares.extend(out.legs.iter().map(|leg| leg.residual.norm_squared()));
        let variance = (median(&mut out.squares) * MEDIAN_TO_VARIANCE).max(self.noise * self.noise);
        out.sigma = variance.sqrt();
        let near = out.squares.iter().filter(|square| **square < 2.0 * 9.0 * variance).count();
        out.inliers = near * pair.count() / pair.matches.len().max(1);
    }
}
