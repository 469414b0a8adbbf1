//! What a pair says of the path, γ and κ: its part of the normal equations.
//!
//! A correspondence says x′ = F(x; t → t′), F the path's flow. A small change of the path changes
//! F by Σⱼ φⱼ(m)·(δξⱼ(t′) − δξⱼ(t)), m = (x + x′)/2, with φⱼ and ξⱼ field and path of generator j; each ξⱼ(t)
//! is a sum of four coefficients. A change of the readout time γ, t = t_k + γ·s, changes F by
//! Σⱼ φⱼ(m)·(ξⱼ′(t′)·s′ − ξⱼ′(t)·s), one of κ by m·(m · (ξ(t′) − ξ(t))), ξ the paths of yaw and pitch. A point at λ times the
//! inverse depth is moved λ times as far by all but the turns. What is new in a residual, rᵢ − B·rⱼ, depends on
//! the path by two *legs*: from frame to frame, and, by −B, between the two before.
//!
//! The splines are evaluated once for a *band* of correspondences exposed at about the same time.
//! That rounds the slopes, never the residuals.

use super::left::{Left, Leg, View};
use super::path::{BLOCK, ratio};
use super::spline;
use super::tracks::{Innovation, Scatter};
use crate::motion::generators::{GENERATORS, TURNS, fields};
use nalgebra::{Matrix2, SMatrix, SVector};

/// Bands to a pair.
const BANDS: usize = 24;
/// Groups of coefficients that a band depends on: four knots of the turns and of the others at each end of
/// both legs.
const GROUPS: usize = 24;
/// Unknowns of the camera that all frames share: γ and κ.
pub(super) const SHARED: usize = 2;
/// Degrees of freedom of Student's t, as which residuals are distributed.
const FREEDOM: f64 = 4.0;
/// However many correspondences a pair has, they are worth no more than so many independent ones:
/// what the path does not explain is alike in neighbours.
const WORTH: f64 = 25.0;

type Fields = SMatrix<f64, 2, GENERATORS>;
type Square = SMatrix<f64, GENERATORS, GENERATORS>;

/// The sums of a band, by leg: the pair's own, the one before.
#[derive(Clone, Debug, Default)]
struct Band {
    weight: f64,
    /// Weighted exposure times: of the first end of the leg before, of its second, which is the first of the pair's own,
    /// and of the last.
    times: [f64; 3],
    /// Weight of the matches that have a leg before.
    linked: f64,
    own: Square,
    before: Square,
    /// Rows of the own leg, columns of the one before.
    across: Square,
    right: [SVector<f64, GENERATORS>; 2],
    shared: [SMatrix<f64, GENERATORS, SHARED>; 2],
}

/// Coefficients side by side: those of the turns at a knot, or of the other generators in a block.
#[derive(Clone, Copy, Default)]
struct Group {
    place: usize,
    /// The first generator and how many.
    generator: usize,
    length: usize,
    /// What a unit of them adds to each leg.
    weights: [f64; 2],
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
    /// Variances of the residuals.
    pub scatter: Scatter,
    /// Coordinates that are independent.
    pub independent: f64,
    /// Logarithm of the likelihood of what is new, up to a constant, for as many matches as are independent.
    pub log_likelihood: f64,
    /// Sum of the correspondences' weights.
    weight: f64,
    bands: Vec<Band>,
}

impl Normal {
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

/// Logarithm of Student's t in two dimensions, up to a constant, of a squared distance in units of its scale.
fn log_student(square: f64) -> f64 {
    -(FREEDOM + 2.0) / 2.0 * (square / FREEDOM).ln_1p()
}

impl View<'_> {
    /// Adds up what a pair says, given the one before.
    pub fn normal(&self, left: &Left, out: &mut Normal) {
        self.normal_with(Scatter::of(left, self.noise * self.noise), left, out);
    }

    fn normal_with(&self, scatter: Scatter, left: &Left, out: &mut Normal) {
        out.scatter = scatter;
        let worth = (WORTH / left.legs.len() as f64).min(1.0);
        out.independent = 2.0 * WORTH.min(left.legs.len() as f64);
        out.log_likelihood = 0.0;
        out.bands.clear();
        out.bands.resize_with(BANDS, Band::default);
        out.shared = SMatrix::zeros();
        out.shared_right = SVector::zeros();
        for (leg, before) in left.legs.iter().zip(&left.before) {
            let mut new = scatter.innovation(leg, before.as_ref());
            let likely = log_student(new.square()) + new.weight.determinant().ln() / 2.0;
            new.weight *= worth * (FREEDOM + 2.0) / (FREEDOM + new.square());
            if !new.weight.iter().all(|weight| weight.is_finite()) {
                continue;
            }
            out.log_likelihood += worth * likely;
            let band = (self.reading.place(leg.m.from).clamp(0.0, 1.0) * (BANDS - 1) as f64).round() as usize;
            let shared = self.add(&new, leg, before.as_ref(), &mut out.bands[band]);
            out.shared += shared.transpose() * new.weight * shared;
            out.shared_right += shared.transpose() * new.weight * new.error;
        }
        out.weight = out.bands.iter().map(|band| band.weight).sum();
        self.place(left, out);
        if out.size > 0 {
            let bands = std::mem::take(&mut out.bands);
            bands.iter().filter(|band| band.weight > 0.0).for_each(|band| self.spread(band, out));
            out.bands = bands;
        }
    }

    /// Adds what is new in a match to its band; what the shared unknowns change of it.
    fn add(
        &self,
        new: &Innovation,
        leg: &Leg,
        before: Option<&Leg>,
        band: &mut Band,
    ) -> SMatrix<f64, 2, SHARED> {
        let (own, mut shared) = self.slopes(leg, new.depth);
        let weight = new.weight.trace() / 2.0;
        let weighted = own.transpose() * new.weight;
        band.weight += weight;
        band.times[1] += weight * leg.times[0];
        band.times[2] += weight * leg.times[1];
        band.own += weighted * own;
        band.right[0] += weighted * new.error;
        if let Some(leg) = before.filter(|_| new.share != Matrix2::zeros()) {
            let (before, of_shared) = self.slopes(leg, new.depth);
            let before = -new.share * before;
            shared -= new.share * of_shared;
            band.linked += weight;
            band.times[0] += weight * leg.times[0];
            band.across += weighted * before;
            let weighted = before.transpose() * new.weight;
            band.before += weighted * before;
            band.right[1] += weighted * new.error;
            band.shared[1] += weighted * shared;
        }
        band.shared[0] += weighted * shared;
        shared
    }

    /// What the paths of the generators and the shared unknowns change of a displacement, of a point of relative
    /// inverse depth `depth`.
    fn slopes(&self, leg: &Leg, depth: f64) -> (Fields, SMatrix<f64, 2, SHARED>) {
        let (m, [from, to]) = (&leg.m, leg.times);
        let middle = (m.from + m.to) / 2.0;
        let mut phi = fields(middle, self.path.kappa);
        phi.columns_mut(TURNS, GENERATORS - TURNS).scale_mut(depth);
        let (before, after) = (self.flow.rates(from), self.flow.rates(to));
        let places = [self.reading.place(m.from), self.reading.place(m.to)];
        let rates = (SVector::from(after) * places[1] - SVector::from(before) * places[0]) * self.tempo;
        let turned = (self.flow.values(to) - self.flow.values(from)).xy();
        let shared = SMatrix::<f64, 2, SHARED>::from_columns(&[phi * rates, middle * middle.dot(&turned)]);
        (phi, shared)
    }

    /// Makes room for the coefficients on which a pair depends.
    fn place(&self, left: &Left, out: &mut Normal) {
        let is_linked = out.bands.iter().any(|band| band.linked > 0.0);
        let before = left.before.iter().flatten().filter(|_| is_linked);
        let times = left.legs.iter().chain(before).flat_map(|leg| &leg.times);
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
        let [first, second, third] = band.times;
        let ends = [
            (third / band.weight, [1.0, 0.0]),
            (second / band.weight, [-1.0, 1.0]),
            (first / band.linked, [0.0, -1.0]),
        ];
        for (time, legs) in ends.into_iter().take(if band.linked > 0.0 { 3 } else { 2 }) {
            for (generator, length) in [(0, TURNS), (TURNS, GENERATORS - TURNS)] {
                let support = spline::values(time * ratio(generator) as f64);
                for (k, weight) in support.weights.into_iter().enumerate() {
                    let place = self.path.place(generator, support.first + k as i64) - out.first as i64;
                    let Some(place) = usize::try_from(place).ok().filter(|place| place + length <= out.size)
                    else {
                        continue;
                    };
                    // Where two ends are close in time they share coefficients.
                    let weights = legs.map(|leg| leg * weight);
                    if let Some(same) = groups[..count].iter_mut().find(|group| group.place == place) {
                        same.weights = [0, 1].map(|leg| same.weights[leg] + weights[leg]);
                    } else {
                        groups[count] = Group { place, generator, length, weights };
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
            let [own, before] = one.weights;
            // A row of the own leg and of the one before, as far as this group has a say in them.
            let on_own = band.own * own + band.across * before;
            let on_before = band.across.transpose() * own + band.before * before;
            let right = band.right[0] * own + band.right[1] * before;
            let shared = band.shared[0] * own + band.shared[1] * before;
            for l in 0..one.length {
                let (row, j) = (one.place + l, one.generator + l);
                out.right[row] += right[j];
                for (border, shared) in out.border.iter_mut().zip(shared.row(j).iter()) {
                    border[row] += shared;
                }
                let cells = &mut out.matrix[row * out.size..(row + 1) * out.size];
                for other in groups.iter().filter(|other| other.place <= one.place) {
                    let [own, before] = other.weights;
                    let cells = &mut cells[other.place..other.place + other.length];
                    for (m, cell) in cells.iter_mut().enumerate() {
                        let k = other.generator + m;
                        *cell += own * on_own[(k, j)] + before * on_before[(k, j)];
                    }
                }
            }
        }
    }
}

#[cfg(test)]
#[path = "normal_tests.rs"]
mod tests;
