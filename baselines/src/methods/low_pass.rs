// SPDX-License-Identifier: MIT OR Apache-2.0

//! Low-pass filter over frames: a Gaussian, corrected at the ends of what it filters.
//!
//! At each frame a line is fitted to the samples around, weighted by a Gaussian of the distance in frames, and evaluated there
//! (W. S. Cleveland, *Robust locally weighted regression and smoothing scatterplots*, JASA 74, 1979, at degree 1). Away
//! from the ends that is the Gaussian filter; at the ends, where a Gaussian alone would lag behind a steady motion, it still
//! passes straight lines unchanged.

/// The weights of the samples, of which they add up to the filtered value at sample `at`: of `count` samples one a frame, with a
/// standard deviation of `deviation` frames.
pub fn weights(count: usize, at: usize, deviation: f64) -> Vec<f64> {
    let offset = |sample: usize| sample as f64 - at as f64;
    let gauss: Vec<f64> =
        (0..count).map(|sample| (-0.5 * (offset(sample) / deviation).powi(2)).exp()).collect();
    let moment = |power: i32| -> f64 {
        gauss.iter().enumerate().map(|(sample, weight)| weight * offset(sample).powi(power)).sum()
    };
    let [zeroth, first, second] = [0, 1, 2].map(moment);
    let determinant = zeroth * second - first * first;
    if determinant <= 1e-9 * zeroth * zeroth {
        // One sample, or so small a deviation that only one counts.
        return (0..count).map(|sample| f64::from(u8::from(sample == at))).collect();
    }
    let share = |sample: usize| gauss[sample] * (second - first * offset(sample)) / determinant;
    (0..count).map(share).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filtered(samples: &[f64], at: usize, deviation: f64) -> f64 {
        weights(samples.len(), at, deviation)
            .iter()
            .zip(samples)
            .map(|(weight, sample)| weight * sample)
            .sum()
    }

    #[test]
    fn a_line_passes_up_to_its_ends() {
        let line: Vec<f64> = (0..40).map(|k| 3.0 - 0.7 * f64::from(k)).collect();
        for at in 0..40 {
            assert!((filtered(&line, at, 6.0) - line[at]).abs() < 1e-9, "{at}");
        }
    }

    #[test]
    fn an_oscillation_is_damped_as_by_a_gaussian() {
        // Of frequency ω, exp(−ω²σ²/2) passes.
        let (omega, deviation) = (0.3f64, 5.0);
        let wave: Vec<f64> = (0..101).map(|k| (omega * f64::from(k - 50)).cos()).collect();
        let passed = (-0.5 * (omega * deviation).powi(2)).exp();
        assert!((filtered(&wave, 50, deviation) - passed).abs() < 1e-6);
    }

    #[test]
    fn one_sample_is_its_own_mean() {
        assert_eq!(weights(1, 0, 5.0), [1.0]);
        assert_eq!(weights(3, 1, 1e-3), [0.0, 1.0, 0.0]);
    }
}
