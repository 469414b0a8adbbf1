// SPDX-License-Identifier: MIT OR Apache-2.0

//! The flow in one direction, from the coarsest level to the finest.

use super::candidates::{Candidates, CoarserCells, twice};
use super::consensus::Consensus;
use super::estimate::{Mean, PatchFlow};
use super::level::{CELL, LevelPair, cells, find, first_bits, overlap};
use super::patch::{GROUP, PatchGroup};
use super::prediction::FlowPrediction;
use super::rows::{RowKernel, fill};
use super::search::Spreads;
use crate::cpu::CpuLevel;
use crate::lanes::WordCpu;
use crate::lanes::wholes::{ROUND, floor, whole};

/// Gauss–Newton steps from the best candidate: on the coarse levels, where steps are long, and on the finest.
const COARSE_STEPS: usize = 3;
const FINE_STEPS: usize = 2;

/// Gauss–Newton steps after propagation from neighbouring patches.
const PROPAGATION_STEPS: usize = 1;

/// Levels up to this depth do not propagate between neighbouring patches: the coarser cells already provide
/// the same candidates.
const LAST_DEPTH_WITHOUT_PROPAGATION: usize = 2;

/// Gauss–Newton steps from the dominant motion, which may be off by some pixels: the readout and perspective
/// bend a motion that is modelled as affine.
const CONSENSUS_STEPS: usize = 4;

/// Patches further than this from the dominant motion, in pixels of the level, are compared with it.
const MIN_CONSENSUS_DISTANCE: f32 = 2.0;

/// The dominant motion is preferred if its residual is less than this many times that of the patch's own
/// displacement …
const CONSENSUS_RESIDUAL_RATIO: f32 = 2.0;

/// … plus this share of the contrast: the residual of linear interpolation at sharp edges.
const INTERPOLATION_RESIDUAL: f32 = 0.05;

/// Factor on the structure tensor of a patch that takes the dominant motion: the picture is consistent with
/// that motion but does not measure it. From a tenth to a thousandth changes little.
const CONSENSUS_TEXTURE_FACTOR: f32 = 0.1;

/// One level of the pyramids and its place among the others.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stage<'a> {
    pub(super) cpu: CpuLevel,
    pub(super) pair: LevelPair<'a>,
    /// It is 2^depth times coarser than the analysed luma.
    pub(super) depth: usize,
    /// The first level that is run.
    pub(super) is_coarsest: bool,
    /// The last level that is run.
    pub(super) is_finest: bool,
}

impl Stage<'_> {
    /// The same level from the second frame to the first.
    pub(super) fn reversed(self) -> Self {
        Self { pair: self.pair.reversed(), ..self }
    }
}

/// State of one flow direction.
#[derive(Debug, Default)]
pub(super) struct FlowDirection {
    pub(super) prediction: FlowPrediction,
    /// Of the level run last, and as many as the largest has.
    patches: Vec<PatchFlow>,
    next_patches: Vec<PatchFlow>,
    /// As many as the largest level has; [`means`](Self::means) are those of the level run last.
    cells: Vec<Mean>,
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// Per cell, the negated displacement of the opposite direction that ends there and its residual, if any.
    reversed: Vec<Option<([f32; 2], f32)>>,
    /// Of the second frame's coarsest level.
    spreads: Spreads,
}

/// Kernel that finds the patches of a level from the coarser level, the prediction and the opposite
/// direction.
#[derive(Clone, Copy)]
struct CoarseToFine<'a> {
    stage: Stage<'a>,
    prediction: &'a FlowPrediction,
    coarse: CoarserCells<'a>,
    reversed: &'a [Option<([f32; 2], f32)>],
    spreads: &'a Spreads,
}

impl FlowDirection {
    /// Runs one level, starting from the coarser ones.
    pub(super) fn run(&mut self, stage: &Stage<'_>) {
        if stage.is_coarsest {
            self.spreads.fill(stage.cpu, stage.pair.second);
        }
        let (columns, rows) = cells(stage.pair.first);
        let (across, down) = (columns.saturating_sub(1).max(1), rows.saturating_sub(1).max(1));
        let kernel = CoarseToFine {
            stage: *stage,
            prediction: &self.prediction,
            coarse: CoarserCells {
                means: self.cells.get(..self.columns * self.rows).unwrap_or_default(),
                columns: self.columns,
                rows: self.rows,
            },
            reversed: &self.reversed,
            spreads: &self.spreads,
        };
        let count = across * down;
        // All are written: none are cleared where the last level had more.
        if self.patches.len() < count {
            self.patches.resize(count, PatchFlow::default());
            self.next_patches.resize(count, PatchFlow::default());
        }
        let (mut patches, mut next) = (&mut self.patches[..count], &mut self.next_patches[..count]);
        fill(stage.cpu, &kernel, across, patches);
        let propagations =
            if stage.is_coarsest { 2 } else { usize::from(stage.depth > LAST_DEPTH_WITHOUT_PROPAGATION) };
        for _ in 0..propagations {
            fill(stage.cpu, &Propagation { pair: stage.pair, patches }, across, next);
            std::mem::swap(&mut patches, &mut next);
        }
        let consensus = stage.is_finest.then(|| Consensus::of(patches, across, stage.pair.noise)).flatten();
        if let Some(consensus) = consensus {
            let trial = ConsensusTrial { stage: *stage, patches, prediction: &self.prediction, consensus };
            fill(stage.cpu, &trial, across, next);
            std::mem::swap(&mut patches, &mut next);
        }
        (self.columns, self.rows) = (columns, rows);
        let count = columns * rows;
        if self.cells.len() < count {
            self.cells.resize(count, Mean::default());
        }
        let overlap = Overlap { patches, across };
        fill(stage.cpu, &overlap, columns, &mut self.cells[..count]);
    }

    /// The cells of the level run last.
    #[inline(always)]
    pub(super) fn means(&self) -> &[Mean] {
        self.cells.get(..self.columns * self.rows).unwrap_or_default()
    }

    /// Stores the negated displacements of the opposite direction at the cells where they end; of two that
    /// end in one cell the one of the smaller residual.
    pub(super) fn take_reverse(&mut self, other: &Self) {
        self.reversed.clear();
        self.reversed.resize(self.columns * self.rows, None);
        let side = CELL as f32;
        for (index, mean) in other.means().iter().enumerate() {
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

    /// Clears the state of the previous pair.
    pub(super) fn restart(&mut self) {
        self.reversed.clear();
        (self.columns, self.rows) = (0, 0);
    }

    /// The displacements at eight points, interpolated bilinearly between cells and constant beyond the outermost; both
    /// in pixels of the level.
    #[inline(always)]
    pub(super) fn at<C: WordCpu>(&self, cpu: C, [x, y]: [C::Lanes; 2]) -> [C::Lanes; 2] {
        let last = [self.columns, self.rows].map(|count| count.saturating_sub(1));
        let (x, y) = (place(cpu, x, last[0]), place(cpu, y, last[1]));
        let (column, row) = (floor(cpu, x), floor(cpu, y));
        let index = column + cpu.splat(self.columns as f32) * row;
        let (across, down) = (cpu.store(x - column), cpu.store(y - row));
        let means = self.means();
        // Beyond the last column and row a cell counts nothing.
        let at = |index: usize| means.get(index).map(|mean| &mean.0).unwrap_or(&[0.0; GROUP]);
        let mut cells = [x; GROUP];
        for (k, index) in cpu.store(index + cpu.splat(ROUND)).into_iter().enumerate() {
            let (first, across) = (whole(index) as usize, cpu.splat(across[k]));
            let below = first + self.columns;
            let upper = blended(cpu, [at(first), at(first + 1)], across);
            let lower = blended(cpu, [at(below), at(below + 1)], across);
            cells[k] = upper + cpu.splat(down[k]) * (lower - upper);
        }
        let [x, y, ..] = cpu.transposed(cells);
        [x, y]
    }
}

/// Positions in pixels as positions among cells, from the first to the last.
#[inline(always)]
fn place<C: WordCpu>(cpu: C, at: C::Lanes, last: usize) -> C::Lanes {
    let half = cpu.splat(0.5);
    cpu.clamped(cpu.splat(1.0 / CELL as f32) * (at + half) - half, 0.0, last as f32)
}

#[inline(always)]
fn blended<C: WordCpu>(cpu: C, [from, to]: [&[f32; GROUP]; 2], share: C::Lanes) -> C::Lanes {
    let from = cpu.load(from);
    from + share * (cpu.load(to) - from)
}

impl RowKernel<PatchFlow> for CoarseToFine<'_> {
    type Scratch<C: WordCpu> = PatchGroup<C>;

    #[inline(always)]
    fn fill<C: WordCpu>(&self, cpu: C, group: &mut PatchGroup<C>, row: usize, out: &mut [PatchFlow]) {
        let Stage { pair, is_coarsest, is_finest, .. } = self.stage;
        let found = if is_coarsest {
            self.search(group, row, out)
        } else if is_finest {
            let candidates = |first: usize, _: usize| self.coarse.finest(cpu, first, row);
            find(group, pair, row, FINE_STEPS, candidates, out)
        } else {
            let candidates = |first: usize, count: usize| {
                Candidates::distinct(cpu, count, |k| self.candidates(first + k, row))
            };
            find(group, pair, row, COARSE_STEPS, candidates, out)
        };
        if found.is_none() {
            out.fill(PatchFlow::default());
        }
    }
}

/// Kernel that tries the displacements of the four neighbouring patches.
struct Propagation<'a> {
    pair: LevelPair<'a>,
    patches: &'a [PatchFlow],
}

impl RowKernel<PatchFlow> for Propagation<'_> {
    type Scratch<C: WordCpu> = PatchGroup<C>;

    #[inline(always)]
    fn fill<C: WordCpu>(&self, cpu: C, group: &mut PatchGroup<C>, row: usize, out: &mut [PatchFlow]) {
        let across = out.len();
        let at = |row: usize, column: usize| {
            let found = (column < across).then(|| self.patches.get(row * across + column)).flatten();
            found.map(|found| found.mean.shift())
        };
        let candidates = |column: usize| {
            let own = at(row, column).unwrap_or_default();
            // Wraps at column 0 to an index that no row has.
            let neighbours = [
                at(row, column.wrapping_sub(1)),
                at(row, column + 1),
                row.checked_sub(1).and_then(|row| at(row, column)),
                at(row + 1, column),
            ];
            let [left, right, above, below] = neighbours.map(|neighbour| neighbour.unwrap_or(own));
            [own, left, right, above, below]
        };
        let candidates =
            |first: usize, count: usize| Candidates::distinct(cpu, count, |k| candidates(first + k));
        if find(group, self.pair, row, PROPAGATION_STEPS, candidates, out).is_none() {
            out.fill(PatchFlow::default());
        }
    }
}

/// Kernel that replaces a patch's displacement by the dominant or the predicted one where their residuals are
/// comparable: along edges, in flat areas and on repetitive texture.
struct ConsensusTrial<'a> {
    stage: Stage<'a>,
    patches: &'a [PatchFlow],
    prediction: &'a FlowPrediction,
    consensus: Consensus,
}

impl RowKernel<PatchFlow> for ConsensusTrial<'_> {
    type Scratch<C: WordCpu> = PatchGroup<C>;

    #[inline(always)]
    fn fill<C: WordCpu>(&self, _: C, group: &mut PatchGroup<C>, row: usize, out: &mut [PatchFlow]) {
        let across = out.len();
        let own = self.patches.get(row * across..).unwrap_or_default();
        out.iter_mut().zip(own).for_each(|(out, own)| *out = *own);
        let (mut columns, mut count) = ([0; GROUP], 0);
        let mut shifts = [[[0.0; GROUP]; 2]; 2];
        for column in 0..across {
            let (x, y) = (column * CELL, row * CELL);
            let [own_x, own_y] = out[column].mean.shift();
            let is_apart = |other: [f32; 2]| {
                let (dx, dy) = (own_x - other[0], own_y - other[1]);
                dx * dx + dy * dy > MIN_CONSENSUS_DISTANCE * MIN_CONSENSUS_DISTANCE
            };
            let shared = self.consensus.of_patch(x, y);
            if is_apart(shared) {
                let predicted = self.prediction.of_patch(self.stage.depth, x, y);
                if is_apart(predicted) {
                    for (shifts, shift) in shifts.iter_mut().zip([predicted, shared]) {
                        (shifts[0][count], shifts[1][count]) = (shift[0], shift[1]);
                    }
                    columns[count] = column;
                    count += 1;
                }
            }
            if count == GROUP || column + 1 == across {
                let _ = self.replace(group, row, &columns[..count], &shifts, out);
                count = 0;
            }
        }
    }
}

impl ConsensusTrial<'_> {
    /// Replaces the patches of some columns, as many as a group holds, from two displacements each.
    #[inline(always)]
    fn replace<C: WordCpu>(
        &self,
        group: &mut PatchGroup<C>,
        row: usize,
        columns: &[usize],
        shifts: &[[[f32; GROUP]; 2]; 2],
        out: &mut [PatchFlow],
    ) -> Option<()> {
        if columns.is_empty() {
            return None;
        }
        let (pair, cpu) = (self.stage.pair, group.cpu);
        let mut corners = [[0; 2]; GROUP];
        for (corner, column) in corners.iter_mut().zip(columns) {
            *corner = [column * CELL, row * CELL];
        }
        group.take(pair.first, pair.noise, corners.get(..columns.len())?)?;
        let [[a, b], [c, d]] = shifts;
        let from = [[cpu.load(a), cpu.load(b)], [cpu.load(c), cpu.load(d)]];
        let best = group.best_of_two(pair, from, CONSENSUS_STEPS, first_bits(columns.len()))?;
        for (column, found) in columns.iter().zip(group.found(&best, pair.noise)) {
            let own = out.get_mut(*column)?;
            let limit =
                CONSENSUS_RESIDUAL_RATIO * own.mean.residual() + INTERPOLATION_RESIDUAL * own.mean.energy();
            if found.mean.residual() < limit {
                *own = found.with_scaled_tensor(CONSENSUS_TEXTURE_FACTOR);
            }
        }
        Some(())
    }
}

/// Kernel that averages overlapping patches into cells.
struct Overlap<'a> {
    patches: &'a [PatchFlow],
    across: usize,
}

impl RowKernel<Mean> for Overlap<'_> {
    type Scratch<C: WordCpu> = ();

    #[inline(always)]
    fn fill<C: WordCpu>(&self, cpu: C, (): &mut (), row: usize, out: &mut [Mean]) {
        overlap(cpu, self.patches, self.across, row, out);
    }
}

impl CoarseToFine<'_> {
    /// Patches of the coarsest level. Prediction and search result are compared after the steps only: at half
    /// a pixel of error on this level, residuals do not discriminate.
    #[inline(always)]
    fn search<C: WordCpu>(&self, group: &mut PatchGroup<C>, row: usize, out: &mut [PatchFlow]) -> Option<()> {
        let cpu = group.cpu;
        let pair = self.stage.pair;
        for (index, out) in out.chunks_mut(GROUP).enumerate() {
            let corner = |k: usize| [(index * GROUP + k) * CELL, row * CELL];
            let corners: [[usize; 2]; GROUP] = std::array::from_fn(corner);
            let corners = corners.get(..out.len())?;
            group.take(pair.first, pair.noise, corners)?;
            let mut shifts = [[[0.0; GROUP]; 2]; 2];
            for (k, corner) in corners.iter().enumerate() {
                let predicted = self.prediction.of_patch(self.stage.depth, corner[0], corner[1]);
                for (shifts, shift) in
                    shifts.iter_mut().zip([predicted, self.spreads.exhaustive(group, k, pair, *corner)])
                {
                    (shifts[0][k], shifts[1][k]) = (shift[0], shift[1]);
                }
            }
            let [[a, b], [c, d]] = &shifts;
            let from = [[cpu.load(a), cpu.load(b)], [cpu.load(c), cpu.load(d)]];
            let best = group.best_of_two(pair, from, COARSE_STEPS, first_bits(out.len()))?;
            for (out, found) in out.iter_mut().zip(group.found(&best, pair.noise)) {
                *out = found;
            }
        }
        Some(())
    }

    /// Candidate displacements. The prediction comes first and so is preferred on ambiguous, such as
    /// repetitive, texture.
    #[inline(always)]
    fn candidates(&self, column: usize, row: usize) -> [[f32; 2]; 8] {
        let predicted = self.prediction.of_patch(self.stage.depth, column * CELL, row * CELL);
        let (interpolated, [a, b, c, d]) = self.coarse.around(column, row);
        let own = self.reversed.get((row / 2) * self.coarse.columns + column / 2);
        let reversed = own.copied().flatten().map_or(interpolated, |(shift, _)| twice(shift));
        [predicted, interpolated, a, b, c, d, reversed, [0.0; 2]]
    }
}
