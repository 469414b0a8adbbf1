// SPDX-License-Identifier: MIT OR Apache-2.0

//! A smooth curve of translation through the global motions.
//!
//! Source: C.-K. Liang, L.-W. Chang and H. H. Chen, *Analysis and compensation of rolling shutter
//! effect*, IEEE Trans. Image Processing 17 (2008): the global motions between frames are joined by
//! cubic Bézier segments, and the velocity of each row is read off the curve.

use super::timed::{timed, until_reference};
use super::translation::velocity;
use super::{Corrections, Input, Method};
use anyhow::Result;
use nalgebra::Vector2;

/// A smooth curve of translation.
pub struct Curve;

impl Method for Curve {
    fn name(&self) -> String {
        "translation-curve".into()
    }

    fn solve(&self, input: &Input) -> Result<Corrections> {
        let readout = input.readout;
        let path = std::sync::Arc::new(Path::through_global_motions(input));
        let correction = |stamp: &f64| {
            let (path, reference) = (path.clone(), stamp + 0.5 * readout.time());
            Box::new(move |pixel: Vector2<f64>| {
                let seen = reference - until_reference(&readout, pixel);
                pixel + path.at(reference) - path.at(seen)
            }) as Box<dyn super::Correction>
        };
        Ok(input.stamps.iter().map(correction).collect())
    }
}

/// Piecewise cubic: where the picture is shifted to, in pixels, at any time.
#[derive(Debug)]
struct Path {
    /// The middle of each frame's readout, in seconds.
    times: Vec<f64>,
    /// Where the picture then is.
    places: Vec<Vector2<f64>>,
    /// How fast it then moves, in px/s.
    velocities: Vec<Vector2<f64>>,
}

impl Path {
    /// The path that moves by the global motion from one frame's middle to the next one's. A global
    /// motion that cannot be measured counts as none.
    fn through_global_motions(input: &Input) -> Self {
        let times: Vec<f64> = input.stamps.iter().map(|stamp| stamp + 0.5 * input.readout.time()).collect();
        let slopes: Vec<_> =
            (0..input.pairs.len()).map(|k| velocity(&timed(input, k)).unwrap_or_default()).collect();
        let mut places = vec![Vector2::zeros()];
        for (k, slope) in slopes.iter().enumerate() {
            places.push(places[k] + slope * (times[k + 1] - times[k]));
        }
        let velocities = tangents(&times, &slopes);
        Self { times, places, velocities }
    }

    /// Straight on before the first frame's middle and after the last one's.
    fn at(&self, time: f64) -> Vector2<f64> {
        let next = self.times.partition_point(|knot| *knot <= time);
        let k = next.saturating_sub(1);
        let since = time - self.times[k];
        if next == 0 || next == self.times.len() {
            return self.places[k] + self.velocities[k] * since;
        }
        let span = self.times[next] - self.times[k];
        // The Bézier polygon that has the velocities as its first and last edge.
        let polygon = [
            self.places[k],
            self.places[k] + self.velocities[k] * (span / 3.0),
            self.places[next] - self.velocities[next] * (span / 3.0),
            self.places[next],
        ];
        bezier(polygon, since / span)
    }
}

/// The velocity at each knot of the parabola through it and its neighbours; at the ends of the run that
/// of the parabola through the last three.
fn tangents(times: &[f64], slopes: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let middle = |k: usize| {
        let (before, after) = (times[k] - times[k - 1], times[k + 1] - times[k]);
        (slopes[k - 1] * after + slopes[k] * before) / (before + after)
    };
    let last = slopes.len();
    let tangent = |k: usize| match k {
        _ if slopes.is_empty() => Vector2::zeros(),
        _ if last == 1 => slopes[0],
        0 => slopes[0] * 2.0 - middle(1),
        k if k == last => slopes[last - 1] * 2.0 - middle(last - 1),
        k => middle(k),
    };
    (0..times.len()).map(tangent).collect()
}

/// De Casteljau: the point of a Bézier curve at `share` of the way.
fn bezier(polygon: [Vector2<f64>; 4], share: f64) -> Vector2<f64> {
    let between = |a: Vector2<f64>, b: Vector2<f64>| a.lerp(&b, share);
    let [a, b, c, d] = polygon;
    let (ab, bc, cd) = (between(a, b), between(b, c), between(c, d));
    between(between(ab, bc), between(bc, cd))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::timed::closed_form::*;
    use crate::methods::translation::Translation;

    #[test]
    fn a_constant_translation_is_undone() {
        assert_undoes_a_constant_translation(&Curve);
    }

    #[test]
    fn without_correspondences_frames_stay() {
        assert_survives_ignorance(&Curve);
    }

    #[test]
    fn a_parabola_is_reproduced() {
        let times = [0.0, 0.04, 0.1, 0.12];
        let place = |t: f64| Vector2::new(3.0 + 40.0 * t - 900.0 * t * t, 500.0 * t * t);
        let places = times.map(place).to_vec();
        let slopes: Vec<_> =
            (0..3).map(|k| (places[k + 1] - places[k]) / (times[k + 1] - times[k])).collect();
        let path = Path { times: times.to_vec(), places, velocities: tangents(&times, &slopes) };
        for step in 0..=24 {
            let time = f64::from(step) * 0.005;
            assert!((path.at(time) - place(time)).norm() < 1e-12, "{time}");
        }
    }

    #[test]
    fn a_slow_sway_is_followed_better_than_by_one_translation_a_frame() {
        // A cycle takes 25 frames.
        let path = |t: f64| Vector2::new(60.0, 25.0) * (std::f64::consts::TAU * t).sin();
        let (flow, inverse) = translation(path);
        let run = Run::translated(SHUTTERS[0], 12, path, 0);
        let (curve, _) = run.left(&Curve, &flow, &inverse);
        let (steps, _) = run.left(&Translation, &flow, &inverse);
        assert!(curve < 0.2 * steps, "{curve} {steps} px");
    }
}
