//! The residuals of a pair: what a path does not explain of its matches.

use super::flow::Flow;
use super::pair::{Match, Pair, ScanAxis, Track};
use super::path::SplinePath;
use super::tracks;
use crate::cpu::CpuLevel;
use crate::motion::generators::{GENERATORS, TURNS, fields};
use crate::solve::median::{MEDIAN_TO_VARIANCE, weighted_median};
use nalgebra::{Matrix2, SVector, Vector2};

/// Generators other than the turns.
const OTHERS: usize = GENERATORS - TURNS;

/// Bands of lines in which residuals are alike if a motion is faster than the path.
const LINES: usize = 16;
/// Rounds in which errors of measurement are told from errors of the path.
const ROUNDS: usize = 4;
/// Matches that tell whether those of a line have anything in common.
const FEWEST: f64 = 4.0;

/// The estimate at which a pair is evaluated.
pub(super) struct View<'a> {
    pub cpu: CpuLevel,
    pub path: &'a SplinePath,
    pub flow: &'a Flow,
    pub scan_axis: ScanAxis,
    /// Blocks to a frame period.
    pub density: f64,
    /// Signed readout time in frame periods.
    pub readout: f64,
    /// Pixels to the unit of points.
    pub radius: f64,
    /// Least standard deviation of a coordinate in pixels.
    pub noise: f64,
}

/// A match as the path sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leg {
    pub m: Match,
    /// How probably it shows the scene, before its residual is known.
    pub prior: f64,
    /// Blocks at which both ends are exposed.
    pub times: [f64; 2],
    /// Its residual x′ − F(x) in pixels.
    pub residual: Vector2<f64>,
    /// What the generators other than the turns move it by, in pixels: at twice the inverse depth, so much again.
    pub parallax: Vector2<f64>,
    /// What a frame period of γ adds to what the turns move it by, and to what the others do.
    pub by_readout: [Vector2<f64>; 2],
    /// What κ adds to what the turns move it by.
    pub by_kappa: Vector2<f64>,
    /// What all of these have been multiplied by.
    pub whitening: Matrix2<f64>,
}

impl Leg {
    /// Makes it as uncertain as a residual of this variance is by itself: W = (I + C/σ²)^(−½), C the covariance of its
    /// match.
    fn whiten(&mut self, variance: f64) {
        let whitening = inverse_root(Matrix2::identity() + self.m.covariance / variance);
        self.whitening = whitening;
        for vector in [&mut self.residual, &mut self.parallax, &mut self.by_kappa]
            .into_iter()
            .chain(&mut self.by_readout)
        {
            *vector = whitening * *vector;
        }
    }
}

/// A^(−½) of a positive definite matrix: √A = (A + √|A|·I)/√(tr A + 2·√|A|).
fn inverse_root(matrix: Matrix2<f64>) -> Matrix2<f64> {
    let root = matrix.determinant().max(0.0).sqrt();
    let length = (matrix.trace() + 2.0 * root).sqrt();
    let inverse = (matrix + Matrix2::identity() * root).try_inverse().map(|inverse| inverse * length);
    inverse.filter(|inverse| inverse.iter().all(|value| value.is_finite())).unwrap_or_else(Matrix2::identity)
}

/// The residuals of a pair.
#[derive(Clone, Debug, Default)]
pub(super) struct PairResiduals {
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

impl View<'_> {
    /// Blocks at which both ends of a match are exposed.
    pub fn times(&self, stamps: [f64; 2], m: &Match) -> [f64; 2] {
        let places = [self.scan_axis.place(m.from), self.scan_axis.place(m.to)];
        [0, 1].map(|end| self.density * (stamps[end] + self.readout * places[end]))
    }

    fn leg(&self, stamps: [f64; 2], m: &Match, prior: f64) -> Option<Leg> {
        let times = self.times(stamps, m);
        let (from, to) = (self.flow.at(times[0])?, self.flow.at(times[1])?);
        let places = [m.from, m.to].map(|point| self.scan_axis.place(point) * self.density);
        let (rates, values) = ([from.rates(), to.rates()], [from.values(), to.values()]);
        let rates =
            SVector::<f64, GENERATORS>::from_fn(|j, _| rates[1][j] * places[1] - rates[0][j] * places[0]);
        let moved = SVector::<f64, GENERATORS>::from_fn(|j, _| values[1][j] - values[0][j]);
        let middle = (m.from + m.to) / 2.0;
        let fields = fields(middle, self.path.kappa);
        let (turns, others) = (fields.fixed_columns::<TURNS>(0), fields.fixed_columns::<OTHERS>(TURNS));
        Some(Leg {
            m: *m,
            prior,
            times,
            residual: (m.to - from.carry(m.from, to)) * self.radius,
            parallax: others * moved.fixed_rows::<OTHERS>(TURNS),
            by_readout: [turns * rates.fixed_rows::<TURNS>(0), others * rates.fixed_rows::<OTHERS>(TURNS)],
            by_kappa: middle * middle.dot(&moved.xy()),
            whitening: Matrix2::identity(),
        })
    }

    /// Follows the path along a pair, and along the tracks that it continues if that is wanted and they may
    /// tell its parallax from its noise.
    pub fn residuals(&self, pair: &Pair, tracks: bool, out: &mut PairResiduals) {
        out.legs.clear();
        let matches = pair.matches.iter().zip(&pair.scene);
        out.legs.extend(matches.filter_map(|(m, prior)| self.leg(pair.stamps, m, *prior)));
        let least = self.noise * self.noise;
        let variance = out.misfit(least);
        out.sigma = variance.sqrt();
        out.others = variance + 0.5 * pair.moved() * self.radius * self.radius;
        out.legs.iter_mut().for_each(|leg| leg.whiten(variance));
        let near = out.legs.iter().filter(|leg| leg.residual.norm_squared() < 2.0 * 9.0 * variance).count();
        out.inliers = near * pair.count() / pair.matches.len().max(1);
        let tracks = pair.tracks.iter().map(|track| track.as_ref().filter(|_| tracks));
        out.parallax = tracks::parallax(out.legs.iter().zip(tracks), variance - least, &mut out.squares);
        if out.parallax.is_some() {
            self.legs_before(pair, out);
        } else {
            out.before.clear();
            out.before.resize(out.legs.len(), None);
        }
    }

    /// Follows the path along the tracks that a pair continues.
    pub fn legs_before(&self, pair: &Pair, out: &mut PairResiduals) {
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
    use crate::solve::random::Random;

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
    fn a_whitened_residual_is_as_uncertain_as_the_others() {
        let covariance = Matrix2::new(0.5, 0.2, 0.2, 0.3);
        let mut residuals = residuals(|_| Vector2::new(1.0, 0.0));
        let leg = &mut residuals.legs[0];
        (leg.m.covariance, leg.parallax) = (covariance, Vector2::new(0.0, 2.0));
        leg.whiten(0.04);
        // W·(σ²·I + C)·Wᵀ = σ²·I.
        let all = Matrix2::identity() * 0.04 + covariance;
        let white = leg.whitening * all * leg.whitening.transpose();
        assert!((white - Matrix2::identity() * 0.04).norm() < 1e-12, "{white}");
        assert_eq!(leg.residual, leg.whitening.column(0));
        assert!((leg.parallax - leg.whitening.column(1) * 2.0).norm() < 1e-12);
        for strange in [f64::NAN, f64::INFINITY, -1.0] {
            let mut leg = residuals.legs[1];
            leg.m.covariance = Matrix2::identity() * strange;
            leg.whiten(0.04);
            assert!(leg.residual.iter().all(|value| value.is_finite()), "{strange}: {}", leg.residual);
        }
    }

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
