//! The flow of one frame to the other on one level after another.

use super::consensus::Consensus;
use super::lanes::Cpu;
use super::level::{CELL, Mean, Pair, PatchFlow, cells, find, overlap};
use super::patch::Template;
use super::prediction::Prediction;
use super::rows::{RowKernel, fill};
use super::search::exhaustive;
use crate::cpu::CpuLevel;

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
    pub(super) pair: Pair<'a>,
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
        Self { pair: self.pair.reversed(), ..self }
    }
}

/// What one direction knows.
#[derive(Debug, Default)]
pub(super) struct Direction {
    pub(super) prediction: Prediction,
    patches: Vec<PatchFlow>,
    spread: Vec<PatchFlow>,
    /// Of the level done last.
    pub(super) means: Vec<Mean>,
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// What the other direction says of each cell, where it says anything, and the residual of what led there.
    reversed: Vec<Option<([f32; 2], f32)>>,
}

/// What a patch starts from.
#[derive(Clone, Copy)]
struct Known<'a> {
    stage: Stage<'a>,
    prediction: &'a Prediction,
    /// The next coarser level's cells, in its pixels.
    coarse: &'a [Mean],
    reversed: &'a [Option<([f32; 2], f32)>],
    columns: usize,
    rows: usize,
}

impl Direction {
    /// Does one level, given those that are coarser.
    pub(super) fn run(&mut self, stage: &Stage<'_>) {
        let (columns, rows) = cells(stage.pair.first);
        let (across, down) = (columns.saturating_sub(1).max(1), rows.saturating_sub(1).max(1));
        let known = Known {
            stage: *stage,
            prediction: &self.prediction,
            coarse: &self.means,
            reversed: &self.reversed,
            columns: self.columns,
            rows: self.rows,
        };
        self.patches.resize(across * down, PatchFlow::default());
        self.spread.resize(across * down, PatchFlow::default());
        fill(stage.cpu, &known, across, &mut self.patches);
        let spreads = if stage.is_coarsest { 2 } else { usize::from(stage.depth > LAST_SPREAD) };
        for _ in 0..spreads {
            let spread = Spread { pair: stage.pair, patches: &self.patches };
            fill(stage.cpu, &spread, across, &mut self.spread);
            std::mem::swap(&mut self.patches, &mut self.spread);
        }
        let consensus =
            stage.is_finest.then(|| Consensus::of(&self.patches, across, stage.pair.noise)).flatten();
        if let Some(consensus) = consensus {
            let agreement =
                Agreement { stage: *stage, patches: &self.patches, prediction: &self.prediction, consensus };
            fill(stage.cpu, &agreement, across, &mut self.spread);
            std::mem::swap(&mut self.patches, &mut self.spread);
        }
        (self.columns, self.rows) = (columns, rows);
        self.means.resize(columns * rows, Mean::default());
        let overlap = Overlap { patches: &self.patches, across, noise: stage.pair.noise };
        fill(stage.cpu, &overlap, columns, &mut self.means);
    }

    /// Takes over what the other direction says: where its cells lead, minus their displacement; of two that lead to
    /// one place the one that fits better.
    pub(super) fn listen(&mut self, other: &Self) {
        self.reversed.clear();
        self.reversed.resize(self.columns * self.rows, None);
        let side = CELL as f32;
        for (index, mean) in other.means.iter().enumerate() {
            let (column, row) = (index % other.columns.max(1), index / other.columns.max(1));
            let x = column as f32 + mean.shift()[0] / side + 0.5;
            let y = row as f32 + mean.shift()[1] / side + 0.5;
            if !(x >= 0.0 && y >= 0.0 && x < self.columns as f32 && y < self.rows as f32) {
                continue;
            }
            if let Some(reversed) = self.reversed.get_mut(y as usize * self.columns + x as usize)
                && reversed.is_none_or(|(_, best)| mean.residual() < best)
            {
                *reversed = Some((mean.shift().map(|shift| -shift), mean.residual()));
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
    #[inline(always)]
    pub(super) fn at(&self, x: f32, y: f32) -> [f32; 2] {
        let place = |at: f32| (at + 0.5) / CELL as f32 - 0.5;
        between(&self.means, self.columns, self.rows, place(x), place(y))
    }
}

/// Patches from what coarser levels say.
impl RowKernel<PatchFlow> for Known<'_> {
    #[inline(always)]
    fn fill<C: Cpu>(&self, cpu: C, row: usize, out: &mut [PatchFlow]) {
        let Stage { pair, is_coarsest, is_finest, .. } = self.stage;
        let found = if is_coarsest {
            self.search(cpu, row, out)
        } else if is_finest {
            find(cpu, pair, row, FINE_STEPS, |column| self.fine_candidates(column, row), out)
        } else {
            find(cpu, pair, row, COARSE_STEPS, |column| self.candidates(column, row), out)
        };
        if found.is_none() {
            out.fill(PatchFlow::default());
        }
    }
}

/// Patches from what those beside them found.
struct Spread<'a> {
    pair: Pair<'a>,
    patches: &'a [PatchFlow],
}

impl RowKernel<PatchFlow> for Spread<'_> {
    #[inline(always)]
    fn fill<C: Cpu>(&self, cpu: C, row: usize, out: &mut [PatchFlow]) {
        let across = out.len();
        let at = |row: usize, column: usize| {
            let found = (column < across).then(|| self.patches.get(row * across + column)).flatten();
            found.map(|found| found.mean.shift())
        };
        let candidates = |column: usize| {
            let own = at(row, column).unwrap_or_default();
            // Before the first there is nothing either.
            let beside = [
                at(row, column.wrapping_sub(1)),
                at(row, column + 1),
                row.checked_sub(1).and_then(|row| at(row, column)),
                at(row + 1, column),
            ];
            let [left, right, above, below] = beside.map(|beside| beside.unwrap_or(own));
            [own, left, right, above, below]
        };
        if find(cpu, self.pair, row, SPREAD_STEPS, candidates, out).is_none() {
            out.fill(PatchFlow::default());
        }
    }
}

/// Where the picture does not tell a patch's motion from the one that most of it shares, or from the predicted one, that:
/// along edges, in flat places, and where a pattern repeats itself.
struct Agreement<'a> {
    stage: Stage<'a>,
    patches: &'a [PatchFlow],
    prediction: &'a Prediction,
    consensus: Consensus,
}

impl RowKernel<PatchFlow> for Agreement<'_> {
    #[inline(always)]
    fn fill<C: Cpu>(&self, cpu: C, row: usize, out: &mut [PatchFlow]) {
        let pair = self.stage.pair;
        let mut template = Template::new(cpu);
        let across = out.len();
        for (column, (out, own)) in out.iter_mut().zip(self.patches.iter().skip(row * across)).enumerate() {
            *out = *own;
            let (x, y) = (column * CELL, row * CELL);
            let is_apart = |other: [f32; 2]| {
                let [x, y] = own.mean.shift();
                let (dx, dy) = (x - other[0], y - other[1]);
                dx * dx + dy * dy > AGREEMENT * AGREEMENT
            };
            let shared = self.consensus.of_patch(x, y);
            if !is_apart(shared) {
                continue;
            }
            let predicted = self.prediction.of_patch(self.stage.depth, x, y);
            if !is_apart(predicted) {
                continue;
            }
            let found = pair.best_of_two(&mut template, [x, y], AGREEMENT_STEPS, |_| [predicted, shared]);
            let most = AS_GOOD * own.mean.residual() + UNEXPLAINED * own.mean.energy();
            if let Some(found) = found.filter(|found| found.mean.residual() < most) {
                *out = found.dimmed(EXPECTED);
            }
        }
    }
}

/// Cells from the patches that see them.
struct Overlap<'a> {
    patches: &'a [PatchFlow],
    across: usize,
    noise: f32,
}

impl RowKernel<Mean> for Overlap<'_> {
    #[inline(always)]
    fn fill<C: Cpu>(&self, cpu: C, row: usize, out: &mut [Mean]) {
        overlap(cpu, self.patches, self.across, row, self.noise, out);
    }
}

impl Known<'_> {
    /// Patches of the coarsest level. Near and far are compared after the steps: half a pixel of this level beside the
    /// truth, a residual tells little.
    #[inline(always)]
    fn search<C: Cpu>(&self, cpu: C, row: usize, out: &mut [PatchFlow]) -> Option<()> {
        let mut template = Template::new(cpu);
        for (column, out) in out.iter_mut().enumerate() {
            let at = [column * CELL, row * CELL];
            let predicted = self.prediction.of_patch(self.stage.depth, at[0], at[1]);
            *out = self
                .stage
                .pair
                .best_of_two(&mut template, at, COARSE_STEPS, |search| [predicted, exhaustive(search)])?;
        }
        Some(())
    }

    /// The coarser level's displacement at a patch, and those of the cells diagonally around.
    ///
    /// The middle of a patch is at half its index among the coarser cells: on one, or between two.
    #[inline(always)]
    fn coarser(&self, column: usize, row: usize) -> ([f32; 2], [[f32; 2]; 4]) {
        let at = |row: usize, column: usize| {
            let index =
                row.min(self.rows.wrapping_sub(1)) * self.columns + column.min(self.columns.wrapping_sub(1));
            twice(self.coarse.get(index).map(Mean::shift).unwrap_or_default())
        };
        let around = |from: usize, to: usize, above: usize, below: usize| {
            [at(above, from), at(above, to), at(below, from), at(below, to)]
        };
        let [a, b, c, d] = around(column / 2, column.div_ceil(2), row / 2, row.div_ceil(2));
        let interpolated = [0, 1].map(|axis| 0.25 * ((a[axis] + b[axis]) + (c[axis] + d[axis])));
        let before = |index: usize| index.saturating_sub(1) / 2;
        (interpolated, around(before(column), column / 2 + 1, before(row), row / 2 + 1))
    }

    /// Displacements to be tried. The prediction is preferred where the picture does not tell, as where it repeats itself.
    #[inline(always)]
    fn candidates(&self, column: usize, row: usize) -> [[f32; 2]; 8] {
        let predicted = self.prediction.of_patch(self.stage.depth, column * CELL, row * CELL);
        let (interpolated, [a, b, c, d]) = self.coarser(column, row);
        let own = self.reversed.get((row / 2) * self.columns + column / 2);
        let reversed = own.copied().flatten().map_or(interpolated, |(shift, _)| twice(shift));
        [predicted, interpolated, a, b, c, d, reversed, [0.0; 2]]
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
        means.get(index).map(Mean::shift).unwrap_or_default()
    };
    let blend =
        |a: [f32; 2], b: [f32; 2], share: f32| [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])];
    let (across, down) = (x - column as f32, y - row as f32);
    let above = blend(at(row, column), at(row, column + 1), across);
    let below = blend(at(row + 1, column), at(row + 1, column + 1), across);
    blend(above, below, down)
}
