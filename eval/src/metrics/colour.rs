// SPDX-License-Identifier: MIT OR Apache-2.0

//! How much a picture looks like the true one: colour distance, PSNR and SSIM inside a mask.
//!
//! Both pictures are of one size, and the mask has one entry a pixel, row by row: whether the pixel
//! counts. Each measure is `None` where none does.

use rayon::prelude::*;
use render::scene::Frame;

/// The Euclidean distance of two colours (each channel 0 to 1) under which they count as the same.
const SAME_COLOUR: f64 = 0.3;

/// The share of pixels whose colour is within 0.3 of the true one: the thresholded Euclidean colour
/// distance of P.-E. Forssén and E. Ringaby, *Rectifying rolling shutter video from hand-held
/// devices*, CVPR 2010.
pub fn accuracy(picture: &Frame, truth: &Frame, mask: &[bool]) -> Option<f64> {
    let same = |(a, b): (&[u8], &[u8])| squared_distance(a, b).sqrt() < SAME_COLOUR * 255.0;
    mean(pixels(picture, truth, mask).map(|pair| f64::from(u8::from(same(pair)))))
}

/// The peak signal-to-noise ratio in dB over all three channels, with a peak of 255; infinite where
/// the pictures are the same.
pub fn psnr(picture: &Frame, truth: &Frame, mask: &[bool]) -> Option<f64> {
    let error = mean(pixels(picture, truth, mask).map(|(a, b)| squared_distance(a, b) / 3.0))?;
    Some(10.0 * (255.0 * 255.0 / error).log10())
}

/// The pixels that count, of both pictures.
fn pixels<'a>(
    picture: &'a Frame,
    truth: &'a Frame,
    mask: &'a [bool],
) -> impl Iterator<Item = (&'a [u8], &'a [u8])> {
    assert_eq!([picture.width, picture.height], [truth.width, truth.height], "pictures of one size");
    assert_eq!(mask.len(), truth.width * truth.height, "a mask of the pictures' size");
    let pairs = picture.rgb.chunks_exact(3).zip(truth.rgb.chunks_exact(3));
    pairs.zip(mask).filter(|(_, counts)| **counts).map(|(pair, _)| pair)
}

fn squared_distance(a: &[u8], b: &[u8]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum()
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}

/// Pixels from the middle of the SSIM window to its edge: 11 × 11 in all.
const REACH: usize = 5;
/// Standard deviation of its Gaussian in pixels.
const SIGMA: f64 = 1.5;
/// (0.01 · 255)² and (0.03 · 255)², which keep the quotients of dark and of flat windows stable.
const STABLE_MEAN: f64 = 2.55 * 2.55;
const STABLE_VARIANCE: f64 = 7.65 * 7.65;

/// The mean structural similarity of the luma (BT.709, 0 to 255) of Z. Wang et al., *Image quality
/// assessment: from error visibility to structural similarity*, IEEE TIP 2004: 11 × 11 Gaussian
/// windows with σ = 1.5.
///
/// A window takes in only pixels that count, its weights scaled to sum to 1, so that what lies
/// outside the mask or the frame has no say.
pub fn ssim(picture: &Frame, truth: &Frame, mask: &[bool]) -> Option<f64> {
    assert_eq!([picture.width, picture.height], [truth.width, truth.height], "pictures of one size");
    assert_eq!(mask.len(), truth.width * truth.height, "a mask of the pictures' size");
    let moments = moments(picture, truth, mask);
    let blurred = blurred(moments, truth.width);
    let similar = blurred.iter().zip(mask).filter(|(_, counts)| **counts);
    mean(similar.map(|(moments, _)| similarity(moments)))
}

/// Of one pixel or window: weight, the means a and b of both pictures, and the means of a², b², ab.
type Moments = [f64; 6];

fn moments(picture: &Frame, truth: &Frame, mask: &[bool]) -> Vec<Moments> {
    let pairs = picture.rgb.par_chunks_exact(3).zip(truth.rgb.par_chunks_exact(3));
    let moments = pairs.zip(mask).map(|((a, b), counts)| {
        let (a, b) = (luma(a), luma(b));
        if *counts { [1.0, a, b, a * a, b * b, a * b] } else { [0.0; 6] }
    });
    moments.collect()
}

fn luma(rgb: &[u8]) -> f64 {
    0.2126 * f64::from(rgb[0]) + 0.7152 * f64::from(rgb[1]) + 0.0722 * f64::from(rgb[2])
}

/// Sums over the window around each pixel, first along the rows, then along the columns.
fn blurred(moments: Vec<Moments>, width: usize) -> Vec<Moments> {
    let weights: [f64; 2 * REACH + 1] =
        std::array::from_fn(|i| (-(i as f64 - REACH as f64).powi(2) / (2.0 * SIGMA * SIGMA)).exp());
    let sum = |from: &[Moments], at: usize, step: usize, place: usize, length: usize| {
        let mut sum = [0.0; 6];
        for other in place.saturating_sub(REACH)..(place + REACH + 1).min(length) {
            let from = &from[at + other * step - place * step];
            let weight = weights[other + REACH - place];
            sum.iter_mut().zip(from).for_each(|(sum, value)| *sum += weight * value);
        }
        sum
    };
    let height = moments.len() / width.max(1);
    let pixels = 0..moments.len();
    let rows: Vec<Moments> =
        pixels.clone().into_par_iter().map(|at| sum(&moments, at, 1, at % width, width)).collect();
    pixels.into_par_iter().map(|at| sum(&rows, at, width, at / width, height)).collect()
}

fn similarity([weight, sums @ ..]: &Moments) -> f64 {
    let [a, b, aa, bb, ab] = sums.map(|sum| sum / weight);
    let (variance_a, variance_b, covariance) = (aa - a * a, bb - b * b, ab - a * b);
    let means = (2.0 * a * b + STABLE_MEAN) / (a * a + b * b + STABLE_MEAN);
    means * (2.0 * covariance + STABLE_VARIANCE) / (variance_a + variance_b + STABLE_VARIANCE)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [32, 24];

    fn picture(colour: impl Fn(usize, usize) -> [u8; 3]) -> Frame {
        let [width, height] = SIZE;
        let rgb = (0..width * height).flat_map(|index| colour(index % width, index / width));
        Frame { width, height, rgb: rgb.collect() }
    }

    fn everywhere() -> Vec<bool> {
        vec![true; SIZE[0] * SIZE[1]]
    }

    /// The left quarter.
    fn left() -> Vec<bool> {
        (0..SIZE[0] * SIZE[1]).map(|index| index % SIZE[0] < SIZE[0] / 4).collect()
    }

    #[test]
    fn colours_within_the_threshold_count_as_the_same() {
        let truth = picture(|_, _| [100; 3]);
        // 0.3 · 255 = 76.5 grey levels; √3 · 44 = 76.2 and √3 · 45 = 77.9.
        let shifted = picture(|x, _| [[176, 100, 100], [177, 100, 100], [144; 3], [145; 3]][x % 4]);
        assert_eq!(accuracy(&shifted, &truth, &everywhere()), Some(0.5));
    }

    #[test]
    fn psnr_of_known_offsets() {
        let truth = picture(|x, y| [x as u8, y as u8, 50]);
        let offset = |by: [u8; 3]| picture(|x, y| [x as u8 + by[0], y as u8 + by[1], 50 + by[2]]);
        let of = |by| psnr(&offset(by), &truth, &everywhere()).unwrap();
        assert!((of([1, 1, 1]) - 48.130_803_608_679_1).abs() < 1e-9);
        // A mean square of (9 + 0 + 0)/3 = 3.
        assert!((of([3, 0, 0]) - (48.130_803_608_679_1 - 10.0 * 3f64.log10())).abs() < 1e-9);
        assert_eq!(of([0, 0, 0]), f64::INFINITY);
    }

    #[test]
    fn only_the_mask_is_looked_at() {
        let truth = picture(|_, _| [90; 3]);
        let half = picture(|x, _| if x < 8 { [90; 3] } else { [255; 3] });
        assert_eq!(accuracy(&half, &truth, &left()), Some(1.0));
        assert_eq!(accuracy(&half, &truth, &everywhere()), Some(0.25));
        assert_eq!(psnr(&half, &truth, &left()), Some(f64::INFINITY));
        assert!((ssim(&half, &truth, &left()).unwrap() - 1.0).abs() < 1e-12);
        assert!(ssim(&half, &truth, &everywhere()).unwrap() < 0.9);
    }

    #[test]
    fn nothing_visible_has_no_measure() {
        let (truth, none) = (picture(|_, _| [9; 3]), vec![false; SIZE[0] * SIZE[1]]);
        for measure in [accuracy, psnr, ssim] {
            assert_eq!(measure(&truth, &truth, &none), None);
        }
    }

    #[test]
    fn ssim_of_flat_pictures_is_that_of_their_means() {
        let (a, b) = (100.0, 160.0);
        let found = ssim(&picture(|_, _| [100; 3]), &picture(|_, _| [160; 3]), &everywhere()).unwrap();
        let expected = (2.0 * a * b + 6.5025) / (a * a + b * b + 6.5025);
        assert!((found - expected).abs() < 1e-9, "{found} for {expected}");
    }

    #[test]
    fn ssim_of_a_stretched_contrast_is_that_of_its_variances() {
        // Columns of 128 ± 20 against 128 ± 40. A window's mean is 128 ± c e and its variance
        // c² (1 − e²), with e the sum of the Gaussian's weights with alternating signs.
        let columns = |c: i16| picture(move |x, _| [(128 + if x % 2 == 0 { c } else { -c }) as u8; 3]);
        let gauss = |i: i32| (-f64::from(i * i) / 4.5).exp();
        let total: f64 = (-5..=5).map(gauss).sum();
        let e = (-5..=5).map(|i: i32| if i % 2 == 0 { gauss(i) } else { -gauss(i) }).sum::<f64>() / total;
        let term = |sign: f64| {
            let (a, b) = (128.0 + sign * 20.0 * e, 128.0 + sign * 40.0 * e);
            let v = 1.0 - e * e;
            let structure = (2.0 * 800.0 * v + 58.5225) / ((400.0 + 1600.0) * v + 58.5225);
            structure * (2.0 * a * b + 6.5025) / (a * a + b * b + 6.5025)
        };
        // Away from the sides, where windows are whole; as many even columns as odd ones.
        let middle: Vec<bool> = (0..SIZE[0] * SIZE[1]).map(|i| (8..24).contains(&(i % SIZE[0]))).collect();
        let whole = |mask: &[bool]| {
            // The mask bounds the windows too: count all pixels and compare the middle by hand.
            let moments = blurred(moments(&columns(20), &columns(40), &everywhere()), SIZE[0]);
            let similar = moments.iter().zip(mask).filter(|(_, counts)| **counts);
            mean(similar.map(|(moments, _)| similarity(moments))).unwrap()
        };
        let expected = (term(1.0) + term(-1.0)) / 2.0;
        assert!((whole(&middle) - expected).abs() < 1e-9, "{} for {expected}", whole(&middle));
    }
}
