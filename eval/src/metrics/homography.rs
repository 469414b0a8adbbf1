// SPDX-License-Identifier: MIT OR Apache-2.0

//! The homography that most correspondences follow: the motion of a camera that turns, or sees a
//! plane, with a global shutter.

use baselines::methods::homography::linear_step;
use nalgebra::{Matrix3, Vector2};
use rand::SeedableRng;
use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;
use rsrectify::correspond::Correspondence;

/// Fewer correspondences determine no homography worth the name.
const FEWEST: usize = 16;
/// Maps through four correspondences that are tried: where a third do not belong, one sample in five
/// is free of them.
const SAMPLES: usize = 150;
/// Steps of Tukey's estimate, from the best of these.
const STEPS: usize = 12;
/// Distances are not told apart below this many pixels.
const LEAST_DISTANCE: f64 = 0.01;
/// Tukey's constant: 95 % efficient on Gaussian errors.
const TUKEY: f64 = 4.685;
/// The median length of a vector whose two coordinates have standard deviation 1: √(2 ln 2).
const RAYLEIGH_MEDIAN: f64 = 1.177_410_022_515_474_7;

/// A projective map of the plane, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homography(pub Matrix3<f64>);

impl Homography {
    /// The map that most of `pairs` follow: the least median of distances among maps through four of
    /// them (P. Rousseeuw, *Least median of squares regression*, 1984), refined by reweighted least
    /// squares of the transfer error. `None` where the pairs do not determine one.
    pub fn fit(pairs: &[Correspondence]) -> Option<Self> {
        if pairs.len() < FEWEST {
            return None;
        }
        let units = Units::of(pairs);
        let mut found = Self::of_majority(pairs, &units)?;
        for _ in 0..STEPS {
            found = found.refined(pairs, &tukey(&found.distances(pairs)), &units)?;
        }
        found.0.iter().all(|entry| entry.is_finite()).then_some(found)
    }

    /// The best map through four correspondences; the same ones every time.
    fn of_majority(pairs: &[Correspondence], units: &Units) -> Option<Self> {
        let mut random = ChaCha8Rng::seed_from_u64(0);
        let maps = (0..SAMPLES).filter_map(|_| {
            let four =
                sample(&mut random, pairs.len(), 4).iter().map(|index| pairs[index]).collect::<Vec<_>>();
            let map = Self(Matrix3::identity()).refined(&four, &[1.0; 4], units)?;
            let distance = median(&mut map.distances(pairs));
            distance.is_finite().then_some((map, distance))
        });
        maps.min_by(|(_, a), (_, b)| a.total_cmp(b)).map(|(map, _)| map)
    }

    fn distances(&self, pairs: &[Correspondence]) -> Vec<f64> {
        pairs.iter().map(|pair| self.residual(pair).norm()).collect()
    }

    /// Where a point goes.
    pub fn apply(&self, point: Vector2<f64>) -> Vector2<f64> {
        let mapped = self.0 * point.push(1.0);
        mapped.xy() / mapped.z
    }

    /// What the map leaves of a correspondence, in pixels of the second frame.
    pub fn residual(&self, pair: &Correspondence) -> Vector2<f64> {
        pair.to - self.apply(pair.from)
    }

    /// One linear step of weighted least squares, with the denominators of this map.
    fn refined(&self, pairs: &[Correspondence], weights: &[f64], units: &Units) -> Option<Self> {
        let before = units.normalised_map(self);
        let pairs = pairs.iter().map(|pair| [pair.from, pair.to].map(|place| units.normalised(place)));
        Some(units.to_pixels(&linear_step(&before, pairs.zip(weights.iter().copied()))?))
    }
}

/// Coordinates in which the points lie about the origin, at distances about 1.
struct Units {
    centre: Vector2<f64>,
    size: f64,
}

impl Units {
    fn of(pairs: &[Correspondence]) -> Self {
        let count = pairs.len() as f64;
        let centre = pairs.iter().map(|pair| pair.from).sum::<Vector2<f64>>() / count;
        let size = pairs.iter().map(|pair| (pair.from - centre).norm()).sum::<f64>() / count;
        Self { centre, size: size.max(f64::MIN_POSITIVE) }
    }

    fn normalised(&self, point: Vector2<f64>) -> Vector2<f64> {
        (point - self.centre) / self.size
    }

    /// From normalised coordinates to pixels.
    fn matrix(&self) -> Matrix3<f64> {
        let (c, s) = (self.centre, self.size);
        Matrix3::new(s, 0.0, c.x, 0.0, s, c.y, 0.0, 0.0, 1.0)
    }

    /// Its inverse.
    fn inverse(&self) -> Matrix3<f64> {
        let (c, s) = (self.centre / self.size, 1.0 / self.size);
        Matrix3::new(s, 0.0, -c.x, 0.0, s, -c.y, 0.0, 0.0, 1.0)
    }

    fn to_pixels(&self, map: &Matrix3<f64>) -> Homography {
        Homography(self.matrix() * map * self.inverse())
    }

    /// Scaled to a last entry of 1.
    fn normalised_map(&self, map: &Homography) -> Matrix3<f64> {
        let map = self.inverse() * map.0 * self.matrix();
        map / map[(2, 2)]
    }
}

/// Tukey's weights, at the scale that the median distance tells.
fn tukey(distances: &[f64]) -> Vec<f64> {
    let reach = TUKEY * (median(&mut distances.to_vec()) / RAYLEIGH_MEDIAN).max(LEAST_DISTANCE);
    let weight = |distance: &f64| (1.0 - (distance / reach).powi(2)).max(0.0).powi(2);
    distances.iter().map(weight).collect()
}

/// The median, the mean of the middle two where there are as many below as above.
pub fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    let odd = values.len() % 2 == 1;
    let (below, upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    let upper = *upper;
    if odd { upper } else { (below.iter().copied().fold(f64::NEG_INFINITY, f64::max) + upper) / 2.0 }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use nalgebra::Matrix2;

    /// A turned, scaled, shifted and tilted view.
    pub fn view() -> Homography {
        Homography(Matrix3::new(1.02, -0.03, 7.0, 0.025, 0.99, -4.0, 2e-5, -3e-5, 1.0))
    }

    /// Correspondences on a grid of 32 × 24 over 640 × 480, to where `seen` says.
    pub fn on_a_grid(seen: impl Fn(Vector2<f64>) -> Vector2<f64>) -> Vec<Correspondence> {
        let node =
            |index: usize| Vector2::new((index % 32) as f64 * 20.0 + 9.5, (index / 32) as f64 * 20.0 + 9.5);
        let pair = |from| Correspondence {
            from,
            to: seen(from),
            texture: 100.0,
            residual: 0.0,
            covariance: Matrix2::zeros(),
        };
        (0..32 * 24).map(node).map(pair).collect()
    }

    #[test]
    fn exact_points_give_the_map_back() {
        let found = Homography::fit(&on_a_grid(|x| view().apply(x))).unwrap();
        assert!((found.0 / found.0[(2, 2)] - view().0).amax() < 1e-9);
    }

    #[test]
    fn a_third_that_moves_on_its_own_has_no_say() {
        let own = |x: Vector2<f64>| x.x > 430.0;
        let moved = |x: Vector2<f64>| if own(x) { Vector2::new(25.0, 9.0) } else { Vector2::zeros() };
        let pairs = on_a_grid(|x| view().apply(x) + moved(x));
        let found = Homography::fit(&pairs).unwrap();
        for pair in pairs.iter().filter(|pair| !own(pair.from)) {
            assert!(found.residual(pair).norm() < 1e-6, "{}", found.residual(pair).norm());
        }
    }

    #[test]
    fn too_few_or_collinear_points_give_none() {
        assert_eq!(Homography::fit(&on_a_grid(|x| x)[..15]), None);
        let line: Vec<_> = on_a_grid(|x| x).into_iter().take(32).collect();
        assert_eq!(Homography::fit(&line), None);
    }

    #[test]
    fn the_median_of_even_counts_is_between() {
        assert_eq!(median(&mut [4.0, 1.0, 3.0]), 3.0);
        assert_eq!(median(&mut [4.0, 1.0, 3.0, 2.0]), 2.5);
    }
}
