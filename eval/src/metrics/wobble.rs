// SPDX-License-Identifier: MIT OR Apache-2.0

//! Row-wise wobble: what a rolling shutter leaves between successive frames, measured without truth.
//!
//! Two frames of a global shutter are related by a homography where the camera turns or sees a
//! plane; parallax and objects add to it, but seldom alike all along a row. A rolling shutter
//! displaces each row by what the camera did at the row's own time, so that between two frames
//! something is left which depends on the row and on nothing else. What of it a homography can
//! follow, a uniform lean or stretch, is not seen.
//!
//! Depth that is the same all along a row, such as a dashboard below a street, shows as wobble too, and
//! no rectification takes it away: compare before and after, and of one clip only.

use super::homography::{Homography, median};
use nalgebra::Vector2;
use rsrectify::correspond::Correspondence;
use rsrectify::readout::Readout;

/// Bands of rows (of columns where read sideways) that are told apart.
const BANDS: usize = 24;

/// The wobble between two successive frames in pixels: the residuals of their homography, in each
/// of 24 bands along the readout the median vector, and the root mean square of these, each weighted
/// by its count. Only the axis of `readout` matters.
///
/// Errors of σ pixels in each coordinate show as some 1.8 σ/√n with n correspondences in a band.
/// `None` where the correspondences do not determine a homography.
pub fn between(pairs: &[Correspondence], readout: &Readout) -> Option<f64> {
    let homography = Homography::fit(pairs)?;
    let mut bands = vec![Vec::new(); BANDS];
    for pair in pairs {
        let share = readout.share(pair.from.x, pair.from.y);
        let band = (share * BANDS as f64).clamp(0.0, BANDS as f64 - 1.0) as usize;
        bands[band].push(homography.residual(pair));
    }
    let squares = bands.iter().map(|band| band.len() as f64 * middle(band).norm_squared());
    Some((squares.sum::<f64>() / pairs.len() as f64).sqrt())
}

/// The median of each coordinate; zero for none.
fn middle(residuals: &[Vector2<f64>]) -> Vector2<f64> {
    if residuals.is_empty() {
        return Vector2::zeros();
    }
    let along =
        |axis: usize| median(&mut residuals.iter().map(|residual| residual[axis]).collect::<Vec<_>>());
    Vector2::new(along(0), along(1))
}

#[cfg(test)]
mod tests {
    use super::super::homography::tests::{on_a_grid, view};
    use super::*;
    use rsrectify::readout::{ReadoutDirection, ReadoutTime};
    use std::f64::consts::TAU;

    fn readout(direction: ReadoutDirection) -> Readout {
        Readout::new(640, 480, direction, ReadoutTime::WholePeriod, 0.04).unwrap()
    }

    /// A cosine of three whole periods from the first edge to the last. A homography follows next
    /// to nothing of it: 0.6 % of its amplitude.
    fn wave(share: f64) -> Vector2<f64> {
        Vector2::new(1.2, -0.5) * (3.0 * TAU * share).cos()
    }

    /// Its root mean square: amplitude / √2.
    const WAVE: f64 = 1.3 * std::f64::consts::FRAC_1_SQRT_2;

    #[test]
    fn a_wave_over_the_rows_is_measured_on_top_of_a_homography() {
        for direction in [ReadoutDirection::TopToBottom, ReadoutDirection::BottomToTop] {
            let readout = readout(direction);
            let pairs = on_a_grid(|x| view().apply(x) + wave(readout.share(x.x, x.y)));
            let found = between(&pairs, &readout).unwrap();
            assert!((found / WAVE - 1.0).abs() < 0.02, "{found} px for {WAVE} px");
        }
    }

    #[test]
    fn a_wave_over_the_columns_is_no_wobble_of_rows() {
        let sideways = readout(ReadoutDirection::LeftToRight);
        // 32 columns of points on 24 bands: the even columns only, so that each band has one place.
        let pairs = on_a_grid(|x| view().apply(x) + wave(sideways.share(x.x, x.y)));
        let found = between(&pairs, &sideways).unwrap();
        assert!((found / WAVE - 1.0).abs() < 0.05, "{found} px for {WAVE} px");
        let by_rows = between(&pairs, &readout(ReadoutDirection::TopToBottom)).unwrap();
        assert!(by_rows < 0.3, "{by_rows} px");
    }

    #[test]
    fn a_homography_alone_has_none_and_strays_add_none() {
        let strays = |x: Vector2<f64>| {
            let stray = ((x.x * 7.0 + x.y * 13.0) as usize).is_multiple_of(5);
            if stray { Vector2::new(31.0, -17.0) } else { Vector2::zeros() }
        };
        let readout = readout(ReadoutDirection::TopToBottom);
        let pairs = on_a_grid(|x| view().apply(x) + strays(x));
        assert!(between(&pairs, &readout).unwrap() < 1e-6);
        assert_eq!(between(&pairs[..8], &readout), None);
    }
}
