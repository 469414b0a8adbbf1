//! AVX2: a row of a patch is one register.

use super::{AREA, Block, Centred, SIDE, Sums, free_of_contrast};
use std::arch::x86_64::{
    __m128, __m256, _mm_add_ps, _mm_cvtss_f32, _mm_hadd_ps, _mm_max_ps, _mm_movehl_ps, _mm_movelh_ps,
    _mm_mul_ps, _mm_set1_ps, _mm_setzero_ps, _mm_shuffle_ps, _mm_storeu_ps, _mm_sub_ps, _mm256_add_ps,
    _mm256_castps256_ps128, _mm256_extractf128_ps, _mm256_hadd_ps, _mm256_loadu_ps, _mm256_mul_ps,
    _mm256_set1_ps, _mm256_setzero_ps, _mm256_storeu_ps, _mm256_sub_ps,
};

/// Rows of samples of which the first `count`, each of `width`, lie within the slice.
#[derive(Clone, Copy)]
struct Rows<'a> {
    samples: &'a [f32],
    stride: usize,
}

impl<'a> Rows<'a> {
    #[inline]
    fn new(samples: &'a [f32], stride: usize, count: usize, width: usize) -> Option<Self> {
        (count.checked_sub(1)?.checked_mul(stride)?.checked_add(width)? <= samples.len())
            .then_some(Self { samples, stride })
    }

    /// Eight samples of row `r` from column `c` on.
    ///
    /// # Safety
    /// `r` is less than the `count` and `c` + 8 at most the `width` that the rows were made with.
    #[inline]
    #[target_feature(enable = "avx2")]
    unsafe fn load(self, r: usize, c: usize) -> __m256 {
        // SAFETY: r·stride + c + 8 ≤ (count − 1)·stride + width ≤ the slice's length.
        unsafe { _mm256_loadu_ps(self.samples.as_ptr().add(r * self.stride + c)) }
    }
}

#[inline]
#[target_feature(enable = "avx2")]
fn row(lanes: &[f32; SIDE]) -> __m256 {
    // SAFETY: eight samples are borrowed.
    unsafe { _mm256_loadu_ps(lanes.as_ptr()) }
}

#[inline]
#[target_feature(enable = "avx2")]
fn store(lanes: __m256, out: &mut [f32; SIDE]) {
    // SAFETY: eight samples are borrowed, exclusively.
    unsafe { _mm256_storeu_ps(out.as_mut_ptr(), lanes) }
}

/// Sums of the left and of the right halves of four rows: left of the first to the fourth, then right.
#[inline]
#[target_feature(enable = "avx2")]
fn halves(a: __m256, b: __m256, c: __m256, d: __m256) -> __m256 {
    _mm256_hadd_ps(_mm256_hadd_ps(a, b), _mm256_hadd_ps(c, d))
}

/// Sums of four rows.
#[inline]
#[target_feature(enable = "avx2")]
fn totals(a: __m256, b: __m256, c: __m256, d: __m256) -> [f32; 4] {
    let halves = halves(a, b, c, d);
    let sums = _mm_add_ps(_mm256_castps256_ps128(halves), _mm256_extractf128_ps::<1>(halves));
    let mut four = [0.0; 4];
    // SAFETY: four samples are borrowed, exclusively.
    unsafe { _mm_storeu_ps(four.as_mut_ptr(), sums) };
    four
}

#[target_feature(enable = "avx2")]
pub(super) fn centred(samples: &[f32], stride: usize) -> Option<Centred> {
    let rows = Rows::new(samples, stride, SIDE + 2, SIDE + 2)?;
    let (zero, half) = (_mm256_setzero_ps(), _mm256_set1_ps(0.5));
    let (mut values, mut gradient_x, mut gradient_y) = ([zero; SIDE], [zero; SIDE], [zero; SIDE]);
    let mut sums = [zero; 3];
    for r in 0..SIDE {
        // SAFETY: rows 0 to 9, columns 0 to 9.
        let (above, left, here, right, below) = unsafe {
            (
                rows.load(r, 1),
                rows.load(r + 1, 0),
                rows.load(r + 1, 1),
                rows.load(r + 1, 2),
                rows.load(r + 2, 1),
            )
        };
        values[r] = here;
        gradient_x[r] = _mm256_mul_ps(half, _mm256_sub_ps(right, left));
        gradient_y[r] = _mm256_mul_ps(half, _mm256_sub_ps(below, above));
        sums[0] = _mm256_add_ps(sums[0], values[r]);
        sums[1] = _mm256_add_ps(sums[1], gradient_x[r]);
        sums[2] = _mm256_add_ps(sums[2], gradient_y[r]);
    }
    let means = totals(sums[0], sums[1], sums[2], zero).map(|sum| _mm256_set1_ps(sum * (1.0 / AREA)));
    let block = [[0.0; SIDE]; SIDE];
    let mut out = Centred { values: block, gradient_x: block, gradient_y: block, products: [0.0; 4] };
    let mut products = [zero; 6];
    for r in 0..SIDE {
        let value = _mm256_sub_ps(values[r], means[0]);
        let dx = _mm256_sub_ps(gradient_x[r], means[1]);
        let dy = _mm256_sub_ps(gradient_y[r], means[2]);
        store(value, &mut out.values[r]);
        (values[r], gradient_x[r], gradient_y[r]) = (value, dx, dy);
        products[0] = _mm256_add_ps(products[0], _mm256_mul_ps(dx, dx));
        products[1] = _mm256_add_ps(products[1], _mm256_mul_ps(dx, dy));
        products[2] = _mm256_add_ps(products[2], _mm256_mul_ps(dy, dy));
        products[3] = _mm256_add_ps(products[3], _mm256_mul_ps(value, value));
        products[4] = _mm256_add_ps(products[4], _mm256_mul_ps(dx, value));
        products[5] = _mm256_add_ps(products[5], _mm256_mul_ps(dy, value));
    }
    let [xx, xy, yy, energy, x, y] = products;
    let [xx, xy, yy, energy] = totals(xx, xy, yy, energy);
    let [x, y, ..] = totals(x, y, zero, zero);
    let (products, shares) = free_of_contrast([xx, xy, yy, energy, x, y]);
    let [x, y] = shares.map(|share| _mm256_set1_ps(share));
    for r in 0..SIDE {
        store(_mm256_sub_ps(gradient_x[r], _mm256_mul_ps(x, values[r])), &mut out.gradient_x[r]);
        store(_mm256_sub_ps(gradient_y[r], _mm256_mul_ps(y, values[r])), &mut out.gradient_y[r]);
    }
    out.products = products;
    Some(out)
}

#[target_feature(enable = "avx2")]
pub(super) fn sums(patch: &Centred, samples: &[f32], stride: usize, across: f32, down: f32) -> Option<Sums> {
    let rows = Rows::new(samples, stride, SIDE + 1, SIDE + 1)?;
    let (across, down, zero) = (_mm256_set1_ps(across), _mm256_set1_ps(down), _mm256_setzero_ps());
    // SAFETY: called with rows 0 to 8, columns 0 to 8.
    let blended = |r: usize| unsafe {
        let (left, right) = (rows.load(r, 0), rows.load(r, 1));
        _mm256_add_ps(left, _mm256_mul_ps(across, _mm256_sub_ps(right, left)))
    };
    let (mut slope_x, mut slope_y) = (zero, zero);
    let (mut differences, mut squares) = ([zero; 2], [zero; 2]);
    let mut above = blended(0);
    for half in 0..2 {
        let (mut mean, mut square) = (zero, zero);
        for r in half * (SIDE / 2)..(half + 1) * (SIDE / 2) {
            let below = blended(r + 1);
            let sample = _mm256_add_ps(above, _mm256_mul_ps(down, _mm256_sub_ps(below, above)));
            let difference = _mm256_sub_ps(sample, row(&patch.values[r]));
            slope_x = _mm256_add_ps(slope_x, _mm256_mul_ps(row(&patch.gradient_x[r]), difference));
            slope_y = _mm256_add_ps(slope_y, _mm256_mul_ps(row(&patch.gradient_y[r]), difference));
            mean = _mm256_add_ps(mean, difference);
            square = _mm256_add_ps(square, _mm256_mul_ps(difference, difference));
            above = below;
        }
        (differences[half], squares[half]) = (mean, square);
    }
    let first = halves(slope_x, slope_y, differences[0], differences[1]);
    let second = halves(squares[0], squares[1], squares[0], squares[1]);
    let (left, right) = (_mm256_castps256_ps128(first), _mm256_extractf128_ps::<1>(first));
    let slopes = _mm_add_ps(left, right);
    let differences = _mm_movehl_ps(right, left);
    let squares = _mm_movelh_ps(_mm256_castps256_ps128(second), _mm256_extractf128_ps::<1>(second));
    let mean = _mm_mul_ps(four(differences), _mm_set1_ps(1.0 / AREA));
    let twice = _mm_mul_ps(_mm_set1_ps(2.0), differences);
    let square = _mm_mul_ps(_mm_set1_ps(0.25 * AREA), mean);
    let squares = _mm_sub_ps(squares, _mm_mul_ps(mean, _mm_sub_ps(twice, square)));
    let squares = _mm_max_ps(squares, _mm_setzero_ps());
    let mut out = Sums { total: _mm_cvtss_f32(four(squares)), ..Sums::default() };
    // SAFETY: four samples are borrowed, exclusively.
    unsafe { _mm_storeu_ps(out.squares.as_mut_ptr(), squares) };
    out.slope = [_mm_cvtss_f32(slopes), _mm_cvtss_f32(_mm_shuffle_ps::<1>(slopes, slopes))];
    Some(out)
}

/// The sum of four samples, four times.
#[inline]
#[target_feature(enable = "avx2")]
fn four(samples: __m128) -> __m128 {
    let pairs = _mm_hadd_ps(samples, samples);
    _mm_hadd_ps(pairs, pairs)
}

#[target_feature(enable = "avx2")]
pub(super) fn whole_sums(values: &Block, samples: &[f32], stride: usize) -> Option<[f32; 2]> {
    let rows = Rows::new(samples, stride, SIDE, SIDE)?;
    let zero = _mm256_setzero_ps();
    let (mut sum, mut square) = (zero, zero);
    for (r, values) in values.iter().enumerate() {
        // SAFETY: rows 0 to 7, columns 0 to 7.
        let difference = _mm256_sub_ps(unsafe { rows.load(r, 0) }, row(values));
        sum = _mm256_add_ps(sum, difference);
        square = _mm256_add_ps(square, _mm256_mul_ps(difference, difference));
    }
    let [sum, square, ..] = totals(sum, square, zero, zero);
    Some([sum, square])
}
