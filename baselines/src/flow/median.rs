// SPDX-License-Identifier: MIT OR Apache-2.0

//! The median of 5 × 5 pixels.

use super::image::Image;
use rayon::prelude::*;

/// Pixels on each side of the middle one.
const REACH: usize = 2;

/// Pixels of the neighbourhood.
const COUNT: usize = 25;

/// Neighbouring pixels that are filtered at once, in vectors.
const LANES: usize = 8;

/// As many numbers as are filtered at once.
type Lanes = [f32; LANES];

/// Each pixel becomes the median of the 5 × 5 around it; the border goes on as it is.
pub fn filtered(image: &Image) -> Image {
    let (width, height) = (image.width, image.height);
    let mut data = vec![0.0; image.data.len()];
    data.par_chunks_mut(width).enumerate().with_min_len(16).for_each(|(y, out)| {
        let rows: [Vec<f32>; 2 * REACH + 1] = std::array::from_fn(|j| {
            let row = (y + j).saturating_sub(REACH).min(height - 1);
            extended(image.row(row))
        });
        for (block, out) in out.chunks_mut(LANES).enumerate() {
            let around = std::array::from_fn(|k| {
                let (row, from) = (&rows[k / 5], block * LANES + k % 5);
                std::array::from_fn(|lane| row[from..][..LANES][lane])
            });
            out.copy_from_slice(&median(around)[..out.len()]);
        }
    });
    Image::new(width, height, data)
}

/// A row and, on each side, enough copies of its ends for whole blocks and their neighbours.
fn extended(row: &[f32]) -> Vec<f32> {
    let (first, last) = (row[0], row[row.len() - 1]);
    let right = REACH + LANES;
    [vec![first; REACH].as_slice(), row, vec![last; right].as_slice()].concat()
}

/// The median of 25 numbers, in each lane.
///
/// Of any 14 of them neither the smallest nor the greatest is the median (13 are on one side of each),
/// so these two are dropped, one is taken in, and so on until the three left hold it in their middle.
fn median(values: [Lanes; COUNT]) -> Lanes {
    const HALF: usize = COUNT / 2 + 2;
    let mut kept: [Lanes; HALF] = std::array::from_fn(|k| values[k]);
    let mut count = HALF;
    for next in values.iter().skip(HALF).map(Some).chain([None]) {
        extremes_to_ends(&mut kept[..count]);
        // The greatest, at the end, is forgotten; the smallest makes room for the next.
        count -= 1;
        if let Some(next) = next {
            kept[0] = *next;
        }
    }
    debug_assert_eq!(count, 2);
    kept[1]
}

/// Swaps until the smallest is first and the greatest last.
#[inline(always)]
fn extremes_to_ends(values: &mut [Lanes]) {
    let last = values.len() - 1;
    for k in 0..values.len() / 2 {
        exchange(values, k, last - k);
    }
    // The smallest is now in the lower half, the greatest in the upper one (the middle of an odd
    // number belongs to both).
    for k in 1..values.len().div_ceil(2) {
        exchange(values, 0, k);
        exchange(values, last - k, last);
    }
}

/// Orders two of the values.
#[inline(always)]
fn exchange(values: &mut [Lanes], low: usize, high: usize) {
    let (a, b) = (values[low], values[high]);
    let (mut least, mut greatest) = (a, a);
    for lane in 0..LANES {
        least[lane] = if b[lane] < a[lane] { b[lane] } else { a[lane] };
    }
    for lane in 0..LANES {
        greatest[lane] = if b[lane] > a[lane] { b[lane] } else { a[lane] };
    }
    values[low] = least;
    values[high] = greatest;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_by_sorting() {
        let image = Image::from_fn(21, 9, |x, y| ((x * 7919 + y * 104_729) % 97) as f32);
        let found = filtered(&image);
        for y in 0..9 {
            for x in 0..21 {
                let mut around: Vec<f32> =
                    (0..25).map(|k| image.clamped(x as isize + k % 5 - 2, y as isize + k / 5 - 2)).collect();
                around.sort_by(f32::total_cmp);
                assert_eq!(found.at(x, y), around[12], "at {x}, {y}");
            }
        }
    }

    #[test]
    fn a_spike_is_gone_and_a_plane_stays() {
        let plane = Image::from_fn(16, 16, |x, y| 0.5 * x as f32 - 0.25 * y as f32);
        let mut spiked = plane.clone();
        spiked.data[8 * 16 + 8] = 100.0;
        let found = filtered(&spiked);
        assert!((found.at(8, 8) - plane.at(8, 8)).abs() <= 0.25);
        assert_eq!(filtered(&plane).at(4, 9), plane.at(4, 9));
    }
}
