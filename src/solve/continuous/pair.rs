//! One pair of frames: its correspondences, and what they say of the path.
//!
//! A correspondence says x′ = F(x; t → t′), F the path's flow. A small change of the path changes
//! F by Σⱼ φⱼ(m)·(δξⱼ(t′) − δξⱼ(t)), m = (x + x′)/2, with φⱼ and ξⱼ field and path of generator j; each ξⱼ(t)
//! is a sum of four coefficients. A change of the readout time γ, t = t_k + γ·s, changes F by
//! Σⱼ φⱼ(m)·(ξⱼ′(t′)·s′ − ξⱼ′(t)·s), one of κ by m·(m · (ξ(t′) − ξ(t))), ξ the paths of yaw and pitch.
//!
//! The splines are evaluated once for a *band* of correspondences exposed at about the same time.
//! That rounds the slopes, never the residuals.

use super::flow::Flow;
use super::path::{BLOCK, SplinePath, ratio};
use super::spline;
use crate::correspond::Correspondence;
use crate::motion::generators::{GENERATORS, TURNS, fields};
use crate::solve::median::{MEDIAN_TO_VARIANCE, median};
use nalgebra::{SMatrix, SVector, Vector2};

/// Bands to a pair.
const BANDS: usize = 24;
/// Groups of coefficients that a band depends on: four knots of the turns and of the others at each end.
const GROUPS: usize = 16;
/// Unknowns of the camera that all frames share: γ and κ.
pub(super) const SHARED: usize = 2;
/// Degrees of freedom of Student's t, as which residuals are distributed.
const FREEDOM: f64 = 4.0;
/// However many correspondences a pair has, they are worth no more than so many independent ones:
/// what the path does not explain, above all parallax, is alike in neighbours.
const WORTH: f64 = 25.0;
/// More matches than this are thinned out.
const MOST_MATCHES: usize = 400;
/// Fewer say nothing.
const FEWEST_MATCHES: usize = 16;
/// No point that is further from the centre, in units of the radius, was measured.
const FARTHEST: f64 = 1e3;
/// Frame periods from one frame of a pair to the other, at most: what the path does in a longer gap is
/// anyone's guess, and costs unknowns.
const LONGEST: f64 = 16.0;
/// Frame periods after which a timestamp no longer tells one line from the next.
const LATEST: f64 = 1e12;

/// Points of a correspondence, in units of the radius from the image centre.
#[derive(Clone, Copy, Debug)]
pub(super) struct Match {
    pub from: Vector2<f64>,
    pub to: Vector2<f64>,
}

/// Along which axis the sensor is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reading {
    /// Whether rows, not columns, are read one after another.
    pub by_rows: bool,
    /// Units of the radius from the first line to past the last.
    pub length: f64,
}

impl Reading {
    /// Place of a point along the axis: 0 at the top (left) edge, 1 at the other.
    pub fn place(&self, point: Vector2<f64>) -> f64 {
        0.5 + if self.by_rows { point.y } else { point.x } / self.length
    }
}

/// Correspondences of a pair and the timestamps of its frames in frame periods.
#[derive(Clone, Debug, Default)]
pub(super) struct Pair {
    pub matches: Vec<Match>,
    pub stamps: [f64; 2],
    /// Correspondences before they were thinned out.
    pub found: usize,
}

impl Pair {
    /// Takes the correspondences (pixels) of a pair; `None` where there are too few to say anything or
    /// the frames are too far apart.
    pub fn new(
        found: &[Correspondence],
        centre: Vector2<f64>,
        radius: f64,
        stamps: [f64; 2],
    ) -> Option<Self> {
        let [first, second] = stamps;
        let is_near = (second - first).abs() <= LONGEST && first.abs() < LATEST;
        let point = |pixel: Vector2<f64>| (pixel - centre) / radius;
        let matches = found.iter().map(|found| Match { from: point(found.from), to: point(found.to) });
        let is_sound = |m: &Match| m.from.iter().chain(&m.to).all(|coordinate| coordinate.abs() < FARTHEST);
        let matches: Vec<Match> = matches.filter(is_sound).collect();
        let found = matches.len();
        if found < FEWEST_MATCHES || !is_near {
            return None;
        }
        let matches = matches.into_iter().step_by(found.div_ceil(MOST_MATCHES)).collect();
        Some(Self { matches, stamps, found })
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

/// The sums of a band.
#[derive(Clone, Copy)]
struct Band {
    weight: f64,
    /// Weighted exposure times of both ends.
    times: [f64; 2],
    normal: SMatrix<f64, GENERATORS, GENERATORS>,
    right: SVector<f64, GENERATORS>,
    shared: SMatrix<f64, GENERATORS, SHARED>,
}

/// Coefficients side by side: those of the turns at a knot, or of the other generators in a block.
#[derive(Clone, Copy, Default)]
struct Group {
    place: usize,
    /// The first generator and how many.
    generator: usize,
    length: usize,
    weight: f64,
}

/// The normal equations of one pair, over the coefficients from `first` on.
#[derive(Clone, Debug, Default)]
pub(super) struct Normal {
    pub first: usize,
    pub size: usize,
    /// `size` rows of `size`, of which the lower triangle is filled.
    pub matrix: Vec<f64>,
    pub right: Vec<f64>,
    /// Columns of the shared unknowns.
    pub border: [Vec<f64>; SHARED],
    pub shared: SMatrix<f64, SHARED, SHARED>,
    pub shared_right: SVector<f64, SHARED>,
    /// Standard deviation of a coordinate of the residuals in pixels, by their median.
    pub sigma: f64,
    /// Correspondences within three of them.
    pub inliers: usize,
    /// Sum of the correspondences' weights.
    weight: f64,
    /// Blocks at which both ends of each match are exposed.
    times: Vec<[f64; 2]>,
    residuals: Vec<Vector2<f64>>,
    squares: Vec<f64>,
}

impl Normal {
    /// Coordinates that are independent.
    pub fn independent(&self) -> f64 {
        2.0 * WORTH.min(self.residuals.len() as f64)
    }

    /// Logarithm of the likelihood of the residuals, up to a constant: Student's t of two dimensions, for as many
    /// matches as are independent.
    pub fn log_likelihood(&self) -> f64 {
        let variance = self.sigma * self.sigma;
        let of = |r: &Vector2<f64>| {
            -variance.ln() - (FREEDOM + 2.0) / 2.0 * (r.norm_squared() / (FREEDOM * variance)).ln_1p()
        };
        let sum: f64 = self.residuals.iter().map(of).sum();
        sum * (WORTH / self.residuals.len().max(1) as f64).min(1.0)
    }

    /// Root mean square change in pixels of the displacements, as a step of all coefficients makes it.
    pub fn moved(&self, step: &[f64]) -> f64 {
        let step = &step[self.first..self.first + self.size];
        let rows = self.matrix.chunks_exact(self.size.max(1)).zip(step).enumerate();
        let square: f64 = rows
            .map(|(i, (row, own))| {
                let left: f64 = row[..i].iter().zip(step).map(|(value, other)| value * other).sum();
                own * (2.0 * left + row[i] * own)
            })
            .sum();
        if self.weight > 0.0 { (square.max(0.0) / self.weight).sqrt() } else { 0.0 }
    }
}

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
}

impl View<'_> {
    fn times(&self, pair: &Pair, m: &Match) -> [f64; 2] {
        let places = [self.reading.place(m.from), self.reading.place(m.to)];
        [0, 1].map(|end| self.tempo * (pair.stamps[end] + self.readout * places[end]))
    }

    /// Adds up what a pair says.
    pub fn normal(&self, pair: &Pair, out: &mut Normal) {
        out.times.clear();
        out.times.extend(pair.matches.iter().map(|m| self.times(pair, m)));
        out.residuals.clear();
        out.residuals.extend(
            pair.matches
                .iter()
                .zip(&out.times)
                .map(|(m, [from, to])| (m.to - self.flow.carry(m.from, *from, *to)) * self.radius),
        );
        out.squares.clear();
        out.squares.extend(out.residuals.iter().map(|r| r.norm_squared()));
        let variance = (median(&mut out.squares) * MEDIAN_TO_VARIANCE).max(self.noise * self.noise);
        out.sigma = variance.sqrt();
        let near = out.residuals.iter().filter(|r| r.norm_squared() < 2.0 * 9.0 * variance).count();
        out.inliers = near * pair.found / pair.matches.len().max(1);
        let worth = (WORTH / pair.matches.len() as f64).min(1.0) / variance;
        let mut bands = [Band {
            weight: 0.0,
            times: [0.0; 2],
            normal: SMatrix::zeros(),
            right: SVector::zeros(),
            shared: SMatrix::zeros(),
        }; BANDS];
        out.shared = SMatrix::zeros();
        out.shared_right = SVector::zeros();
        for ((m, r), times) in pair.matches.iter().zip(&out.residuals).zip(&out.times) {
            let weight = worth * (FREEDOM + 2.0) / (FREEDOM + r.norm_squared() / variance);
            if !weight.is_finite() {
                continue;
            }
            let band = (self.reading.place(m.from).clamp(0.0, 1.0) * (BANDS - 1) as f64).round() as usize;
            let shared = self.add(m, *r, weight, *times, &mut bands[band]);
            out.shared += shared.transpose() * shared * weight;
            out.shared_right += shared.transpose() * r * weight;
        }
        out.weight = bands.iter().map(|band| band.weight).sum();
        self.place(out);
        if out.size > 0 {
            bands.iter().filter(|band| band.weight > 0.0).for_each(|band| self.spread(band, out));
        }
    }

    /// Adds a match to its band; what the shared unknowns change of it.
    fn add(
        &self,
        m: &Match,
        residual: Vector2<f64>,
        weight: f64,
        [from, to]: [f64; 2],
        band: &mut Band,
    ) -> SMatrix<f64, 2, SHARED> {
        let middle = (m.from + m.to) / 2.0;
        let phi = fields(middle, self.path.kappa);
        let (before, after) = (self.flow.rates(from), self.flow.rates(to));
        let places = [self.reading.place(m.from), self.reading.place(m.to)];
        let rates = (SVector::from(after) * places[1] - SVector::from(before) * places[0]) * self.tempo;
        let turned = self.flow.turned(to) - self.flow.turned(from);
        let shared = SMatrix::<f64, 2, SHARED>::from_columns(&[phi * rates, middle * middle.dot(&turned)]);
        let weighted = phi.transpose() * weight;
        band.weight += weight;
        band.times[0] += weight * from;
        band.times[1] += weight * to;
        band.normal += weighted * phi;
        band.right += weighted * residual;
        band.shared += weighted * shared;
        shared
    }

    /// Makes room for the coefficients on which a pair depends.
    fn place(&self, out: &mut Normal) {
        let times = out.times.iter().flatten();
        let [low, high] =
            times.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], t| [low.min(*t), high.max(*t)]);
        let [low, high] = [low, high].map(|time| time.floor() as i64);
        let end = self.path.coefficients.len();
        let first = usize::try_from(low.saturating_sub(self.path.base)).unwrap_or(0);
        out.first = first.saturating_mul(BLOCK).min(end);
        let blocks = usize::try_from(high.saturating_sub(low).saturating_add(4)).unwrap_or(0);
        out.size = blocks.saturating_mul(BLOCK).min(end - out.first);
        let clear = |values: &mut Vec<f64>, len: usize| {
            values.clear();
            values.resize(len, 0.0);
        };
        clear(&mut out.matrix, out.size * out.size);
        clear(&mut out.right, out.size);
        out.border.iter_mut().for_each(|border| clear(border, out.size));
    }

    /// The coefficients on which a band depends, and how many groups of them there are.
    fn touched(&self, band: &Band, out: &Normal) -> ([Group; GROUPS], usize) {
        let (mut groups, mut count) = ([Group::default(); GROUPS], 0);
        for (sum, sign) in band.times.into_iter().zip([-1.0, 1.0]) {
            let time = sum / band.weight;
            for (generator, length) in [(0, TURNS), (TURNS, GENERATORS - TURNS)] {
                let support = spline::values(time * ratio(generator) as f64);
                for (k, weight) in support.weights.into_iter().enumerate() {
                    let place = self.path.place(generator, support.first + k as i64) - out.first as i64;
                    let Some(place) = usize::try_from(place).ok().filter(|place| place + length <= out.size)
                    else {
                        continue;
                    };
                    // Where the two ends are close in time they share coefficients.
                    if let Some(same) = groups[..count].iter_mut().find(|group| group.place == place) {
                        same.weight += sign * weight;
                    } else {
                        groups[count] = Group { place, generator, length, weight: sign * weight };
                        count += 1;
                    }
                }
            }
        }
        (groups, count)
    }

    /// Spreads a band's sums over the coefficients.
    fn spread(&self, band: &Band, out: &mut Normal) {
        let (groups, count) = self.touched(band, out);
        let groups = &groups[..count];
        for one in groups {
            for l in 0..one.length {
                let (row, j) = (one.place + l, one.generator + l);
                out.right[row] += one.weight * band.right[j];
                for (border, shared) in out.border.iter_mut().zip(band.shared.row(j).iter()) {
                    border[row] += one.weight * shared;
                }
                let cells = &mut out.matrix[row * out.size..(row + 1) * out.size];
                let normal = &band.normal.as_slice()[j * GENERATORS..(j + 1) * GENERATORS];
                for other in groups.iter().filter(|other| other.place <= one.place) {
                    let weight = one.weight * other.weight;
                    let cells = &mut cells[other.place..other.place + other.length];
                    let normal = &normal[other.generator..other.generator + other.length];
                    cells.iter_mut().zip(normal).for_each(|(cell, normal)| *cell += weight * normal);
                }
            }
        }
    }
}

#[cfg(test)]
#[path = "pair_tests.rs"]
mod tests;
