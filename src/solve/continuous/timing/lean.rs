// SPDX-License-Identifier: MIT OR Apache-2.0

//! The lean and bend of a frame that was moved after its readout.

use super::lean_change::LeanChange;
use super::smoothed::{Component, Series, smoothed};
use crate::solve::continuous::data::ScanAxis;
use nalgebra::{Matrix3, Vector2};

/// The lean and bend of a frame that was moved after its readout: with the lean l, the bend Q and the place p along the scan axis,
/// points are displaced by (p − ½)·l + ½·(p − ½)²·Q. Pairs have the component across the axis first; lengths are in radii.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lean {
    axis: ScanAxis,
    lean: [Component; 2],
    /// Turn in radians.
    roll: Component,
    bend: [Component; 2],
}

impl Lean {
    /// Of a frame along an axis, from the changes between successive frames and the velocities at them, one more; `number` is that of the
    /// frame among them, `None` if nothing is known of its lean.
    pub fn of(
        axis: ScanAxis,
        number: Option<usize>,
        changes: &[LeanChange],
        velocities: &[Vector2<f64>],
    ) -> Self {
        let series = |coordinate: usize| {
            let change = |pair: &LeanChange| Component {
                value: pair.change[coordinate],
                variance: pair.variance[coordinate],
            };
            Series::of_lean(
                changes.iter().map(change).collect(),
                velocities.iter().map(|velocity| velocity[coordinate]).collect(),
            )
        };
        let lean = [0, 1].map(series);
        let roll = |pair: &LeanChange| Component { value: pair.roll, variance: 0.5 * pair.variance.sum() };
        // A stabiliser leaves no roll.
        let roll = [Series::of_lean(changes.iter().map(roll).collect(), vec![0.0; velocities.len()])];
        let bend = [0, 1].map(|coordinate| {
            let bends = changes.iter().map(|pair| pair.curvature[coordinate]);
            Series::of_bend(bends.collect(), &lean[coordinate])
        });
        let [roll] = of_frame(&roll, number);
        Self { axis, lean: of_frame(&lean, number), roll, bend: of_frame(&bend, number) }
    }

    /// A pair of components as x and y.
    fn in_xy(self, [across, along]: &[Component; 2]) -> Vector2<f64> {
        let [across, along] = [across.value, along.value];
        if self.axis.by_rows { Vector2::new(across, along) } else { Vector2::new(along, across) }
    }

    /// Displacement of a point in radii.
    pub fn displacement(&self, point: Vector2<f64>) -> Vector2<f64> {
        let late = self.axis.place(point) - 0.5;
        let lean = self.in_xy(&self.lean) + Vector2::new(-point.y, point.x) * self.roll.value;
        lean * late + self.in_xy(&self.bend) * (0.5 * late * late)
    }

    /// Variance of the displacement in squared radii, of both coordinates.
    pub fn variance(&self, point: Vector2<f64>) -> f64 {
        let square = (self.axis.place(point) - 0.5).powi(2);
        let of = |[across, along]: &[Component; 2]| across.variance + along.variance;
        let lean = of(&self.lean) + self.roll.variance * point.norm_squared();
        square * lean + 0.25 * square * square * of(&self.bend)
    }

    /// The homography in centred pixels that takes the displacement from the points at a place along the axis; `radius` is half the
    /// frame's width.
    pub fn homography(&self, place: f64, radius: f64) -> Matrix3<f64> {
        let late = place - 0.5;
        let shift = (self.in_xy(&self.lean) + self.in_xy(&self.bend) * (0.5 * late)) * (late * radius);
        let turn = late * self.roll.value;
        Matrix3::new(1.0, turn, -shift.x, -turn, 1.0, -shift.y, 0.0, 0.0, 1.0)
    }
}

/// The components of a frame.
fn of_frame<const N: usize>(series: &[Series; N], number: Option<usize>) -> [Component; N] {
    number.map_or_else(|| series.each_ref().map(Series::unknown), |number| smoothed(series, number))
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: fn(f64) -> Component = |value| Component { value, variance: 0.01 };

    fn lean(by_rows: bool) -> Lean {
        let axis = ScanAxis { by_rows, length: 1.5 };
        Lean { axis, lean: [KNOWN(0.04), KNOWN(-0.02)], roll: KNOWN(0.03), bend: [KNOWN(0.1), KNOWN(0.06)] }
    }

    #[test]
    fn the_homographies_take_the_displacement_out() {
        const RADIUS: f64 = 320.0;
        for lean in [true, false].map(lean) {
            for point in [Vector2::new(0.3, -0.6), Vector2::new(-0.9, 0.5)] {
                let place = lean.axis.place(point);
                let seen = (point * RADIUS).push(1.0);
                let moved = (lean.homography(place, RADIUS) * seen - seen).xy() / RADIUS;
                let off = (moved + lean.displacement(point)).norm();
                assert!(off < 1e-12, "{moved} {}", lean.displacement(point));
            }
        }
    }

    #[test]
    fn a_bend_displaces_both_ends_the_same_way() {
        let bent = Lean { lean: [KNOWN(0.0); 2], roll: KNOWN(0.0), ..lean(true) };
        let ends = [-0.75, 0.75].map(|y| bent.displacement(Vector2::new(0.2, y)));
        let expected = Vector2::new(0.1, 0.06) / 8.0;
        assert!(ends.into_iter().all(|end| (end - expected).norm() < 1e-12), "{ends:?}");
        assert_eq!(bent.displacement(Vector2::new(0.2, 0.0)).norm(), 0.0);
    }
}
