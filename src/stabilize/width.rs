//! The width of the smoothing: as large as asked for where the window stays inside the picture, less where it would leave it.

use super::kernel::{Pose, smoothed};
use super::logarithm::Coordinates;

/// Widths that are tried, each less by √2 than the one before: down to 1/16.
const STEPS: i32 = 9;
/// Share of the margin that the smoothed path may use: the rest is for what its gradual changes leave.
const SHARE: f64 = 0.8;
/// Half the time over which the width is smoothed, in deviations.
pub const REACH: f64 = 1.0;
/// Exponent of the soft least.
const EXPONENT: f64 = 4.0;

/// A width in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Width(f64);

impl Width {
    /// The largest width up to `deviation` with which the edges stay within the margin; interpolated between those tried, so
    /// that it does not jump. The least one where none does.
    pub fn of(poses: &[Pose], deviation: f64, margin: f64, inside: impl Fn(&Coordinates) -> f64) -> Self {
        let most = SHARE * margin;
        let mut wider = None;
        let mut width = deviation;
        for _ in 0..STEPS {
            let excess = inside(&smoothed(poses, width)) - most;
            if excess <= 0.0 {
                return Self(match wider {
                    Some((wide, over)) => {
                        let share: f64 = over / (over - excess);
                        wide * (width / wide as f64).powf(if share.is_nan() { 1.0 } else { share })
                    }
                    None => width,
                });
            }
            wider = Some((width, excess));
            width *= std::f64::consts::FRAC_1_SQRT_2;
        }
        Self(width)
    }
}

/// The weighted mean of a power of the widths, close to the least of them.
#[derive(Clone, Copy, Debug, Default)]
pub struct SoftLeast {
    weights: f64,
    powers: f64,
}

impl SoftLeast {
    /// Adds a width at `place`, −1 to 1 over the time that counts.
    pub fn add(&mut self, Width(width): Width, place: f64) {
        let weight = if place.abs() < 1.0 { (1.0 - place * place).powi(2) } else { 0.0 };
        self.weights += weight;
        self.powers += weight * width.max(f64::MIN_POSITIVE).powf(-EXPONENT);
    }

    /// The width; 0 without any.
    pub fn width(&self) -> f64 {
        if self.weights > 0.0 { (self.powers / self.weights).powf(-1.0 / EXPONENT) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pan that begins at time 0, and a bound of 10 on the offset.
    fn found(at: i32, speed: f64) -> f64 {
        let path = |k: i32| speed * f64::from(k.max(0)) / 30.0;
        let pose =
            |k: i32| Pose { time: f64::from(k) / 30.0, path: Coordinates::repeat(path(at + k) - path(at)) };
        let poses: Vec<Pose> = (-60..=60).map(pose).collect();
        let Width(width) = Width::of(&poses, 0.5, 10.0 / SHARE, |offset| offset[0].abs());
        width
    }

    #[test]
    fn the_width_follows_the_corner_of_a_pan() {
        assert_eq!(found(-60, 200.0), 0.5, "far from the corner");
        assert_eq!(found(0, 10.0), 0.5, "slow");
        // The offset at the corner is 0.37 of speed times width for this kernel.
        let [fast, faster] = [100.0, 200.0].map(|speed| found(0, speed));
        assert!((fast - 10.0 / 37.0).abs() < 0.03 && (faster - 5.0 / 37.0).abs() < 0.02, "{fast} {faster}");
    }

    #[test]
    fn the_soft_least_is_near_the_least() {
        let mut least = SoftLeast::default();
        assert_eq!(least.width(), 0.0);
        (-9..=9).for_each(|k| least.add(Width(if k == 0 { 0.1 } else { 0.8 }), f64::from(k) / 10.0));
        assert!((0.1..0.25).contains(&least.width()), "{least:?}");
    }
}
