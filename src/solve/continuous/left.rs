//! What a path leaves of a pair.

use super::flow::Flow;
use super::pair::{Match, Pair, Reading, Track};
use super::path::SplinePath;
use super::tracks;
use crate::motion::generators::{GENERATORS, TURNS, fields};
use crate::solve::median::{MEDIAN_TO_VARIANCE, median};
use nalgebra::{SVector, Vector2};

/// Generators other than the turns.
const OTHERS: usize = GENERATORS - TURNS;

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
    /// What a frame period of γ adds to what the turns move it by, and to what the others do.
    pub by_readout: [Vector2<f64>; 2],
    /// What κ adds to what the turns move it by.
    pub by_kappa: Vector2<f64>,
}

/// What the path leaves of a pair.
#[derive(Clone, Debug, Default)]
pub(super) struct Left {
    /// Match by match.
    pub legs: Vec<Leg>,
    /// The matches of the pair before that they continue, where they are of use.
    pub before: Vec<Option<Leg>>,
    /// Standard deviation of a coordinate of the residuals in pixels, by their median.
    pub sigma: f64,
    /// Correspondences within three of them.
    pub inliers: usize,
    /// Usual square of what the generators other than the turns move a coordinate by, in px²; `None` where
    /// that has no say.
    pub parallax: Option<f64>,
    squares: Vec<f64>,
}

impl View<'_> {
    /// Blocks at which both ends of a match are exposed.
    pub fn times(&self, stamps: [f64; 2], m: &Match) -> [f64; 2] {
        let places = [self.reading.place(m.from), self.reading.place(m.to)];
        [0, 1].map(|end| self.tempo * (stamps[end] + self.readout * places[end]))
    }

    fn leg(&self, stamps: [f64; 2], m: &Match) -> Option<Leg> {
        let times = self.times(stamps, m);
        let (from, to) = (self.flow.at(times[0])?, self.flow.at(times[1])?);
        let places = [m.from, m.to].map(|point| self.reading.place(point) * self.tempo);
        let (rates, values) = ([from.rates(), to.rates()], [from.values(), to.values()]);
        let rates =
            SVector::<f64, GENERATORS>::from_fn(|j, _| rates[1][j] * places[1] - rates[0][j] * places[0]);
        let moved = SVector::<f64, GENERATORS>::from_fn(|j, _| values[1][j] - values[0][j]);
        let middle = (m.from + m.to) / 2.0;
        let fields = fields(middle, self.path.kappa);
        let (turns, others) = (fields.fixed_columns::<TURNS>(0), fields.fixed_columns::<OTHERS>(TURNS));
        Some(Leg {
            m: *m,
            times,
            residual: (m.to - from.carry(m.from, to)) * self.radius,
            parallax: others * moved.fixed_rows::<OTHERS>(TURNS),
            by_readout: [turns * rates.fixed_rows::<TURNS>(0), others * rates.fixed_rows::<OTHERS>(TURNS)],
            by_kappa: middle * middle.dot(&moved.xy()),
        })
    }

    /// Follows the path along a pair, and along the tracks that it continues if that is wanted and they may
    /// tell its parallax from its noise.
    pub fn left(&self, pair: &Pair, tracks: bool, out: &mut Left) {
        out.legs.clear();
        let followed = || pair.followed(self.scene_alone);
        out.legs.extend(followed().filter_map(|(m, _)| self.leg(pair.stamps, m)));
        out.squares.clear();
        out.squares.extend(out.legs.iter().map(|leg| leg.residual.norm_squared()));
        let least = self.noise * self.noise;
        let variance = (median(&mut out.squares) * MEDIAN_TO_VARIANCE).max(least);
        out.sigma = variance.sqrt();
        let near = out.squares.iter().filter(|square| **square < 2.0 * 9.0 * variance).count();
        out.inliers = near * pair.count() / pair.matches.len().max(1);
        let tracks = followed().map(|(_, track)| track.filter(|_| tracks));
        out.parallax = tracks::parallax(out.legs.iter().zip(tracks), variance - least, &mut out.squares);
        if out.parallax.is_some() {
            self.legs_before(pair, out);
        } else {
            out.before.clear();
            out.before.resize(out.legs.len(), None);
        }
    }

    /// Follows the path along the tracks that a pair continues.
    pub fn legs_before(&self, pair: &Pair, out: &mut Left) {
        let leg = |track: &Track| self.leg(track.stamps, &track.before);
        out.before.clear();
        out.before.extend(pair.followed(self.scene_alone).map(|(_, track)| track.and_then(leg)));
    }
}
