//! The order of the steps, and which points are kept.

use super::Correspondence;
use super::field::{Motion, Neighbourhood};
use super::grid::{Grid, centre};
use super::pyramid::{Level, Pyramid};
use super::refine::{Local, Refinement};
use super::start::Search;
use super::tracker::{COARSE, CoarseTemplate, Effort, FINE, FineTemplate, Match};
use super::window::Scale;
use crate::cpu::CpuLevel;
use crate::plane::Luma;
use crate::pyramid::Reduction;
use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

/// Points whose texture (squared grey levels) is less are not kept.
pub(super) const LEAST_TEXTURE: f32 = 1.0;

/// Points whose patches correlate less are not kept.
const LEAST_CORRELATION: f32 = 0.7;

/// Points that do not come back to where they started within this many pixels are not kept.
const MOST_RETURN_ERROR: f32 = 0.5;

/// Points with fewer neighbours that move alike (or than all, on a grid that small) are not kept:
/// what nothing around it shares is more likely a mistake than a motion.
const FEWEST_SUPPORTERS: usize = 2;

/// Coarse motions whose patches correlate less have no say among neighbours.
const LEAST_COARSE_CORRELATION: f32 = 0.7;

/// Squared grey levels added to the eigenvalues on coarse levels.
const COARSE_DAMPING: f32 = 1.0;

/// Motions that are tried for each point.
const STARTS: usize = 6;

/// Starts closer to each other than this many pixels of a level are one.
const SAME_START: f32 = 1.0;

/// What was found this close to each other, in pixels of a level, leads to the same place.
const SAME_PLACE: f32 = 0.5;

/// When a later candidate replaces an earlier one.
#[derive(Clone, Copy)]
struct Measure {
    /// It leaves at most this share of what the earlier one leaves unexplained.
    share: f32,
    /// Share of a patch that may be unexplained for any reason: less tells nothing.
    tolerance: f32,
}

impl Measure {
    /// A candidate that leaves no more than this is never replaced.
    const fn enough(self) -> f32 {
        self.tolerance * (1.0 / self.share - 1.0)
    }
}

/// Among the starts, on a level where little can be told.
const AMONG_STARTS: Measure = Measure { share: 0.7, tolerance: 0.02 };

/// Against what the search led to, after the coarse levels: a wrong period leaves many times more.
const AGAINST_SEARCH: Measure = Measure { share: 0.3, tolerance: 0.001 };

/// A search that leaves more than this after the coarse levels may have led to a wrong period.
const SUSPICIOUS: f32 = 0.006;

/// A start that leaves more than this on a level is given up.
const HOPELESS: f32 = 0.2;

/// A point further than this from where its neighbours have it tries their motion too, pixels.
const DISAGREEMENT: f32 = 1.0;

const COARSE_EFFORT: Effort = Effort { iterations: 4, tolerance: 0.1 };
const FINE_EFFORT: Effort = Effort { iterations: 8, tolerance: 0.02 };

/// The way back starts where it is to end, and an error of half a pixel passes.
const RETURN_EFFORT: Effort = Effort { iterations: 8, tolerance: 0.1 };

/// Measures correspondences between frames of one size on a uniform grid.
#[derive(Debug)]
pub struct Sampler {
    cpu: CpuLevel,
    reduction: Reduction,
    grid: Grid,
    search: Search,
    motions: Vec<Option<Motion>>,
    found: Vec<Option<Found>>,
    refinement: Refinement,
}

impl Sampler {
    /// For frames of `width` × `height` pixels and a grid of cells, one point in each.
    ///
    /// Any size will do; frames (or grids) too small for a single patch yield no correspondences.
    pub fn new(width: usize, height: usize, grid_columns: usize, grid_rows: usize) -> Self {
        Self::with_cpu(CpuLevel::detect(), width, height, grid_columns, grid_rows)
    }

    /// As [`new`](Self::new), with the instructions of `level`; all levels measure the same
    /// to the last bit.
    pub fn with_cpu(
        level: CpuLevel,
        width: usize,
        height: usize,
        grid_columns: usize,
        grid_rows: usize,
    ) -> Self {
        let reduction = Reduction::new(width, height);
        let grid = Grid::new(reduction.size(), grid_columns, grid_rows);
        let cells = grid.len();
        Self {
            cpu: level,
            reduction,
            grid,
            search: Search::default(),
            motions: vec![None; cells],
            found: vec![None; cells],
            refinement: Refinement::default(),
        }
    }

    /// Full-frame pixels per analysed pixel, at least 1.
    pub fn pixel_scale(&self) -> f64 {
        self.reduction.scale()
    }

    /// Reduces `luma` into `pyramid` and makes the coarser levels.
    ///
    /// A luma that is not of the sampler's size leaves the pyramid empty: nothing can be seen.
    pub fn build(&self, luma: &Luma<'_>, pyramid: &mut Pyramid) {
        pyramid.fill(self.reduction.size(), |grey, scratch| self.reduction.reduce(luma, grey, scratch));
    }

    /// Measures the correspondences of `first` with `second` into `out`, in the order of the grid.
    ///
    /// `predict` says where a point (full-frame pixels) of the first frame is expected in the
    /// second, from the motion of the pair before; the identity where nothing is known. It speeds
    /// nothing up: it is one more start to try, and decides between equals in repeated textures.
    pub fn correspond(
        &mut self,
        first: &Pyramid,
        second: &Pyramid,
        predict: impl Fn(Vector2<f64>) -> Vector2<f64> + Sync,
        out: &mut Vec<Correspondence>,
    ) {
        out.clear();
        let pair = Pair { cpu: self.cpu, first: first.levels(), second: second.levels() };
        let size = self.reduction.size();
        if !pair.is_usable(size) {
            return;
        }
        let scale = self.reduction.scale();
        let expected = |at: Vector2<f32>| expected_shift(&predict, at, scale);
        let top = pair.first.len() - 1;
        let unit = level_scale(top);
        self.search.run(self.cpu, first.detail(), second.detail(), |at| expected(to_fine(at, top)) / unit);
        let (grid, search) = (&self.grid, &self.search);
        self.motions.par_iter_mut().enumerate().with_min_len(16).for_each(|(index, motion)| {
            *motion = grid.corner(index).and_then(|corner| {
                let at = centre::<FINE>(Vector2::new(corner.0 as f32, corner.1 as f32));
                coarse_motion(&pair, at, starts(search, at, top, expected(at)))
            });
        });
        let motions = &self.motions;
        self.found.par_iter_mut().enumerate().with_min_len(16).for_each(|(index, found)| {
            *found = grid.corner(index).and_then(|corner| {
                let at = centre::<FINE>(Vector2::new(corner.0 as f32, corner.1 as f32));
                let own = motions.get(index).copied().flatten().map(|motion| motion.shift);
                let around = Neighbourhood::new(motions, grid.columns, index);
                fine_match(&pair, corner, at, own, &around)
            });
        });
        out.extend(self.found.iter().flatten().map(|found| found.patch.to_full(scale)));
    }

    /// Measures further correspondences of the pair that [`correspond`](Self::correspond) was last
    /// given, and adds them to `out`: in cells where nothing was found, in tiles of 8 × 8 analysed
    /// pixels where the points around disagree on the motion, and there at places of a regular mesh of each of the two
    /// frames.
    ///
    /// Small patches see depth edges and small things, but are more often mistaken than the points of
    /// the grid: they are for local motion, not for that of the frame.
    pub fn refine(&mut self, first: &Pyramid, second: &Pyramid, out: &mut Vec<Correspondence>) {
        let pair = Pair { cpu: self.cpu, first: first.levels(), second: second.levels() };
        if pair.is_usable(self.reduction.size()) {
            let scale = self.reduction.scale();
            let known = self.found.iter().map(|found| found.map(|f| f.local()));
            let differ = Scale::of(&pair, self.found.iter().flatten().map(|found| &found.patch));
            self.refinement.run(&pair, &self.grid, known, differ);
            out.extend(self.refinement.found(scale));
        }
    }

    /// How much two frames differ: the highest mean absolute grey difference (0 to 255) of any
    /// block of 8 × 8 analysed pixels, each taken as 4 × 4 means of 2 × 2.
    ///
    /// The highest block, not the mean of the frame, so that something small that moves a little
    /// in a still scene shows; means of 2 × 2, so that the noise of encoding again does not add up.
    /// An exact duplicate has 0, one encoded again 1 to 10; an object of 12 pixels and a
    /// contrast of 50 grey levels that moves by one pixel has 3 to 6. Infinite where a pyramid is
    /// empty or their sizes differ.
    pub fn difference(&self, first: &Pyramid, second: &Pyramid) -> f64 {
        let pair = Pair { cpu: self.cpu, first: first.levels(), second: second.levels() };
        if !pair.is_usable(self.reduction.size()) {
            return f64::INFINITY;
        }
        let level = 1.min(pair.first.len() - 1);
        block_difference(&pair.first[level], &pair.second[level])
    }
}

/// A patch of `N` × `N` pixels that was found, in analysed pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch<const N: usize> {
    pub(super) from: Vector2<f32>,
    pub(super) found: Match,
    pub(super) texture: f32,
}

impl<const N: usize> Patch<N> {
    pub(super) fn motion(&self) -> Motion {
        Motion { at: centre::<N>(self.from), shift: self.found.corner - self.from }
    }

    pub(super) fn to_full(self, scale: f64) -> Correspondence {
        Correspondence {
            from: to_full(centre::<N>(self.from), scale),
            to: to_full(centre::<N>(self.found.corner), scale),
            texture: self.texture,
            residual: self.found.residual,
        }
    }
}

/// A point that passed.
#[derive(Clone, Copy, Debug)]
struct Found {
    patch: Patch<FINE>,
    distortion: Matrix2<f32>,
}

impl Found {
    fn local(self) -> Local {
        Local { motion: self.patch.motion(), slope: self.distortion - Matrix2::identity() }
    }
}

/// The levels of two frames.
#[derive(Clone, Copy)]
pub(super) struct Pair<'a> {
    pub(super) cpu: CpuLevel,
    pub(super) first: &'a [Level],
    pub(super) second: &'a [Level],
}

impl Pair<'_> {
    /// Whether both hold a frame of `size`.
    fn is_usable(&self, size: (usize, usize)) -> bool {
        let fits = |levels: &[Level]| levels.first().is_some_and(|l| (l.width, l.height) == size);
        fits(self.first) && fits(self.second)
    }

    pub(super) fn reversed(self) -> Self {
        Self { first: self.second, second: self.first, ..self }
    }
}

pub(super) fn level_scale(level: usize) -> f32 {
    (1u32 << level) as f32
}

fn to_fine(at: Vector2<f32>, level: usize) -> Vector2<f32> {
    at.add_scalar(0.5) * level_scale(level) - Vector2::repeat(0.5)
}

pub(super) fn to_level(at: Vector2<f32>, level: usize) -> Vector2<f32> {
    at.add_scalar(0.5) / level_scale(level) - Vector2::repeat(0.5)
}

/// The expected motion at a point, analysed pixels; none where the prediction is not finite.
fn expected_shift(
    predict: &impl Fn(Vector2<f64>) -> Vector2<f64>,
    at: Vector2<f32>,
    scale: f64,
) -> Vector2<f32> {
    let full = to_full(at, scale);
    let shift = ((predict(full) - full) / scale).map(|value| value as f32);
    if shift.iter().all(|value| value.is_finite()) { shift } else { Vector2::zeros() }
}

pub(super) fn to_full(at: Vector2<f32>, scale: f64) -> Vector2<f64> {
    at.map(f64::from).add_scalar(0.5) * scale - Vector2::repeat(0.5)
}

/// Motions a point may have, the expected one first, in analysed pixels.
fn starts(search: &Search, at: Vector2<f32>, top: usize, expected: Vector2<f32>) -> [Vector2<f32>; STARTS] {
    let (coarse, unit) = (to_level(at, top), level_scale(top));
    [
        expected,
        search.interpolated(coarse) * unit,
        search.nearest(coarse) * unit,
        search.common() * unit,
        search.calm() * unit,
        Vector2::zeros(),
    ]
}

/// Follows a point down the coarser levels from the best of its starts.
///
/// In a repeated texture the coarsest levels may take a neighbouring period for the truth, which the
/// finer ones tell apart: unless all is explained there, the expected motion, the best one near it and
/// rest are followed as well, and taken where they do explain all. Mostly they lead to the same place, and
/// from there on nothing is followed twice.
fn coarse_motion(pair: &Pair<'_>, at: Vector2<f32>, starts: [Vector2<f32>; STARTS]) -> Option<Motion> {
    let [expected, .., near, rest] = starts;
    let level = first_level(pair);
    let first = best_of(pair, level, at, &starts);
    let mut best = descend(pair, level, at, first, starts[1], 1.0);
    if best.is_none_or(|best| best.unexplained() > SUSPICIOUS) {
        let close = |a: Vector2<f32>, b: Vector2<f32>, limit| (a - b).norm() < limit * level_scale(level);
        let mut seen = [first, None, None, None];
        for (index, start) in [expected, near, rest].into_iter().enumerate() {
            if seen.iter().flatten().any(|other| close(other.start, start, SAME_START)) {
                continue;
            }
            let found = best_of(pair, level, at, &[start]);
            let leads_elsewhere = found.is_none_or(|found| {
                let mut others = seen.iter().flatten();
                found.unexplained() <= HOPELESS
                    && others.all(|other| !close(other.shift, found.shift, SAME_PLACE))
            });
            seen[index + 1] = found;
            if leads_elsewhere {
                let found = descend(pair, level, at, found, start, HOPELESS);
                let found = found.filter(|found| found.unexplained() <= AGAINST_SEARCH.enough());
                best = better(best, found, AGAINST_SEARCH);
            }
        }
    }
    let best = best.filter(|best| best.correlation >= LEAST_COARSE_CORRELATION)?;
    Some(Motion { at, shift: best.shift })
}

/// A motion (analysed pixels) and how well it explains a patch of a coarse level.
#[derive(Clone, Copy)]
struct Candidate {
    /// The motion from which it was found.
    start: Vector2<f32>,
    shift: Vector2<f32>,
    correlation: f32,
}

impl Candidate {
    /// Share of the patch's variance that another patch leaves unexplained.
    fn unexplained(&self) -> f32 {
        1.0 - self.correlation * self.correlation
    }
}

/// The later candidate where it is clearly better, otherwise the earlier.
fn better(earlier: Option<Candidate>, later: Option<Candidate>, measure: Measure) -> Option<Candidate> {
    let unexplained = |candidate: &Candidate| measure.tolerance + candidate.unexplained();
    match (earlier, later) {
        (Some(one), Some(other)) if unexplained(&other) < measure.share * unexplained(&one) => later,
        (None, later) => later,
        _ => earlier,
    }
}

/// The level on which points are followed first: the search has done the coarsest.
fn first_level(pair: &Pair<'_>) -> usize {
    let top = pair.first.len() - 1;
    top.saturating_sub(1).max(1).min(top)
}

/// Follows what was found on a level, or else a motion, down to level 1 (or 0 where there is no other): what is
/// found on the last level; `None` where nothing is, or where more than `most` is left unexplained on the way.
fn descend(
    pair: &Pair<'_>,
    level: usize,
    at: Vector2<f32>,
    found: Option<Candidate>,
    otherwise: Vector2<f32>,
    most: f32,
) -> Option<Candidate> {
    let mut best = found;
    let mut shift = best.map_or(otherwise, |best| best.shift);
    for level in (1..level).rev() {
        best = best_of(pair, level, at, &[shift]);
        if best.is_some_and(|best| best.unexplained() > most) {
            return None;
        }
        shift = best.map_or(shift, |best| best.shift);
    }
    best
}

/// The start (analysed pixels) from which a patch of a coarse level is explained best.
fn best_of(pair: &Pair<'_>, level: usize, at: Vector2<f32>, starts: &[Vector2<f32>]) -> Option<Candidate> {
    let unit = level_scale(level);
    let mut best: Option<Candidate> = None;
    let mut template = None;
    for (index, start) in starts.iter().enumerate() {
        if starts[..index].iter().any(|other| (other - start).norm() < SAME_START * unit) {
            continue;
        }
        let found = coarse_match(pair, level, at, start / unit, &mut template);
        let found = found.map(|(shift, found)| Candidate {
            start: *start,
            shift: shift * unit,
            correlation: found.correlation,
        });
        best = better(best, found, AMONG_STARTS);
        if best.is_some_and(|best| best.unexplained() <= AMONG_STARTS.enough()) {
            break;
        }
    }
    best
}

/// Follows the patch nearest to a point that is inside both frames, from `shift` (pixels of the
/// level); `None` where there is none within a patch's reach. `made` keeps the template that was made last, and where.
fn coarse_match(
    pair: &Pair<'_>,
    level: usize,
    at: Vector2<f32>,
    shift: Vector2<f32>,
    made: &mut Option<((usize, usize), CoarseTemplate)>,
) -> Option<(Vector2<f32>, Match)> {
    let (first, second) = (pair.first.get(level)?, pair.second.get(level)?);
    let wanted = to_level(at, level).add_scalar(-0.5 * (COARSE as f32 - 1.0));
    // Two pixels of margin: one for the gradients and the kernel, one for the steps to come.
    let inside = |wanted: f32, shift: f32, length: usize| {
        let least = 2.0 + (-shift).max(0.0);
        let most = length as f32 - (COARSE + 2) as f32 - shift.max(0.0);
        let corner = wanted.max(least.ceil()).min(most.floor()).round();
        (least <= most && (corner - wanted).abs() <= COARSE as f32).then_some(corner)
    };
    let from =
        Vector2::new(inside(wanted.x, shift.x, first.width)?, inside(wanted.y, shift.y, first.height)?);
    let corner = (from.x as usize, from.y as usize);
    if made.as_ref().is_none_or(|(at, _)| *at != corner) {
        *made = Some((corner, CoarseTemplate::new(pair.cpu, first, corner, COARSE_DAMPING)?));
    }
    let (_, template) = made.as_ref()?;
    let found = template.find(second, from + shift, COARSE_EFFORT)?;
    Some((found.corner - from, found))
}

/// Measures a point on the finest level, forth and back.
fn fine_match(
    pair: &Pair<'_>,
    corner: (usize, usize),
    at: Vector2<f32>,
    own: Option<Vector2<f32>>,
    around: &Neighbourhood<'_>,
) -> Option<Found> {
    let agreed = around.agreement(at);
    let from = Vector2::new(corner.0 as f32, corner.1 as f32);
    let back = agreed.distortion.try_inverse()?;
    let template = FineTemplate::distorted(pair.cpu, pair.first.first()?, corner, &back, 0.0)?;
    if template.texture.is_nan() || template.texture < LEAST_TEXTURE {
        return None;
    }
    let other = agreed.shift.filter(|shift| own.is_none_or(|own| (own - shift).norm() > DISAGREEMENT));
    let candidates = own.into_iter().chain(other);
    let found = candidates
        .filter_map(|shift| template.find(pair.second.first()?, from + shift, FINE_EFFORT))
        .filter(|found| found.step < FINE_EFFORT.tolerance && found.correlation >= LEAST_CORRELATION)
        .max_by(|a, b| a.correlation.total_cmp(&b.correlation))?;
    let supporters = around.support(Motion { at, shift: found.corner - from }, &agreed.distortion);
    let is_alone = supporters < FEWEST_SUPPORTERS.min(around.cells() - 1);
    let error = return_error(&pair.reversed(), from, found.corner, agreed.distortion)?;
    (!is_alone && error <= MOST_RETURN_ERROR).then_some(Found {
        patch: Patch { from, found, texture: template.texture },
        distortion: agreed.distortion,
    })
}

/// How far from `from` a point found at `to` is found back, in pixels.
///
/// The patch that goes back is the one on whole pixels next to `to`, a new template with its own
/// gradients; where it must come out differs from `from` by that offset, undistorted.
fn return_error(
    pair: &Pair<'_>,
    from: Vector2<f32>,
    to: Vector2<f32>,
    distortion: Matrix2<f32>,
) -> Option<f32> {
    let nearest = to.map(f32::round);
    let expected = from + distortion.try_inverse()? * (nearest - to);
    let corner = (nearest.x as usize, nearest.y as usize);
    let template = FineTemplate::distorted(pair.cpu, pair.first.first()?, corner, &distortion, 0.0)?;
    let found = template.find(pair.second.first()?, expected, RETURN_EFFORT)?;
    Some((found.corner - expected).norm())
}

/// The highest mean absolute difference of any block of 4 × 4 pixels.
fn block_difference(first: &Level, second: &Level) -> f64 {
    const SIDE: usize = 4;
    let band = |level: &Level| level.width * SIDE;
    let bands = first.data.par_chunks(band(first)).zip(second.data.par_chunks(band(second)));
    let highest = bands.map(|(a, b)| {
        let mut highest = 0.0f32;
        for x in (0..first.width).step_by(SIDE) {
            let rows = a.chunks(first.width).zip(b.chunks(first.width));
            let (mut sum, mut count) = (0.0f32, 0usize);
            for (a, b) in rows {
                let end = (x + SIDE).min(a.len());
                sum += a[x..end].iter().zip(&b[x..end]).map(|(a, b)| (a - b).abs()).sum::<f32>();
                count += end - x;
            }
            highest = highest.max(sum / count.max(1) as f32);
        }
        highest
    });
    f64::from(highest.reduce(|| 0.0, f32::max))
}
