//! One frame's reduced grey and its coarser levels.

use super::start::Detail;
use rayon::prelude::*;

/// Levels are halved until the longer side is no longer than this.
const COARSEST_SIDE: usize = 64;

/// Levels are not halved to a shorter side than this: a patch and its margin must fit.
const SHORTEST_SIDE: usize = 12;

/// Rows of a level that one task makes.
const BAND: usize = 32;

/// Grey of one resolution, row by row, 0 to 255.
#[derive(Clone, Debug, Default)]
pub(super) struct Level {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) data: Vec<f32>,
}

/// The reduced grey of one frame and its coarser levels.
///
/// Made by [`Sampler::build`](super::Sampler::build), which reuses its buffers: keep two and swap
/// them.
#[derive(Clone, Debug, Default)]
pub struct Pyramid {
    levels: Vec<Level>,
    detail: Detail,
    scratch: Vec<f32>,
    filled: bool,
}

impl Pyramid {
    /// An empty pyramid: a frame in which nothing can be seen.
    pub fn new() -> Self {
        Self::default()
    }

    /// Whether it holds no frame.
    pub fn is_empty(&self) -> bool {
        !self.filled
    }

    /// The levels, finest first; none where it holds no frame.
    pub(super) fn levels(&self) -> &[Level] {
        if self.filled { &self.levels } else { &[] }
    }

    /// What the exhaustive search looks at: the coarsest level without its slow changes.
    pub(super) fn detail(&self) -> &Detail {
        &self.detail
    }

    /// Has `reduce` fill the finest level of `size`, and makes the others from it. Where `reduce`
    /// says false the pyramid is empty.
    pub(super) fn fill(
        &mut self,
        size: (usize, usize),
        reduce: impl FnOnce(&mut Vec<f32>, &mut Vec<f32>) -> bool,
    ) {
        let count = level_count(size);
        self.levels.resize_with(count, Level::default);
        for (index, level) in self.levels.iter_mut().enumerate() {
            (level.width, level.height) = (size.0 >> index, size.1 >> index);
        }
        self.filled = reduce(&mut self.levels[0].data, &mut self.scratch);
        if !self.filled {
            return;
        }
        for index in 1..count {
            let (finer, coarser) = self.levels.split_at_mut(index);
            halve(&finer[index - 1], &mut coarser[0]);
        }
        self.detail.fill(&self.levels[count - 1]);
    }
}

fn level_count((width, height): (usize, usize)) -> usize {
    let mut levels = 1;
    while width.max(height) >> (levels - 1) > COARSEST_SIDE && width.min(height) >> levels >= SHORTEST_SIDE {
        levels += 1;
    }
    levels
}

/// Means of 2 × 2 pixels; an odd last row or column is left out.
fn halve(fine: &Level, coarse: &mut Level) {
    let width = coarse.width;
    coarse.data.resize(width * coarse.height, 0.0);
    coarse.data.par_chunks_mut(width * BAND).enumerate().for_each(|(band, rows)| {
        for (y, row) in rows.chunks_exact_mut(width).enumerate() {
            let source = &fine.data[2 * (band * BAND + y) * fine.width..];
            let (above, below) = source.split_at(fine.width);
            let pairs = above.as_chunks::<2>().0.iter().zip(below.as_chunks::<2>().0);
            for (out, (a, b)) in row.iter_mut().zip(pairs) {
                *out = 0.25 * ((a[0] + b[0]) + (a[1] + b[1]));
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_end_where_a_patch_still_fits() {
        assert_eq!(level_count((960, 540)), 5);
        assert_eq!(level_count((64, 48)), 1);
        assert_eq!(level_count((960, 30)), 2);
        assert_eq!(level_count((1, 1)), 1);
    }

    #[test]
    fn halving_takes_means_and_drops_the_odd_edge() {
        let fine = Level { width: 5, height: 3, data: (0..15).map(|v| v as f32).collect() };
        let mut coarse = Level { width: 2, height: 1, data: Vec::new() };
        halve(&fine, &mut coarse);
        assert_eq!(coarse.data, [3.0, 5.0]);
    }
}
