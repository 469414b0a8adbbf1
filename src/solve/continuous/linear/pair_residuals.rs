// SPDX-License-Identifier: MIT OR Apache-2.0

//! The residuals of a pair.

use super::residual::{Evaluator, MatchResidual};
use crate::cpu::for_each_cpu;
use crate::lanes::dispatch::with_cpu;
use crate::lanes::{Cpu, DoubleCpu};
use crate::robust::median::{weighted_median, weighted_variance_of};
use crate::solve::continuous::data::{FramePair, ScanAxis};
use nalgebra::Vector2;

/// Rounds of the fixed-point iteration for the variance.
const ROUNDS: usize = 4;
/// Fewest matches of a band that count.
const MIN_BAND_MATCHES: f64 = 4.0;
/// |r|² of an inlier over the variance of a coordinate: three standard deviations in two coordinates.
pub const INLIER_SQUARE: f64 = 2.0 * 9.0;

/// The residuals of a pair.
#[derive(Clone, Debug, Default)]
pub struct PairResiduals {
    pub matches: Vec<MatchResidual>,
    /// For each, that of the match it continues in the pair before, if both are needed to estimate parallax.
    pub before: Vec<Option<MatchResidual>>,
    /// Standard deviation of a coordinate in pixels, by the median, without the errors of measurement.
    pub sigma: f64,
    /// The outliers' variance in px²: of a coordinate of matches that do not show the scene, as far as points move.
    pub others: f64,
    /// Correspondences within three standard deviations.
    pub inliers: usize,
    /// Median squared coordinate in px² of the displacements by generators other than the turns; `None` where
    /// there are too few tracks or the residuals are noise.
    pub parallax: Option<f64>,
    squares: Vec<(f64, f64)>,
}

impl PairResiduals {
    /// Variance of a coordinate without the errors of measurement, at least `least`: the fixed point of σ² =
    /// median(|r|²·σ²/(σ² + s²))/(2·ln 2), s² the variance of the match.
    fn variance(&mut self, least: f64) -> f64 {
        let mut variance = f64::INFINITY;
        for _ in 0..ROUNDS {
            let share = |m: &MatchResidual| (1.0 + 0.5 * m.measured.covariance.trace() / variance).recip();
            self.squares.clear();
            self.squares.extend(self.matches.iter().map(|m| (m.residual.norm_squared() * share(m), m.prior)));
            variance = weighted_variance_of(&mut self.squares).max(least);
        }
        variance
    }

    /// Share of the residuals' square sum, 0 to 1, that is a shift and slope common to the matches of a line.
    /// A motion faster than the path is common to all that is exposed at the same time; parallax and moving
    /// objects are not. Measured: 0.8 to 0.98 in vibrations, 0 to 0.2 along the wrong axis; mostly below 0.7 under parallax, but up to
    /// 0.9 in single pairs where depth varies along the scan axis.
    pub fn share_by_line(&self, scan_axis: ScanAxis) -> f64 {
        let mut bands: [LineBand; ScanAxis::LINE_BANDS] = Default::default();
        let most = INLIER_SQUARE * self.sigma * self.sigma;
        for m in self.matches.iter().filter(|m| m.residual.norm_squared() < most) {
            let from = m.measured.from;
            bands[scan_axis.line_band(from)].add(scan_axis.across(from), m.residual);
        }
        let shared: f64 = bands.iter().map(LineBand::shared).sum();
        let all: f64 = bands.iter().map(|band| band.square).sum();
        if all > 0.0 { (shared / all).clamp(0.0, 1.0) } else { 0.0 }
    }
}

/// Sums over the residuals r of a band of lines, at positions a along them.
#[derive(Default)]
struct LineBand {
    count: f64,
    /// Σa and Σa².
    along: [f64; 2],
    /// Σr and Σa·r.
    sums: [Vector2<f64>; 2],
    /// Σ|r|².
    square: f64,
}

impl LineBand {
    fn add(&mut self, along: f64, residual: Vector2<f64>) {
        self.count += 1.0;
        self.along[0] += along;
        self.along[1] += along * along;
        self.sums[0] += residual;
        self.sums[1] += residual * along;
        self.square += residual.norm_squared();
    }

    /// The part of Σ|r|² that a linear regression on a explains, less that of chance: two residuals.
    fn shared(&self) -> f64 {
        if self.count < MIN_BAND_MATCHES {
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

/// Median squared coordinate in px² of the parallax of matches with a track; `None` where fewer than half
/// have one, or where the variance of the residuals beyond noise, `excess` in px², is not positive. Residuals
/// beyond any parallax count as noise of the innovation. (To count all as noise as soon as they were four
/// times as large made fits jump between two states, and those that began in the wrong one never left it.)
pub fn parallax<'a, T>(
    residuals: impl Iterator<Item = (&'a MatchResidual, Option<T>)>,
    excess: f64,
    squares: &mut Vec<(f64, f64)>,
) -> Option<f64> {
    if excess <= 0.0 {
        return None;
    }
    let mut count = 0;
    let linked = residuals.inspect(|_| count += 1).filter_map(|(m, track)| track.map(|_| m));
    squares.clear();
    squares.extend(linked.map(|m| (m.parallax.norm_squared(), m.prior)));
    let known = 2 * squares.len() >= count && !squares.is_empty();
    let parallax = (weighted_median(squares) / 2.0).max(f64::MIN_POSITIVE);
    known.then_some(parallax)
}

// Loops, not chains of iterators, whose functions the compiler may leave outside, without wide vectors.
for_each_cpu! {
    fn whiten(residuals: &mut [MatchResidual], variance: f64) {
        for m in residuals {
            m.whiten(variance);
        }
    }
}

impl Evaluator<'_> {
    /// Computes the residuals of a pair, and those of the pair before if `tracks` and there may be parallax.
    pub fn residuals(&self, pair: &FramePair, tracks: bool, out: &mut PairResiduals) {
        with_cpu!(self.cpu, cpu => cpu.vectorize(#[inline(always)] || self.find(cpu, pair, out)));
        let least = self.noise * self.noise;
        let variance = out.variance(least);
        out.sigma = variance.sqrt();
        out.others = variance + 0.5 * pair.moved() * self.trajectory.radius * self.trajectory.radius;
        whiten(self.cpu, &mut out.matches, variance);
        let near =
            out.matches.iter().filter(|m| m.residual.norm_squared() < INLIER_SQUARE * variance).count();
        out.inliers = near * pair.count() / pair.matches.len().max(1);
        let tracks = pair.tracks.iter().map(|track| track.as_ref().filter(|_| tracks));
        out.parallax = parallax(out.matches.iter().zip(tracks), variance - least, &mut out.squares);
        if out.parallax.is_some() {
            self.residuals_before(pair, out);
        } else {
            out.before.clear();
            out.before.resize(out.matches.len(), None);
        }
    }

    /// Computes the residuals of the tracks that a pair continues.
    pub fn residuals_before(&self, pair: &FramePair, out: &mut PairResiduals) {
        with_cpu!(self.cpu, cpu => cpu.vectorize(#[inline(always)] || self.find_before(cpu, pair, out)));
    }

    #[inline(always)]
    fn find<C: DoubleCpu>(&self, cpu: C, pair: &FramePair, out: &mut PairResiduals) {
        out.matches.clear();
        out.matches.reserve(pair.matches.len());
        for (m, prior) in pair.matches.iter().zip(&pair.prior) {
            if let Some(found) = self.match_residual(cpu, pair.stamps, m, *prior) {
                out.matches.push(found);
            }
        }
    }

    #[inline(always)]
    fn find_before<C: DoubleCpu>(&self, cpu: C, pair: &FramePair, out: &mut PairResiduals) {
        let variance = out.sigma * out.sigma;
        out.before.clear();
        out.before.resize(pair.tracks.len(), None);
        for (before, track) in out.before.iter_mut().zip(&pair.tracks) {
            if let Some(track) = track
                && let Some(mut found) = self.match_residual(cpu, track.stamps, &track.before, 1.0)
            {
                found.whiten(variance);
                *before = Some(found);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::continuous::data::Match;
    use crate::solve::random::Random;
    use nalgebra::Matrix2;

    /// Given residuals of a grid of points.
    fn residuals(residual: impl FnMut(Vector2<f64>) -> Vector2<f64>) -> PairResiduals {
        let points =
            (0..384).map(|k| Vector2::new((k % 24) as f64 / 12.0 - 0.96, (k / 24) as f64 / 11.0 - 0.68));
        let mut residual = residual;
        let one = |from| MatchResidual {
            measured: Match { from, to: from, covariance: Matrix2::zeros() },
            prior: 1.0,
            blocks: [0.0; 2],
            residual: residual(from),
            parallax: Vector2::zeros(),
            by_gamma: [Vector2::zeros(); 2],
            by_kappa: Vector2::zeros(),
            whitening: Matrix2::identity(),
        };
        PairResiduals { matches: points.map(one).collect(), sigma: 1.0, ..PairResiduals::default() }
    }

    const ROWS: ScanAxis = ScanAxis { by_rows: true, length: 1.5 };
    const COLUMNS: ScanAxis = ScanAxis { by_rows: false, length: 2.0 };

    #[test]
    fn the_variance_is_without_the_errors_of_measurement() {
        // Two thirds of the matches are measured with σ = 0.5 px, the others exactly; the path is off by 0.2
        // px.
        let mut random = Random(8);
        let mut residuals = residuals(|_| Vector2::zeros());
        for (index, m) in residuals.matches.iter_mut().enumerate() {
            let deviation = if index % 3 == 0 { 0.0 } else { 0.5 };
            m.measured.covariance = Matrix2::identity() * (deviation * deviation);
            let spread = deviation.hypot(0.2);
            m.residual = Vector2::new(random.normal(), random.normal()) * spread;
        }
        let found = residuals.variance(1e-4).sqrt();
        assert!((0.16..0.24).contains(&found), "{found}");
        residuals.matches.iter_mut().for_each(|m| m.residual = Vector2::zeros());
        assert_eq!(residuals.variance(1e-4), 1e-4);
    }

    #[test]
    fn a_vibration_is_common_to_lines_across_the_scan_axis() {
        // A shift and a roll, twice to and fro while the rows are read.
        let vibrating = residuals(|at| Vector2::new((9.0 * at.y).sin(), at.x * (9.0 * at.y).cos()));
        assert!(vibrating.share_by_line(ROWS) > 0.9, "{}", vibrating.share_by_line(ROWS));
        assert!(vibrating.share_by_line(COLUMNS) < 0.3, "{}", vibrating.share_by_line(COLUMNS));
    }

    #[test]
    fn noise_and_moving_objects_are_common_to_no_line() {
        let mut random = Random(3);
        let noise = residuals(|_| Vector2::new(random.normal(), random.normal()) * 0.5);
        assert!(noise.share_by_line(ROWS) < 0.15, "{}", noise.share_by_line(ROWS));
        let thing = residuals(|at| Vector2::new(f64::from(u8::from(at.norm() < 0.4)), 0.0));
        assert!(thing.share_by_line(ROWS) < 0.5, "{}", thing.share_by_line(ROWS));
        assert_eq!(residuals(|_| Vector2::zeros()).share_by_line(ROWS), 0.0);
        assert_eq!(PairResiduals::default().share_by_line(ROWS), 0.0);
    }
}
