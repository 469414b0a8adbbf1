//! Cells that the other frame hides: of the motions beside them the one that leads behind something.
//!
//! What the other frame hides has no displacement that could be measured, and lies beside an outline, between two motions:
//! that of the thing in front and that of what lies behind it. Only what lies behind can be hidden. So a cell that was not
//! found, whose pixels none of the motions beside it explains, has the one by which it arrives where the other frame shows
//! something else. Where either could lie behind the other nothing is concluded. A selfie on a fast pan hides a tenth of
//! the picture from both neighbours in time.
//!
//! That is a conclusion and no measurement, and counts little: enough to tell two motions from each other that differ by
//! many pixels, and thus for the residual field to tell on which side of the outline the cell lies.
//!
//! Share of the distortion that is left on the rendered selfie: 34 %, and 47 % without this; other sequences change by half
//! a point. To take the motion that fits the cell's pixels best instead costs five points of `blinds` and `whip_pan`: along
//! stripes and on a blurred pan it often fits by chance.

use super::direction::Direction;
use super::field::{Cell, FlowField};
use super::lanes::Cpu;
use super::level::{CELL, Pair, Search};
use super::patch::{SIDE, Template};
use super::rows::{RowKernel, fill};
use crate::cpu::CpuLevel;

/// From this confidence on a displacement is trusted, as for correspondences.
const TRUSTED: f32 = 0.5;

/// A displacement does not explain the pixels of a cell where it leaves this share of their contrast.
const UNEXPLAINED: f32 = 0.5;

/// What the other frame shows moves otherwise where it comes back to a place this many pixels of the level away …
const ELSEWHERE: f32 = 2.0;

/// … and this share of the displacement more: four times the return error at which a displacement is trusted half.
const ELSEWHERE_SHARE: f32 = 0.08;

/// Motions count as one where they differ by less than this share of what sets them apart from the others.
const ALIKE: f32 = 0.2;

/// Confidence of a cell that is concluded to be hidden; with 0.05 to 0.2 the evaluation's figures change by one point.
const CONFIDENCE: f32 = 0.1;

/// Deviation of its displacement in pixels of the level.
const DEVIATION: f32 = 2.0;

/// The nearest trusted cells to the left and right, above and below of each cell.
#[derive(Debug, Default)]
pub(super) struct Beside {
    cells: Vec<[Option<u32>; 4]>,
    found: Vec<Option<[f32; 2]>>,
}

/// Two frames at the resolution at which a cell has the size of a patch, with what was found on the level that has half of
/// it.
#[derive(Clone, Copy)]
pub(super) struct Frames<'a> {
    pub(super) cpu: CpuLevel,
    pub(super) pair: Pair<'a>,
    /// 2^depth is the ratio of the analysed luma to the level.
    pub(super) depth: usize,
}

/// The direction that is to be completed, and the reverse one, with their fields as they were judged.
#[derive(Clone, Copy)]
pub(super) struct Known<'a> {
    pub(super) own: (&'a Direction, &'a FlowField),
    pub(super) reverse: (&'a Direction, &'a FlowField),
}

impl Frames<'_> {
    /// From the second frame to the first.
    pub(super) fn reversed(self) -> Self {
        Self { pair: self.pair.reversed(), ..self }
    }
}

impl Known<'_> {
    /// For the reverse direction.
    pub(super) fn reversed(self) -> Self {
        Self { own: self.reverse, reverse: self.own }
    }
}

impl Beside {
    /// Finds the hidden cells and their displacements in pixels of the level.
    pub(super) fn find(&mut self, frames: Frames<'_>, known: Known<'_>) {
        let field = known.own.1;
        let (columns, count) = (field.columns, field.cells.len());
        self.cells.clear();
        self.cells.resize(count, [None; 4]);
        let mut sweep = |side: usize, line: &mut dyn Iterator<Item = usize>| {
            let mut last = None;
            for index in line {
                if let (Some(beside), Some(cell)) = (self.cells.get_mut(index), field.cells.get(index)) {
                    beside[side] = last;
                    last = if cell.confidence >= TRUSTED { Some(index as u32) } else { last };
                }
            }
        };
        for row in 0..field.rows {
            let line = row * columns..(row + 1) * columns;
            sweep(0, &mut line.clone());
            sweep(1, &mut line.rev());
        }
        for column in 0..columns {
            let line = (column..count).step_by(columns);
            sweep(2, &mut line.clone());
            sweep(3, &mut line.rev());
        }
        self.found.resize(count, None);
        let hidden = Hidden { frames, known, beside: &self.cells };
        fill(frames.cpu, &hidden, columns, &mut self.found);
    }

    /// Gives the cells that were found to a field.
    pub(super) fn complete(&self, field: &mut FlowField) {
        let pixels = (field.side / CELL as f64) as f32;
        let information = (DEVIATION * pixels).powi(-2);
        for (cell, shift) in field.cells.iter_mut().zip(&self.found) {
            if let Some(shift) = shift {
                *cell = Cell {
                    flow: shift.map(|shift| shift * pixels),
                    confidence: CONFIDENCE,
                    information: [information, 0.0, information],
                };
            }
        }
    }
}

struct Hidden<'a> {
    frames: Frames<'a>,
    known: Known<'a>,
    beside: &'a [[Option<u32>; 4]],
}

impl RowKernel<Option<[f32; 2]>> for Hidden<'_> {
    #[inline(always)]
    fn fill<C: Cpu>(&self, cpu: C, row: usize, out: &mut [Option<[f32; 2]>]) {
        let mut template = Template::new(cpu);
        for (column, out) in out.iter_mut().enumerate() {
            *out = self.displacement(&mut template, column, row);
        }
    }
}

impl Hidden<'_> {
    /// That of a hidden cell, in pixels of the level; `None` for one that is seen, or where nothing tells.
    #[inline(always)]
    fn displacement<C: Cpu>(
        &self,
        template: &mut Template<C>,
        column: usize,
        row: usize,
    ) -> Option<[f32; 2]> {
        let (own, field) = self.known.own;
        let index = row * field.columns + column;
        if field.cells.get(index)?.confidence >= TRUSTED {
            return None;
        }
        let expected = |index: usize| {
            let (column, row) = (index % field.columns, index / field.columns);
            own.prediction.of_patch(self.frames.depth, column * CELL, row * CELL)
        };
        // The motion of a cell beside it, of which the predicted part goes on as predicted.
        let here = expected(index);
        let motion = |beside: &Option<u32>| {
            let beside = (*beside)? as usize;
            let (shift, there) = (own.means.get(beside)?.shift(), expected(beside));
            Some([shift[0] + here[0] - there[0], shift[1] + here[1] - there[1]])
        };
        let motions = self.beside.get(index)?.each_ref().map(motion);
        let mut is_behind = [false; 4];
        for (motion, is_behind) in motions.iter().zip(&mut is_behind) {
            if let Some(motion) = motion {
                // Of what leaves the frame nothing is known.
                *is_behind = self.is_behind(column, row, *motion)?;
            }
        }
        let all = || motions.iter().zip(is_behind).filter_map(|(motion, is)| Some(((*motion)?, is)));
        let (hidden, _) = all().find(|(_, is_behind)| *is_behind)?;
        let distance = |[x, y]: [f32; 2]| (x - hidden[0]).hypot(y - hidden[1]);
        let in_front = all().filter(|(_, is)| !is).map(|(motion, _)| distance(motion));
        let nearest = in_front.reduce(f32::min)?;
        if all().any(|(motion, is_behind)| is_behind && distance(motion) > ALIKE * nearest) {
            return None;
        }
        let [x, y] = [column * SIDE, row * SIDE];
        template.take(self.frames.pair.first, self.frames.pair.noise, x, y)?;
        let search = Search { template, pair: self.frames.pair, x, y };
        let is_unexplained = |(motion, _): ([f32; 2], bool)| {
            let found = search.found(search.at(motion.map(|shift| 2.0 * shift))?).mean;
            let noise = 2.0 * self.frames.pair.noise;
            Some(found.residual() - noise > UNEXPLAINED * (found.energy() + noise))
        };
        all().all(|motion| is_unexplained(motion) == Some(true)).then_some(hidden)
    }

    /// Whether a cell that moves so arrives where the other frame shows something that is trusted to move otherwise; `None`
    /// where it leaves the frame.
    #[inline(always)]
    fn is_behind(&self, column: usize, row: usize, [x, y]: [f32; 2]) -> Option<bool> {
        let (reverse, field) = self.known.reverse;
        let arrival = |at: usize, shift: f32, count: usize| {
            let at = at as f32 + 0.5 + shift / CELL as f32;
            (at >= 0.0 && at < count as f32).then_some(at as usize)
        };
        let (column, row) = (arrival(column, x, field.columns)?, arrival(row, y, field.rows)?);
        let there = row * field.columns + column;
        let back = reverse.means.get(there)?.shift();
        let apart = (back[0] + x).hypot(back[1] + y);
        let is_trusted = field.cells.get(there)?.confidence >= TRUSTED;
        Some(is_trusted && apart > ELSEWHERE + ELSEWHERE_SHARE * x.hypot(y))
    }
}
