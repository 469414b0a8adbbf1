// SPDX-License-Identifier: MIT OR Apache-2.0

//! Rows of samples that are checked once.

use super::FLOATS;

/// `COUNT` rows of at least `WIDTH` samples, all within one slice.
#[derive(Clone, Copy)]
pub(crate) struct SampleRows<'a, const COUNT: usize, const WIDTH: usize> {
    samples: &'a [f32],
    stride: usize,
}

impl<'a, const COUNT: usize, const WIDTH: usize> SampleRows<'a, COUNT, WIDTH> {
    /// Rows `stride` samples apart, starting at the first sample; `None` if the slice is too short.
    #[inline(always)]
    pub(crate) fn new(samples: &'a [f32], stride: usize) -> Option<Self> {
        let reach = (COUNT - 1).checked_mul(stride)?.checked_add(WIDTH)?;
        (reach <= samples.len()).then_some(Self { samples, stride })
    }

    /// Eight samples of row `r` from column `c` on.
    #[inline(always)]
    pub(crate) fn at(self, r: usize, c: usize) -> &'a [f32; FLOATS] {
        // Compiled away where the indices are constants.
        assert!(r < COUNT && c + FLOATS <= WIDTH);
        // SAFETY: r·stride + c + 8 ≤ (COUNT − 1)·stride + WIDTH ≤ the slice's length, by `new` and the line
        // above.
        unsafe { &*self.samples.as_ptr().add(r * self.stride + c).cast() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A slice without a sample to spare does; a shorter one is refused, and no stride is too large to be
    /// multiplied.
    #[test]
    fn rows_lie_within_their_slice() {
        let samples: Vec<f32> = (0..29).map(|i| i as f32).collect();
        let rows = SampleRows::<3, 9>::new(&samples, 10).unwrap();
        assert_eq!((rows.at(0, 0)[0], rows.at(2, 1)[7]), (0.0, 28.0));
        assert!(SampleRows::<3, 9>::new(&samples[1..], 10).is_none());
        assert!(SampleRows::<3, 9>::new(&samples, usize::MAX / 2).is_none());
    }

    #[test]
    #[should_panic]
    fn a_row_too_many_is_no_row() {
        SampleRows::<3, 9>::new(&[0.0; 100], 10).unwrap().at(3, 0);
    }
}
