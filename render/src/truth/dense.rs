// SPDX-License-Identifier: MIT OR Apache-2.0

//! The truth of whole frames: maps of displacements and the mask of visible pixels.

use super::capture::Capture;
use nalgebra::Vector2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// The mask is exact at every so many pixels in x and y.
const MASK_STEP: usize = 2;

/// Displacements of the scene points seen at every `step`th pixel of a frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DisplacementMap {
    /// Distance between samples in pixels; the first is `step / 2` from the frame's corner, in x and
    /// in y.
    pub step: usize,
    /// Samples in a row.
    pub columns: usize,
    /// Rows of samples.
    pub rows: usize,
    /// Row by row, the displacement (x, y) in pixels; `None` where the point is outside the frame or
    /// hidden after it.
    pub values: Vec<Option<[f32; 2]>>,
}

impl DisplacementMap {
    /// The pixel at which a sample was taken, by its index in `values`.
    pub fn pixel(&self, index: usize) -> Vector2<f64> {
        let place = |index: usize| (self.step / 2 + index * self.step.max(1)) as f64;
        Vector2::new(place(index % self.columns), place(index / self.columns))
    }
}

impl Capture<'_> {
    /// From the places where points are seen to those that they have when the share of the readout
    /// has elapsed: 0 is its first instant, ½ the middle, 1 the last.
    pub fn displacement_to_share(&self, share: f64, step: usize) -> DisplacementMap {
        self.displacement(step, |pixel| self.to_share(pixel, share))
    }

    /// From the places where this frame sees points to those where `other`, of the same scene, sees
    /// them: forward to the next frame, backward to the one before.
    pub fn displacement_to(&self, other: &Self, step: usize) -> DisplacementMap {
        self.displacement(step, |pixel| self.seen_by(other, pixel))
    }

    fn displacement(
        &self,
        step: usize,
        place: impl Fn(Vector2<f64>) -> Option<Vector2<f64>> + Sync,
    ) -> DisplacementMap {
        let [columns, rows] = self.places(step).map(|places| places.len());
        let mut map = DisplacementMap { step, columns, rows, values: Vec::new() };
        let value = |index: usize| {
            let pixel = map.pixel(index);
            place(pixel).map(|to| [(to.x - pixel.x) as f32, (to.y - pixel.y) as f32])
        };
        map.values = (0..columns * rows).into_par_iter().map(value).collect();
        map
    }

    /// For each pixel of the frame that a global shutter sees at the reference instant, row by row:
    /// whether the scene point seen there is visible in the rolling frame, that is inside it and not
    /// hidden.
    ///
    /// Every second pixel in x and y is traced; a pixel between them counts as visible where all of
    /// its traced neighbours are, so that the mask errs, by a pixel at most, on the side of leaving
    /// out, save for what is hidden behind things one pixel wide.
    pub fn visibility(&self) -> Vec<bool> {
        let lens = &self.take.camera.lens;
        let [columns, rows] = [lens.width, lens.height].map(traced);
        let trace = |index: usize| {
            let (x, y) = (columns[index % columns.len()], rows[index / columns.len()]);
            let pixel = self.warp.captured(Vector2::new(x as f64, y as f64));
            let point = self.take.look(self.reference(), pixel);
            point.is_some_and(|point| self.observe(&point).is_some())
        };
        let seen: Vec<bool> = (0..columns.len() * rows.len()).into_par_iter().map(trace).collect();
        let pixel = |index: usize| {
            let (x, y) = (index % lens.width, index / lens.width);
            let mut around = neighbours(y).flat_map(|row| neighbours(x).map(move |column| (row, column)));
            around.all(|(row, column)| seen[row * columns.len() + column])
        };
        (0..lens.width * lens.height).map(pixel).collect()
    }
}

/// The traced positions along a side: every [`MASK_STEP`]th and the last.
fn traced(length: usize) -> Vec<usize> {
    let last = length.saturating_sub(1);
    (0..last).step_by(MASK_STEP).chain([last]).collect()
}

/// Indices of the traced positions at or beside a position.
fn neighbours(position: usize) -> std::ops::RangeInclusive<usize> {
    position / MASK_STEP..=position.div_ceil(MASK_STEP)
}

#[cfg(test)]
mod tests {
    use super::super::capture::Sample;
    use super::super::capture::tests::{DEPTH, FOCAL, PERIOD, READOUT, frame, until_reference, wall};
    use super::*;
    use crate::scene::path::uniform;
    use crate::scene::{FirstEdge, Scene, Surface};
    use nalgebra::Vector3;
    use std::sync::Arc;

    const VELOCITY: Vector3<f64> = Vector3::new(12.0, 0.0, 0.0);

    /// How far right of its true place the wall is seen in a row, in pixels.
    fn skew(y: usize) -> f64 {
        let until = until_reference(FirstEdge::Top, Vector2::new(0.0, y as f64));
        VELOCITY.x * FOCAL / DEPTH * until
    }

    #[test]
    fn what_leaves_the_frame_sideways_is_not_visible() {
        let take = wall(FirstEdge::Top, uniform(0.0, VELOCITY));
        let mask = frame(&take, 2).visibility();
        assert_eq!(mask.len(), 320 * 240);
        for (index, visible) in mask.iter().enumerate() {
            let seen = (index % 320) as f64 + skew(index / 320);
            assert!(!visible || (-1e-6..=319.0 + 1e-6).contains(&seen));
            assert!(*visible || !(2.5..=316.5).contains(&seen), "{seen}");
        }
        assert!(mask.iter().any(|visible| !visible));
    }

    #[test]
    fn what_a_nearer_patch_covers_is_not_visible() {
        let mut take = wall(FirstEdge::Top, uniform(0.0, VELOCITY));
        // At half the depth, over columns 100 to 140 at the reference instant.
        let camera = VELOCITY.x * frame(&take, 0).reference();
        let at = |column: f64| camera + (column - 159.5) / FOCAL * DEPTH / 2.0;
        let (left, right) = (at(100.0), at(140.0));
        let patch = Surface::new(
            Vector3::new(left, -9.0, DEPTH / 2.0),
            Vector3::x() * (right - left),
            Vector3::y() * 18.0,
        );
        let surfaces = [take.scene.surfaces.clone(), vec![patch]].concat();
        take.scene = Arc::new(Scene { surfaces, ..Scene::default() });
        let mask = frame(&take, 0).visibility();
        for (x, y) in (10..230).flat_map(|y| (60..190).map(move |x| (x, y))) {
            // The patch moves twice as fast as the wall: of it, and of itself, nothing is hidden.
            let [from, to] = [100.0, 140.0].map(|edge| edge + skew(y));
            let x64 = f64::from(x);
            let hidden = |margin: f64| {
                x64 > from - margin && x64 < to + margin && !(100.0 + margin..140.0 - margin).contains(&x64)
            };
            let visible = mask[y * 320 + x as usize];
            assert!(!(visible && hidden(-1.5)), "{x} {y} is behind the patch");
            let near = |edge: f64| (x64 - edge).abs() < 4.0;
            let open = !hidden(0.0) && ![from, to, 100.0, 140.0].into_iter().any(near);
            assert!(visible || !open, "{x} {y} is in the open");
        }
    }

    #[test]
    fn maps_follow_the_wall_over_the_readout() {
        let velocity = Vector3::new(0.9, 0.6, 0.0);
        let take = wall(FirstEdge::Bottom, uniform(0.0, velocity));
        for share in [0.0, 0.5, 1.0] {
            let map = frame(&take, 3).displacement_to_share(share, 8);
            assert_eq!((map.columns, map.rows, map.values.len()), (40, 30, 1200));
            for (index, value) in map.values.iter().enumerate() {
                let Some(value) = value else { continue };
                let until = until_reference(FirstEdge::Bottom, map.pixel(index)) + READOUT * (share - 0.5);
                let expected = -velocity.xy() * (FOCAL / DEPTH * until);
                assert!((Vector2::from(value.map(f64::from)) - expected).norm() < 1e-5);
            }
            assert!(map.values.iter().flatten().count() > 1100);
        }
    }

    #[test]
    fn the_middle_map_holds_the_samples() {
        let take = wall(FirstEdge::Left, uniform(0.4, Vector3::new(0.9, 0.6, 0.0)));
        let map = frame(&take, 3).displacement_to_share(0.5, 16);
        let seen = (0..map.values.len()).filter(|index| map.values[*index].is_some());
        let pixels: Vec<_> = seen.map(|index| map.pixel(index)).collect();
        let samples: Vec<_> = frame(&take, 3).samples(16).iter().map(|sample: &Sample| sample.seen).collect();
        assert_eq!(pixels, samples);
    }

    #[test]
    fn backward_undoes_forward() {
        let velocity = Vector3::new(0.9, 0.6, 0.0);
        let take = wall(FirstEdge::Top, uniform(0.0, velocity));
        let (this, next) = (frame(&take, 3), frame(&take, 4));
        // y′ − y = v (P + T (y′ − y)/N), whichever way the pair is seen.
        let image = -velocity.xy() * (FOCAL / DEPTH);
        let rise = image.y * PERIOD / (1.0 - image.y * READOUT / 240.0);
        let shift = image * (PERIOD + READOUT * rise / 240.0);
        for (map, expected) in
            [(this.displacement_to(&next, 8), shift), (next.displacement_to(&this, 8), -shift)]
        {
            assert!(map.values.iter().flatten().count() > 1000);
            for value in map.values.iter().flatten() {
                assert!((Vector2::from(value.map(f64::from)) - expected).norm() < 1e-5);
            }
        }
    }
}
