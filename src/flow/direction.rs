//! The flow of one frame to the other on one level after another.

use super::consensus::Consensus;
use super::lanes::Cpu;
use super::level::{CELL, Found, Mean, Pair, better, cells, mean};
use super::patch::Template;
use super::prediction::Prediction;
use super::rows::{RowKernel, fill};
use super::search::exhaustive;
use crate::cpu::CpuLevel;
use crate::pyramid::Level;

/// Comparisons after the candidates': on the coarse levels, where steps are long, and on the finest.
const COARSE_STEPS: usize = 3;
const FINE_STEPS: usize = 2;

/// Comparisons after those with the neighbours' displacements.
const SPREAD_STEPS: usize = 1;

/// Levels as fine as this take nothing from the patches beside: the coarser cells say what those would.
const LAST_SPREAD: usize = 2;

/// Comparisons after the first one with what most of the picture does, which may be some pixels beside the truth: the
/// readout and perspective bend a motion that is taken to be affine.
const AGREEMENT_STEPS: usize = 4;

/// Patches that are further from it, in pixels of the level, are compared with it.
const AGREEMENT: f32 = 2.0;

/// Two displacements of which one leaves less than this many times what the other does may both be right …
const AS_GOOD: f32 = 2.0;

/// … and this share of the contrast more, which linear interpolation of sharp edges leaves.
const UNEXPLAINED: f32 = 0.05;

/// What the texture of a patch counts that takes an expected motion: the picture does not say that it is so, only that it
/// may be. From a tenth to a thousandth changes little.
const EXPECTED: f32 = 0.1;

/// Where a level stands among the others.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stage<'a> {
    pub(super) cpu: CpuLevel,
    pub(super) first: &'a Level,
    pub(super) second: &'a Level,
    /// Variance of a pixel's noise, squared grey levels.
    pub(super) noise: f32,
    /// It is 2^depth times coarser than the analysed luma.
    pub(super) depth: usize,
    /// It is the first of the levels.
    pub(super) is_coarsest: bool,
    /// It is the last of them.
    pub(super) is_finest: bool,
}

impl Stage<'_> {
    /// From the second frame to the first.
    pub(super) fn reversed(self) -> Self {
        Self { first: self.second, second: self.first, ..self }
    }
}

/// What one direction knows.
#[derive(Debug, Default)]
pub(super) struct Direction {
    pub(super) prediction: Prediction,
    patches: Vec<Found>,
    spread: Vec<Found>,
    /// Those that move otherwise than expected.
    apart: Vec<Apart>,
    /// Of the level done last.
    pub(super) means: Vec<Mean>,
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// What the other direction says of each cell, where it says anything.
    reversed: Vec<Option<[f32; 2]>>,
    /// Residuals of what led there.
    costs: Vec<f32>,
}

/// What a patch starts from.
#[derive(Clone, Copy)]
struct Known<'a> {
    stage: Stage<'a>,
    prediction: &'a Prediction,
    /// The next coarser level's cells, in its pixels.
    coarse: &'a [Mean],
    reversed: &'a [Option<[f32; 2]>],
    columns: usize,
    rows: usize,
}

impl Direction {
    /// Does one level, given those that are coarser.
    pub(super) fn run(&mut self, stage: &Stage<'_>) {
        let (columns, rows) = cells(stage.first);
        let (across, down) = (columns.saturating_sub(1).max(1), rows.saturating_sub(1).max(1));
        let known = Known {
            stage: *stage,
            prediction: &self.prediction,
            coarse: &self.means,
            reversed: &self.reversed,
            columns: self.columns,
            rows: self.rows,
        };
        self.patches.resize(across * down, Found::default());
        self.spread.resize(across * down, Found::default());
        fill(stage.cpu, &known, across, &mut self.patches);
        let spreads = if stage.is_coarsest { 2 } else { usize::from(stage.depth > LAST_SPREAD) };
        for _ in 0..spreads {
            let spread = Spread { stage: *stage, patches: &self.patches };
            fill(stage.cpu, &spread, across, &mut self.spread);
            std::mem::swap(&mut self.patches, &mut self.spread);
        }
        (self.columns, self.rows) = (columns, rows);
        self.means.resize(columns * rows, Mean::default());
        self.overlap(stage);
    }

    /// Where the picture does not tell a patch's motion from the one that most of it shares, or from the predicted one,
    /// takes that: along edges, in flat places, and where a pattern repeats itself.
    pub(super) fn agree(&mut self, stage: &Stage<'_>) {
        let Some(consensus) = Consensus::of(&self.means, self.columns, stage.noise) else { return };
        let across = self.columns.saturating_sub(1).max(1);
        self.apart.clear();
        for (index, own) in self.patches.iter().enumerate() {
            let (x, y) = (index % across * CELL, index / across * CELL);
            let expected = [self.prediction.of_patch(stage.depth, x, y), consensus.of_patch(x, y)];
            let is_apart = |other: &[f32; 2]| {
                let (dx, dy) = (own.shift[0] - other[0], own.shift[1] - other[1]);
                dx * dx + dy * dy > AGREEMENT * AGREEMENT
            };
            if expected.iter().all(is_apart) {
                self.apart.push(Apart { index, x, y, own: *own, expected });
            }
        }
        self.spread.resize(self.patches.len(), Found::default());
        let Some(spread) = self.spread.get_mut(..self.apart.len()) else { return };
        fill(stage.cpu, &Agreement { stage: *stage, apart: &self.apart }, APART, spread);
        for (apart, found) in self.apart.iter().zip(&self.spread) {
            if let Some(patch) = self.patches.get_mut(apart.index) {
                *patch = *found;
            }
        }
        if !self.apart.is_empty() {
            self.overlap(stage);
        }
    }

    /// Makes the cells from the patches.
    fn overlap(&mut self, stage: &Stage<'_>) {
        let across = self.columns.saturating_sub(1).max(1);
        let overlap = Overlap { patches: &self.patches, across, noise: stage.noise };
        fill(stage.cpu, &overlap, self.columns, &mut self.means);
    }

    /// Takes over what the other direction says: where its cells lead, minus their displacement; of two that lead to
    /// one place the one that fits better.
    pub(super) fn listen(&mut self, other: &Self) {
        self.reversed.clear();
        self.reversed.resize(self.columns * self.rows, None);
        let side = CELL as f32;
        self.costs.clear();
        self.costs.resize(self.reversed.len(), f32::INFINITY);
        for (index, mean) in other.means.iter().enumerate() {
            let (column, row) = (index % other.columns.max(1), index / other.columns.max(1));
            let x = column as f32 + mean.shift[0] / side + 0.5;
            let y = row as f32 + mean.shift[1] / side + 0.5;
            if !(x >= 0.0 && y >= 0.0 && x < self.columns as f32 && y < self.rows as f32) {
                continue;
            }
            let place = y as usize * self.columns + x as usize;
            if let (Some(reversed), Some(best)) = (self.reversed.get_mut(place), self.costs.get_mut(place))
                && mean.residual < *best
            {
                *reversed = Some([-mean.shift[0], -mean.shift[1]]);
                *best = mean.residual;
            }
        }
    }

    /// Forgets the levels of the pair before.
    pub(super) fn restart(&mut self) {
        self.means.clear();
        self.reversed.clear();
        (self.columns, self.rows) = (0, 0);
    }

    /// The displacement at a point, pixels of the level both, interpolated linearly.
    pub(super) fn at(&self, x: f32, y: f32) -> [f32; 2] {
        between(
            &self.means,
            self.columns,
            self.rows,
            (x + 0.5) / CELL as f32 - 0.5,
            (y + 0.5) / CELL as f32 - 0.5,
        )
    }
}

/// Patches from what coarser levels say.
impl RowKernel<Found> for Known<'_> {
    #[inline(always)]
    fn fill<C: Cpu>(&self, cpu: C, row: usize, out: &mut [Found]) {
        let Stage { first, second, is_coarsest, is_finest, noise, .. } = self.stage;
        let pair = Pair { first, second, steps: if is_finest { FINE_STEPS } else { COARSE_STEPS }, noise };
        let mut template = Template::new(cpu);
        for (column, out) in out.iter_mut().enumerate() {
            let (x, y) = (column * CELL, row * CELL);
            let found = if is_coarsest {
                // Compared after the steps: half a pixel of this level beside the truth, a residual tells little.
                let near = pair.find(&mut template, x, y, &[self.predicted(x, y), [0.0; 2]]);
                {
                    let best = exhaustive(&pair, &mut template, x, y);
                    better(near, pair.find(&mut template, x, y, &[best]), noise)
                }
            } else if is_finest {
                pair.find(&mut template, x, y, &self.fine_candidates(column, row))
            } else {
                pair.find(&mut template, x, y, &self.candidates(column, row, x, y))
            };
            *out = found.unwrap_or_default();
        }
    }
}

/// Patches from what those beside them found.
struct Spread<'a> {
    stage: Stage<'a>,
    patches: &'a [Found],
}

impl RowKernel<Found> for Spread<'_> {
    #[inline(always)]
    fn fill<C: Cpu>(&self, cpu: C, row: usize, out: &mut [Found]) {
        let Stage { first, second, noise, .. } = self.stage;
        let pair = Pair { first, second, steps: SPREAD_STEPS, noise };
        let mut template = Template::new(cpu);
        let across = out.len();
        let at = |row: usize, column: usize| self.patches.get(row * across + column).map(|found| found.shift);
        for (column, out) in out.iter_mut().enumerate() {
            let Some(own) = at(row, column) else { continue };
            let left = column.checked_sub(1).and_then(|column| at(row, column)).unwrap_or(own);
            let right = if column + 1 < across { at(row, column + 1).unwrap_or(own) } else { own };
            let above = row.checked_sub(1).and_then(|row| at(row, column)).unwrap_or(own);
            let below = at(row + 1, column).unwrap_or(own);
            let candidates = [own, left, right, above, below];
            *out = pair.find(&mut template, column * CELL, row * CELL, &candidates).unwrap_or_default();
        }
    }
}

/// A patch that moves otherwise than expected.
#[derive(Clone, Copy, Debug)]
struct Apart {
    index: usize,
    /// Its top left pixel.
    x: usize,
    y: usize,
    own: Found,
    /// The predicted displacement, and that of most of the picture.
    expected: [[f32; 2]; 2],
}

/// Patches compared with what is expected of them, so many to a task.
const APART: usize = 64;

struct Agreement<'a> {
    stage: Stage<'a>,
    apart: &'a [Apart],
}

impl RowKernel<Found> for Agreement<'_> {
    #[inline(always)]
    fn fill<C: Cpu>(&self, cpu: C, row: usize, out: &mut [Found]) {
        let Stage { first, second, noise, .. } = self.stage;
        let pair = Pair { first, second, steps: AGREEMENT_STEPS, noise };
        let mut template = Template::new(cpu);
        for (out, apart) in out.iter_mut().zip(self.apart.iter().skip(row * APART)) {
            let Apart { x, y, own, expected: [predicted, shared], .. } = *apart;
            let found = {
                let a = pair.find(&mut template, x, y, &[predicted]);
                better(a, pair.find(&mut template, x, y, &[shared]), noise)
            };
            let most = AS_GOOD * own.total + UNEXPLAINED * own.energy;
            let taken = found.filter(|found| found.total < most);
            *out = taken.map_or(own, |found| Found { tensor: found.tensor.map(|t| EXPECTED * t), ..found });
        }
    }
}

/// Cells from the patches that see them.
struct Overlap<'a> {
    patches: &'a [Found],
    across: usize,
    noise: f32,
}

impl RowKernel<Mean> for Overlap<'_> {
    #[inline(always)]
    fn fill<C: Cpu>(&self, _: C, row: usize, out: &mut [Mean]) {
        for (column, out) in out.iter_mut().enumerate() {
            *out = mean(self.patches, self.across, column, row, self.noise);
        }
    }
}

impl Known<'_> {
    fn predicted(&self, x: usize, y: usize) -> [f32; 2] {
        self.prediction.of_patch(self.stage.depth, x, y)
    }

    /// The coarser level's displacement at a patch, and those of the cells diagonally around.
    ///
    /// The middle of a patch is at half its index among the coarser cells: on one, or between two.
    #[inline(always)]
    fn coarser(&self, column: usize, row: usize) -> ([f32; 2], [[f32; 2]; 4]) {
        let interpolated =
            between(self.coarse, self.columns, self.rows, 0.5 * column as f32, 0.5 * row as f32);
        let last = |count: usize| count.saturating_sub(1);
        let before = |index: usize| (index.max(1) - 1) / 2;
        let (left, right) = (before(column), (column / 2 + 1).min(last(self.columns)));
        let (above, below) = (before(row), (row / 2 + 1).min(last(self.rows)));
        let at = |row: usize, column: usize| {
            twice(self.coarse.get(row * self.columns + column).map(|mean| mean.shift).unwrap_or_default())
        };
        (twice(interpolated), [at(above, left), at(above, right), at(below, left), at(below, right)])
    }

    /// Displacements to be tried. The prediction is preferred where the picture does not tell, as where it repeats itself.
    #[inline(always)]
    fn candidates(&self, column: usize, row: usize, x: usize, y: usize) -> [[f32; 2]; 8] {
        let (interpolated, [a, b, c, d]) = self.coarser(column, row);
        let own = self.reversed.get((row / 2) * self.columns + column / 2);
        let reversed = own.copied().flatten().map_or(interpolated, twice);
        [self.predicted(x, y), interpolated, a, b, c, d, reversed, [0.0; 2]]
    }

    /// Those of the finest level: of the cells around only the one that differs most.
    #[inline(always)]
    fn fine_candidates(&self, column: usize, row: usize) -> [[f32; 2]; 2] {
        let (interpolated, around) = self.coarser(column, row);
        let mut furthest = (interpolated, 0.0);
        for shift in around {
            let (x, y) = (shift[0] - interpolated[0], shift[1] - interpolated[1]);
            let distance = x * x + y * y;
            if distance > furthest.1 {
                furthest = (shift, distance);
            }
        }
        [interpolated, furthest.0]
    }
}

fn twice(shift: [f32; 2]) -> [f32; 2] {
    shift.map(|value| 2.0 * value)
}

/// The displacement at a place among cells, whose centres are at integers; the outermost ones go on.
#[inline(always)]
fn between(means: &[Mean], columns: usize, rows: usize, x: f32, y: f32) -> [f32; 2] {
    let last = |count: usize| count.saturating_sub(1);
    let (x, y) = (x.clamp(0.0, last(columns) as f32), y.clamp(0.0, last(rows) as f32));
    let (column, row) = (x as usize, y as usize);
    let at = |row: usize, column: usize| {
        let index = row.min(last(rows)) * columns + column.min(last(columns));
        means.get(index).map(|mean| mean.shift).unwrap_or_default()
    };
    let blend =
        |a: [f32; 2], b: [f32; 2], share: f32| [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])];
    let above = blend(at(row, column), at(row, column + 1), x.fract());
    let below = blend(at(row + 1, column), at(row + 1, column + 1), x.fract());
    blend(above, below, y.fract())
}
