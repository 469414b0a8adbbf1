// SPDX-License-Identifier: MIT OR Apache-2.0

//! Distortion left by a system that may also move the whole frame.
//!
//! A stabiliser shows each frame as seen in another direction, which is no distortion. For each frame the rotation and the zoom of
//! the true lens are found that bring the shown places of far points nearest to the true ones (four parameters, least squares).
//! The distortion is the RMS of the residuals in pixels of the true frame. A camera with a global shutter at the same place has
//! none, whatever its direction and zoom. A lean of the picture is a distortion, though a roll fits part of it; the input is
//! judged in the same way, so that shares of it compare.

use super::tracks::{LEAST_POINTS, STEP, far};
use baselines::methods::Correction;
use nalgebra::{Rotation3, SMatrix, SVector, Vector2, Vector3};
use render::scene::Lens;
use render::truth::{Capture, Sample};

/// Largest distance of the camera from its mean place, as a share of the distance of the nearest far point. A hand sways by less; the
/// parallax between its path and a smoothed one counts as distortion, but is small beside that of the shutter.
const TRAVEL: f64 = 0.1;
/// Gauss–Newton steps.
const STEPS: usize = 8;
/// Step of the numerical derivatives, in radians and as a share of the zoom.
const SLIGHT: f64 = 1e-6;

/// A rotation vector in radians, and the logarithm of a zoom.
type Placement = SVector<f64, 4>;

/// Far points in each frame, as seen and as they are at the reference instant.
#[derive(Debug, Default)]
pub struct Views {
    frames: Vec<View>,
}

#[derive(Debug)]
struct View {
    /// Number of the frame.
    index: usize,
    lens: Lens,
    /// Of the nearest point, in metres.
    distance: f64,
    samples: Vec<Sample>,
}

impl Views {
    /// Adds the points of successive frames, given with their indices, that lie at least as far away as the median one of their
    /// frame. A run in which the camera moves far is left out: parallax between its path and a smoothed one is no distortion.
    pub fn add(&mut self, run: &[(usize, Capture<'_>)]) {
        let places =
            run.iter().map(|(_, capture)| capture.take.camera.path.pose(capture.reference()).position);
        let mean = places.clone().sum::<Vector3<f64>>() / run.len().max(1) as f64;
        let travel = places.map(|place| (place - mean).norm()).fold(0.0, f64::max);
        let views: Vec<_> = run.iter().filter_map(|(index, capture)| View::of(*index, capture)).collect();
        let nearest = views.iter().map(|view| view.distance).fold(f64::INFINITY, f64::min);
        if travel <= TRAVEL * nearest {
            self.frames.extend(views);
        }
    }

    /// The distortion in pixels of the true frames, RMS over all of their points, given where the pixels of each frame are
    /// shown; `None` without points.
    pub fn distortion(&self, shown: &[Box<dyn Correction>]) -> Option<f64> {
        let count: usize = self.frames.iter().map(|view| view.samples.len()).sum();
        let squares: f64 = self.frames.iter().map(|view| view.distortion(&*shown[view.index])).sum();
        (count > 0).then(|| (squares / count as f64).sqrt())
    }
}

impl View {
    /// `None` for fewer than 40 points.
    fn of(index: usize, capture: &Capture<'_>) -> Option<Self> {
        let seen = capture.samples(STEP).into_iter();
        let samples = seen.filter_map(|sample| Some((capture.distance(sample.seen)?, sample)));
        let (distance, far) = far(samples.collect());
        let samples: Vec<_> = far.collect();
        let lens = capture.take.camera.lens_at(capture.reference());
        let lens = Lens { focal: lens.focal * capture.warp.zoom, ..lens };
        (samples.len() >= LEAST_POINTS).then_some(Self { index, lens, distance, samples })
    }

    /// The sum of squares left by the placement for which it is least.
    fn distortion(&self, shown: &dyn Correction) -> f64 {
        let shown: Vec<_> = self.samples.iter().map(|sample| shown.correct(sample.seen)).collect();
        let off = |placement: &Placement, index: usize| {
            placed(&self.lens, placement, shown[index]).map(|place| place - self.samples[index].truth)
        };
        let mut placement = Placement::zeros();
        for _ in 0..STEPS {
            let mut normal = SMatrix::<f64, 4, 4>::zeros();
            let mut right = Placement::zeros();
            for index in 0..shown.len() {
                let Some(here) = off(&placement, index) else { continue };
                let slope = |axis: usize| {
                    let mut beside = placement;
                    beside[axis] += SLIGHT;
                    off(&beside, index).map_or(Vector2::zeros(), |there| (there - here) / SLIGHT)
                };
                let slopes = SMatrix::<f64, 2, 4>::from_columns(&[0, 1, 2, 3].map(slope));
                normal += slopes.transpose() * slopes;
                right -= slopes.transpose() * here;
            }
            let Some(cholesky) = normal.cholesky() else { break };
            placement += cholesky.solve(&right);
        }
        // What is behind the camera is as far off as it is shown.
        let left = |index: usize| {
            off(&placement, index).unwrap_or_else(|| shown[index] - self.samples[index].truth).norm_squared()
        };
        (0..shown.len()).map(left).sum()
    }
}

/// Where a shown place is after a zoom and a rotation of the lens.
fn placed(lens: &Lens, placement: &Placement, place: Vector2<f64>) -> Option<Vector2<f64>> {
    let [x, y, z, zoom] = (*placement).into();
    let ray = lens.ray((place - lens.centre()) * zoom.exp() + lens.centre());
    lens.project(Rotation3::new(Vector3::new(x, y, z)) * ray)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The view of a frame whose rows lean by a share.
    fn view(lens: Lens, lean: f64) -> Views {
        let place = |index: usize| Vector2::new((index % 20 * 16) as f64, (index / 20 * 16) as f64);
        let sample = |truth: Vector2<f64>| Sample {
            seen: truth + Vector2::new(lean * (truth.y - lens.centre().y), 0.0),
            truth,
        };
        Views {
            frames: vec![View {
                index: 0,
                lens,
                distance: 1.0,
                samples: (0..300).map(place).map(sample).collect(),
            }],
        }
    }

    fn lenses() -> [Lens; 2] {
        let pinhole = Lens::pinhole(320, 240, 300.0);
        [pinhole, Lens { distortion: [-0.15, 0.02], ..pinhole }]
    }

    fn distortion(views: &Views, shown: impl Correction + 'static) -> f64 {
        views.distortion(&[Box::new(shown)]).unwrap()
    }

    #[test]
    fn a_camera_that_turns_and_zooms_distorts_nothing() {
        for lens in lenses() {
            let turn = Rotation3::new(Vector3::new(0.05, -0.08, 0.03));
            let shown = move |pixel: Vector2<f64>| {
                (lens.project(turn * lens.ray(pixel)).unwrap() - lens.centre()) * 1.3 + lens.centre()
            };
            let left = distortion(&view(lens, 0.0), shown);
            assert!(left < 1e-6, "{left} px");
        }
    }

    #[test]
    fn a_lean_is_a_distortion_from_any_direction_and_at_any_zoom() {
        let lens = lenses()[0];
        let views = view(lens, 0.05);
        let input = distortion(&views, |pixel| pixel);
        // RMS of the rows' distances from the middle times the lean, of which a roll takes up some.
        assert!(input > 0.4 * 0.05 * 69.0 && input < 0.05 * 70.0, "{input} px");
        let turn = Rotation3::new(Vector3::new(0.03, -0.04, 0.02));
        let shown = move |pixel: Vector2<f64>| {
            (lens.project(turn * lens.ray(pixel)).unwrap() - lens.centre()) * 1.4 + lens.centre()
        };
        let left = distortion(&views, shown);
        assert!((left / input - 1.0).abs() < 0.05, "{left} of {input} px");
        let upright = move |pixel: Vector2<f64>| {
            let centred = pixel.y - lens.centre().y;
            shown(pixel - Vector2::new(0.05 * centred, 0.0))
        };
        assert!(distortion(&views, upright) < 1e-6);
    }
}
