//! The residuals of a pair: what a path does not explain of its matches.

use super::residual::{Evaluator, Leg};
use crate::robust::median::{MEDIAN_TO_VARIANCE, weighted_median};
use crate::solve::continuous::data::{FramePair, ScanAxis, Track};
use nalgebra::Vector2;

/// Bands of lines in which residuals are alike if a motion is faster than the path.
const LINES: usize = 16;
/// Rounds in which errors of measurement are told from errors of the path.
const ROUNDS: usize = 4;
/// Matches that tell whether those of a line have anything in common.
const FEWEST: f64 = 4.0;

/// The residuals of a pair.
#[derive(Clone, Debug, Default)]
pub struct PairResiduals {
    /// Match by match.
    pub legs: Vec<Leg>,
    /// The matches of the pair before that they continue, where they are of use.
    pub before: Vec<Option<Leg>>,
    /// Standard deviation of a coordinate of the residuals in pixels, by their median.
    pub sigma: f64,
    /// Variance in px² of a coordinate of what does not show the scene.
    pub others: f64,
    /// Correspondences within three deviations.
    pub inliers: usize,
    /// Usual square of what the generators other than the turns move a coordinate by, in px²; `None` where
    /// that has no say.
    pub parallax: Option<f64>,
    squares: Vec<(f64, f64)>,
}

impl PairResiduals {
    /// Variance, at least `least`, of what the path leaves of a coordinate beside the errors of measurement: the fixed
    /// point of σ² = median over the matches of |r|²·σ²/(σ² + s²), s² their variance, as that of a normal distribution.
    fn misfit(&mut self, least: f64) -> f64 {
        let mut variance = f64::INFINITY;
        for _ in 0..ROUNDS {
            let share = |leg: &Leg| (1.0 + 0.5 * leg.m.covariance.trace() / variance).recip();
            self.squares.clear();
            self.squares
                .extend(self.legs.iter().map(|leg| (leg.residual.norm_squared() * share(leg), leg.prior)));
            variance = (weighted_median(&mut self.squares) * MEDIAN_TO_VARIANCE).max(least);
        }
        variance
    }

    /// Share of the residuals' square sum that is the same, or a turn, along a line of the sensor, 0 to 1: a motion faster
    /// than the path does the same to all that is exposed at the same time; depth, and things with motions of their
    /// own, do not. Measured: 0.94 to 0.97 where the camera vibrates, 0 along the wrong axis, up to 0.65 under parallax.
    pub fn share_by_line(&self, scan_axis: ScanAxis) -> f64 {
        let mut lines = vec![Line::default(); LINES];
        let most = 2.0 * 9.0 * self.sigma * self.sigma;
        for leg in self.legs.iter().filter(|leg| leg.residual.norm_squared() < most) {
            let place = (scan_axis.place(leg.m.from) * LINES as f64).clamp(0.0, (LINES - 1) as f64);
            let along = if scan_axis.by_rows { leg.m.from.x } else { leg.m.from.y };
            if let Some(line) = lines.get_mut(place as usize) {
                line.add(along, leg.residual);
            }
        }
        let [shared, all] = lines
            .iter()
            .map(|line| [line.shared(), line.square])
            .fold([0.0; 2], |sums, of| [sums[0] + of[0], sums[1] + of[1]]);
        if all > 0.0 { (shared / all).clamp(0.0, 1.0) } else { 0.0 }
    }
}

/// Residuals of matches that are exposed at about the same time.
#[derive(Clone, Default)]
struct Line {
    count: f64,
    /// Sums of where they are along the line, and of its square.
    along: [f64; 2],
    /// Sums of the residuals, and of those times where they are.
    sums: [Vector2<f64>; 2],
    square: f64,
}

impl Line {
    fn add(&mut self, along: f64, residual: Vector2<f64>) {
        self.count += 1.0;
        self.along[0] += along;
        self.along[1] += along * along;
        self.sums[0] += residual;
        self.sums[1] += residual * along;
        self.square += residual.norm_squared();
    }

    /// What a residual that changes linearly along the line explains of their square sum, less what it explains of as
    /// many that have nothing in common: two of them.
    fn shared(&self) -> f64 {
        if self.count < FEWEST {
            return 0.0;
        }
        let mean = self.sums[0] / self.count;
        let spread = self.along[1] - self.along[0] * self.along[0] / self.count;
        let slope = self.sums[1] - mean * self.along[0];
        let by_slope = if spread > 0.0 { slope.norm_squared() / spread } else { 0.0 };
        let explained = self.count * mean.norm_squared() + by_slope;
        explained - 2.0 * (self.square - explained) / (self.count - 2.0)
    }
}

/// Usual square of what the generators other than the turns move a coordinate of matches with a track by, in
/// px². `None` where few tracks are known or where the residuals have no variance beyond noise (`excess`, px²). Residuals
/// beyond what parallax can be stay in the innovation and count as noise: to take all for noise as soon as they were four
/// times as large made fits jump between two states, and those that began in the wrong one never left it.
pub fn parallax<'a, T>(
    legs: impl Iterator<Item = (&'a Leg, Option<T>)>,
    excess: f64,
    squares: &mut Vec<(f64, f64)>,
) -> Option<f64> {
    if excess <= 0.0 {
        return None;
    }
    let mut count = 0;
    let linked = legs.inspect(|_| count += 1).filter_map(|(leg, track)| track.map(|_| leg));
    squares.clear();
    squares.extend(linked.map(|leg| (leg.parallax.norm_squared(), leg.prior)));
    let known = 2 * squares.len() >= count && !squares.is_empty();
    let parallax = (weighted_median(squares) / 2.0).max(f64::MIN_POSITIVE);
    known.then_some(parallax)
}

impl Evaluator<'_> {
    /// Follows the path along a pair, and along the tracks that it continues if that is wanted and they may
    /// tell its parallax from its noise.
    pub fn residuals(&self, pair: &FramePair, tracks: bool, out: &mut PairResiduals) {
        out.legs.clear();
        let matches = pair.matches.iter().zip(&pair.prior);
        out.legs.extend(matches.filter_map(|(m, prior)| self.leg(pair.stamps, m, *prior)));
        let least = self.noise * self.noise;
        let variance = out.misfit(least);
        out.sigma = variance.sqrt();
        out.others = variance + 0.5 * pair.moved() * self.trajectory.radius * self.trajectory.radius;
        out.legs.iter_mut().for_each(|leg| leg.whiten(variance));
        let near = out.legs.iter().filter(|leg| leg.residual.norm_squared() < 2.0 * 9.0 * variance).count();
        out.inliers = near * pair.count() / pair.matches.len().max(1);
        let tracks = pair.tracks.iter().map(|track| track.as_ref().filter(|_| tracks));
        out.parallax = parallax(out.legs.iter().zip(tracks), variance - least, &mut out.squares);
        if out.parallax.is_some() {
            self.legs_before(pair, out);
        } else {
            out.before.clear();
            out.before.resize(out.legs.len(), None);
        }
    }

    /// Follows the path along the tracks that a pair continues.
    pub fn legs_before(&self, pair: &FramePair, out: &mut PairResiduals) {
        let variance = out.sigma * out.sigma;
        let leg = |track: &Track| {
            let mut leg = self.leg(track.stamps, &track.before, 1.0)?;
            leg.whiten(variance);
            Some(leg)
        };
        out.before.clear();
        out.before.extend(pair.tracks.iter().map(|track| track.as_ref().and_then(leg)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::continuous::data::Match;
    use crate::solve::random::Random;
    use nalgebra::Matrix2;

    /// What a path leaves of a grid of points, as it is given for each.
    fn residuals(residual: impl FnMut(Vector2<f64>) -> Vector2<f64>) -> PairResiduals {
        let points =
            (0..384).map(|k| Vector2::new((k % 24) as f64 / 12.0 - 0.96, (k / 24) as f64 / 11.0 - 0.68));
        let mut residual = residual;
        let leg = |from| Leg {
            m: Match { from, to: from, covariance: Matrix2::zeros() },
            prior: 1.0,
            times: [0.0; 2],
            residual: residual(from),
            parallax: Vector2::zeros(),
            by_readout: [Vector2::zeros(); 2],
            by_kappa: Vector2::zeros(),
            whitening: Matrix2::identity(),
        };
        PairResiduals { legs: points.map(leg).collect(), sigma: 1.0, ..PairResiduals::default() }
    }

    const ROWS: ScanAxis = ScanAxis { by_rows: true, length: 1.5 };
    const COLUMNS: ScanAxis = ScanAxis { by_rows: false, length: 2.0 };

    #[test]
    fn errors_of_measurement_are_told_from_what_the_path_leaves() {
        // Two thirds of the matches are measured with a deviation of 0.5 px, the others exactly; the path leaves 0.2 px.
        let mut random = Random(8);
        let mut residuals = residuals(|_| Vector2::zeros());
        for (index, leg) in residuals.legs.iter_mut().enumerate() {
            let deviation = if index % 3 == 0 { 0.0 } else { 0.5 };
            leg.m.covariance = Matrix2::identity() * (deviation * deviation);
            let spread = deviation.hypot(0.2);
            leg.residual = Vector2::new(random.normal(), random.normal()) * spread;
        }
        let found = residuals.misfit(1e-4).sqrt();
        assert!((0.16..0.24).contains(&found), "{found}");
        residuals.legs.iter_mut().for_each(|leg| leg.residual = Vector2::zeros());
        assert_eq!(residuals.misfit(1e-4), 1e-4);
    }

    #[test]
    fn a_vibration_is_common_to_the_lines_that_it_is_read_along() {
        // A shift and a roll, twice to and fro while the rows are read.
        let vibrating = residuals(|at| Vector2::new((9.0 * at.y).sin(), at.x * (9.0 * at.y).cos()));
        assert!(vibrating.share_by_line(ROWS) > 0.9, "{}", vibrating.share_by_line(ROWS));
        assert!(vibrating.share_by_line(COLUMNS) < 0.3, "{}", vibrating.share_by_line(COLUMNS));
    }

    #[test]
    fn noise_and_things_of_their_own_are_common_to_no_line() {
        let mut random = Random(3);
        let noise = residuals(|_| Vector2::new(random.normal(), random.normal()) * 0.5);
        assert!(noise.share_by_line(ROWS) < 0.15, "{}", noise.share_by_line(ROWS));
        let thing = residuals(|at| Vector2::new(f64::from(u8::from(at.norm() < 0.4)), 0.0));
        assert!(thing.share_by_line(ROWS) < 0.5, "{}", thing.share_by_line(ROWS));
        assert_eq!(residuals(|_| Vector2::zeros()).share_by_line(ROWS), 0.0);
        assert_eq!(PairResiduals::default().share_by_line(ROWS), 0.0);
    }
}
