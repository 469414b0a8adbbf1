// SPDX-License-Identifier: MIT OR Apache-2.0

//! The least that a motion model can leave: what of the displacement is the model's, whoever solves it.

use nalgebra::{Matrix3, Vector2, Vector3};
use render::footage::Footage;
use render::stats::Stats;
use render::truth::Sample;
use rsrectify::motion::{MotionPath, Twist, image_centre};
use rsrectify::readout::Readout;

/// Gauss–Newton steps: the problem is nearly linear.
const ROUNDS: usize = 4;

/// The displacement left if every frame turned by the uniform 2D rotation (25.11) that is best for it in the
/// least-squares sense, found from the truth.
pub fn of_rotation(footage: &Footage) -> Stats {
    let readout = footage.readout();
    let left = footage.truth.iter().flat_map(|truth| {
        let twist = best_twist(&truth.samples, &readout);
        truth.samples.iter().map(move |sample| missing(sample, &readout, twist).norm())
    });
    Stats::of(left.collect())
}

/// The twist of least Σ|x_true − x_cor|²; none where the samples do not determine it.
fn best_twist(samples: &[Sample], readout: &Readout) -> Twist {
    let mut twist = Twist::ZERO;
    for _ in 0..ROUNDS {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for sample in samples {
            let slopes = twist.jacobian(centred(sample.seen, readout), until_middle(sample.seen, readout));
            normal += slopes.transpose() * slopes;
            right += slopes.transpose() * missing(sample, readout, twist);
        }
        let Some(cholesky) = normal.cholesky() else { return Twist::ZERO };
        twist = Twist::from_vector(twist.to_vector() + cholesky.solve(&right));
    }
    twist
}

/// From where a twist takes a sample to where it belongs, in pixels.
fn missing(sample: &Sample, readout: &Readout, twist: Twist) -> Vector2<f64> {
    let path = MotionPath::uniform(twist, readout.time());
    let share = readout.share(sample.seen.x, sample.seen.y);
    centred(sample.truth, readout) - path.carry(centred(sample.seen, readout), share, 0.5)
}

fn centred(pixel: Vector2<f64>, readout: &Readout) -> Vector2<f64> {
    pixel - image_centre(readout.width(), readout.height())
}

/// Seconds from the exposure of a pixel to the middle of the readout.
fn until_middle(pixel: Vector2<f64>, readout: &Readout) -> f64 {
    (0.5 - readout.share(pixel.x, pixel.y)) * readout.time()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rsrectify::readout::{ReadoutDirection, ReadoutTime};

    /// The samples of a frame that turns by 0.3 rad during its readout, each off by `error(index)`.
    fn samples(readout: &Readout, truth: Twist, error: impl Fn(usize) -> Vector2<f64>) -> Vec<Sample> {
        let places = (0..48).map(|i| Vector2::new((i % 8 * 8) as f64, (i / 8 * 8) as f64));
        let sample = |(index, seen): (usize, Vector2<f64>)| {
            let here = Sample { seen, truth: seen };
            Sample { seen, truth: seen - missing(&here, readout, truth) + error(index) }
        };
        places.enumerate().map(sample).collect()
    }

    #[test]
    fn a_rotation_is_found_and_nothing_is_better_than_the_best() {
        let time = ReadoutTime::Seconds(0.02);
        let readout = Readout::new(64, 48, ReadoutDirection::BottomToTop, time, 0.04).unwrap();
        let truth = Twist::new(15.0, 300.0, -200.0);
        let exact = best_twist(&samples(&readout, truth, |_| Vector2::zeros()), &readout);
        assert!((exact.to_vector() - truth.to_vector()).norm() < 1e-6, "{exact:?}");

        let odd = |index: usize| Vector2::new(0.7, -0.4) * if index.is_multiple_of(3) { 1.0 } else { -0.5 };
        let samples = samples(&readout, truth, odd);
        let best = best_twist(&samples, &readout);
        let squares =
            |twist| samples.iter().map(|sample| missing(sample, &readout, twist).norm_squared()).sum::<f64>();
        for axis in 0..3 {
            for step in [-1e-2, 1e-2] {
                let mut other = best.to_vector();
                other[axis] += step;
                assert!(squares(Twist::from_vector(other)) > squares(best));
            }
        }
    }

    #[test]
    fn without_samples_nothing_turns() {
        let readout =
            Readout::new(64, 48, ReadoutDirection::TopToBottom, ReadoutTime::WholePeriod, 0.04).unwrap();
        assert_eq!(best_twist(&[], &readout), Twist::ZERO);
    }
}
