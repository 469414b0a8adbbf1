//! The inverse map as the kernels read it: blocks of 16 pixels of one row.
//!
//! A displacement is linear between *knots* 8 plane pixels apart. That leaves 8²/8 · f″ = 3e-3 px for
//! 0.2 rad in 1080 rows; positions are then rounded to 1/2048 px.
//!
//! Along a row the position is almost "pixel + constant": inside a block the whole part of the
//! displacement takes few values, mostly one. A block therefore holds the least whole part, how
//! many more there are, and the rest as 16-bit numbers; a kernel reads as many neighbouring
//! vectors as there are taps and whole parts, never gathers.

use super::Placement;
use super::inverse::{Field, cubic};
use super::kernels;
use super::weights::{FRACTION_BITS, ONE};
use crate::cpu::CpuLevel;

/// Pixels in a block.
pub(super) const BLOCK: usize = 16;
/// Pixels between knots.
pub(super) const KNOT: usize = 8;
/// How far the displacement may change between two knots, in 1/[`ONE`] px: 7 px are what the largest
/// zoom asks for (1/8 − 1 a pixel), and twice as much still fits into 16 bits.
const MAX_CHANGE: i32 = 7 * ONE;

/// Displacements in plane pixels, at most: a scale near zero makes them infinite, or no number, which the vector
/// kernels would take for another place than plain Rust.
const FARTHEST: f32 = 4e5;

/// Displacements of 16 pixels. The vector kernels read `start` and `change` as its first 8 bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub(super) struct Block {
    /// Displacement at pixels 0 and 8 less `first`, in 1/[`ONE`] px; not negative.
    pub start: [i16; 2],
    /// What is added from there over 8 pixels.
    pub change: [i16; 2],
    /// The least whole displacement.
    pub first: i32,
    /// The largest whole displacement less the least.
    pub span: i32,
}

impl Block {
    /// The block between three knots given in 1/[`ONE`] px.
    fn new(knots: [i32; 3]) -> Self {
        let middle = knots[0] + (knots[1] - knots[0]).clamp(-MAX_CHANGE, MAX_CHANGE);
        let end = middle + (knots[2] - middle).clamp(-MAX_CHANGE, MAX_CHANGE);
        let first = knots[0].min(middle).min(end) >> FRACTION_BITS;
        let last = knots[0].max(middle).max(end) >> FRACTION_BITS;
        let base = first << FRACTION_BITS;
        Self {
            start: [(knots[0] - base) as i16, (middle - base) as i16],
            change: [(middle - knots[0]) as i16, (end - middle) as i16],
            first,
            span: last - first,
        }
    }

    /// Whole displacement and fraction of pixel 0 to 15.
    pub fn at(&self, pixel: usize) -> (isize, i16) {
        let half = (pixel / KNOT) & 1;
        let ramp = ((pixel % KNOT) << 12) as i16;
        let value = self.start[half] + super::weights::mulhrs(self.change[half], ramp);
        let whole = self.first + i32::from(value >> FRACTION_BITS);
        (whole as isize, value & (ONE as i16 - 1))
    }
}

/// One displacement field of one plane: knots of the plane's columns at the rows of the field's nodes.
#[derive(Clone, Debug, Default)]
pub(super) struct KnotTable {
    /// Index of the first knot; knot k lies at plane column 8k.
    first: isize,
    /// Knots in a row.
    columns: usize,
    /// Displacements in plane pixels, row by row.
    values: Vec<f32>,
    /// Plane row of node row 0.
    origin: f64,
    /// Plane rows between node rows.
    spacing: f64,
}

impl KnotTable {
    /// Resamples `field` at knots that cover plane columns `from` to `to`; `axis` is the one along
    /// which the field displaces.
    pub fn fill(&mut self, field: &Field, placement: &Placement, axis: usize, from: isize, to: isize) {
        let [scale_x, scale_y] = placement.scale;
        self.first = from.div_euclid(BLOCK as isize) * 2;
        self.columns = (to.div_euclid(BLOCK as isize) * 2 + 3 - self.first).max(3) as usize;
        self.origin = (field.y.first - placement.offset[1]) / scale_y;
        self.spacing = field.y.spacing / scale_y;
        self.values.clear();
        self.values.resize(self.columns * field.y.count, 0.0);
        for index in 0..self.columns {
            let column = ((self.first + index as isize) * KNOT as isize) as f64;
            let at = (scale_x * column + placement.offset[0] - field.x.first) / field.x.spacing;
            let (node, weights) = cubic(at, field.x.count);
            let weights = weights.map(|weight| weight as f32 / placement.scale[axis] as f32);
            let nodes = field.values.chunks_exact(field.x.count.max(1));
            for (row, nodes) in self.values.chunks_exact_mut(self.columns).zip(nodes) {
                let value = weights.iter().zip(&nodes[node..]).map(|(w, v)| w * v).sum();
                row[index] = if f32::is_nan(value) { 0.0 } else { value.clamp(-FARTHEST, FARTHEST) };
            }
        }
    }

    /// Displacements at all knots of plane row `row`, in 1/[`ONE`] px plus `round`.
    pub fn row(&self, level: CpuLevel, row: usize, round: i32, knots: &mut Vec<i32>) {
        let rows = self.values.len() / self.columns.max(1);
        let (node, weights) = cubic((row as f64 - self.origin) / self.spacing, rows);
        let nodes = &self.values[node * self.columns..(node + 4) * self.columns];
        knots.resize(self.columns, 0);
        kernels::knots(level, nodes, weights.map(|weight| weight as f32 * ONE as f32), round as f32, knots);
    }

    /// The blocks of plane columns `from` (a multiple of 16) to `to`, from the knots of a row. Where
    /// the table does not reach, its last displacement goes on.
    pub fn blocks(&self, knots: &[i32], from: isize, to: isize, blocks: &mut Vec<Block>) {
        let (from, to) = (from.div_euclid(BLOCK as isize), to.div_euclid(BLOCK as isize));
        let last = knots.len() as isize - 1;
        let knot = |index: isize| knots[index.clamp(0, last) as usize];
        // Blocks before, within and past the table.
        let known = (knots.len() - 1) / 2;
        let first = from * 2 - self.first;
        let outside = |index: isize| Block::new([knot(index), knot(index + 1), knot(index + 2)]);
        let before = (-first / 2).clamp(0, to - from + 1);
        blocks.clear();
        blocks.extend((0..before).map(|block| outside(first + 2 * block)));
        let start = (first.max(0) / 2) as usize;
        let count = known.saturating_sub(start).min((to - from + 1 - before) as usize);
        if let Some(inside) = knots.get(2 * start..) {
            let (pairs, _) = inside.as_chunks::<2>();
            let ends = inside.get(2..).unwrap_or_default().iter().step_by(2);
            let added = blocks.len();
            blocks.resize(added + count, Block::default());
            for ((block, k), end) in blocks[added..].iter_mut().zip(pairs).zip(ends) {
                *block = Block::new([k[0], k[1], *end]);
            }
        }
        blocks.extend((blocks.len() as isize..=to - from).map(|block| outside(first + 2 * block)));
    }
}
