// SPDX-License-Identifier: MIT OR Apache-2.0

//! The motion of one frame, the shutter it was solved for, and the share of the correction applied.

use super::MotionPath;
use super::sampled::{normalised, scaled, turned};
use crate::area::PictureArea;
use crate::readout::Readout;
use nalgebra::Matrix3;

/// The motion of one frame, as needed for its rectification.
///
/// Path, readout and weight are kept together: the path is a function of the elapsed share of *its* readout,
/// and if it is uncertain only a part of the correction improves the frame.
///
/// Where black bars lie beside the picture, all of this is of the picture alone: its size, its centre and its readout. The
/// [area](Self::area) states where it lies in the frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameMotion {
    readout: Readout,
    path: MotionPath,
    weight: f64,
    placement: Option<Matrix3<f64>>,
    area: PictureArea,
}

impl FrameMotion {
    /// A motion whose correction is applied in full.
    #[must_use]
    pub const fn new(readout: Readout, path: MotionPath) -> Self {
        let area = PictureArea::whole(readout.width, readout.height);
        Self { readout, path, weight: 1.0, placement: None, area }
    }

    /// The same motion with this share of the correction applied, clamped to 0 to 1; NaN counts as 0.
    #[must_use]
    pub fn with_weight(self, weight: f64) -> Self {
        Self { weight: if weight.is_nan() { 0.0 } else { weight.clamp(0.0, 1.0) }, ..self }
    }

    /// The same motion of a frame that is stabilised: `placement` maps the points (centred pixels) of the picture at the
    /// middle of the readout to where the output shows them. It is left out where it cannot be undone.
    #[must_use]
    pub fn with_placement(self, placement: Option<Matrix3<f64>>) -> Self {
        Self { placement: placement.as_ref().and_then(normalised), ..self }
    }

    /// The same motion of a picture that lies there in its frame. An area of another size than the readout's is not taken over.
    #[must_use]
    pub fn within(self, area: PictureArea) -> Self {
        let is_fit = area.size() == [self.readout.width, self.readout.height];
        if is_fit { Self { area, ..self } } else { self }
    }

    /// Where the picture lies in its frame.
    #[must_use]
    pub const fn area(&self) -> &PictureArea {
        &self.area
    }

    /// The shutter that the motion was solved for.
    #[must_use]
    pub const fn readout(&self) -> &Readout {
        &self.readout
    }

    /// The motion during the frame's readout; [`MotionPath::STILL`] if none was found.
    #[must_use]
    pub const fn path(&self) -> &MotionPath {
        &self.path
    }

    /// Share of the correction that is applied, 0 to 1: less if the motion is uncertain, so that the
    /// correction fades in and out without a jump.
    #[must_use]
    pub const fn weight(&self) -> f64 {
        self.weight
    }

    /// Where the output shows the points (centred pixels) of the picture at the middle of the readout; `None` for a frame that
    /// is not stabilised.
    #[must_use]
    pub const fn placement(&self) -> Option<&Matrix3<f64>> {
        self.placement.as_ref()
    }

    /// The same motion of the frame scaled to `width` × `height` pixels, as of a proxy.
    #[must_use]
    pub fn scaled_to(&self, width: usize, height: usize) -> Self {
        let area = self.area.scaled_to(width, height);
        let [width, height] = area.size();
        let readout = Readout { width, height, ..self.readout };
        let (from, to) = ([self.readout.width, self.readout.height], [width, height]);
        if from == to || from.contains(&0) || to.contains(&0) {
            return Self { readout, area, ..self.clone() };
        }
        let factors = [0, 1].map(|axis| to[axis] as f64 / from[axis] as f64);
        let placement = self.placement.map(|placement| scaled(&placement, factors));
        Self { readout, path: self.path.scaled(factors), weight: self.weight, placement, area }
    }

    /// The same motion of the frame turned clockwise by a quarter.
    #[must_use]
    pub fn turned(&self) -> Self {
        let Readout { width, height, direction, time } = self.readout;
        let readout = Readout { width: height, height: width, direction: direction.turned(), time };
        let placement = self.placement.map(|placement| turned(&placement));
        Self { readout, path: self.path.turned(), weight: self.weight, placement, area: self.area.turned() }
    }

    /// Whether no correction is applied: nothing moved or the weight is 0, and the frame is not stabilised.
    #[must_use]
    pub fn is_still(&self) -> bool {
        self.placement.is_none() && (self.weight == 0.0 || self.path.is_still())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Twist;
    use crate::readout::{ReadoutDirection, ReadoutTime};

    #[test]
    fn a_scaled_motion_carries_scaled_points() {
        use crate::motion::{ResidualField, ResidualMesh};
        use nalgebra::Vector2;
        let readout =
            Readout::new(640, 480, ReadoutDirection::TopToBottom, ReadoutTime::WholePeriod, 0.02).unwrap();
        let mesh = ResidualMesh { columns: 2, rows: 1, origin: [-300.0, 0.0], spacing: [600.0, 8.0] };
        let field = ResidualField::new(mesh, vec![[2.0, -3.0], [6.0, 1.0]]).unwrap();
        let path = MotionPath::uniform(Twist::new(3.0, 400.0, -700.0), 0.02).with_residual(field);
        let motion = FrameMotion::new(readout, path).with_weight(0.5);
        let point = Vector2::new(100.0, -70.0);
        // Half of the size, and a proxy whose pixels are not square.
        for (size, tolerance) in [([320, 240], 1e-12), ([320, 480], 1e-4)] {
            let scaled = motion.scaled_to(size[0], size[1]);
            assert_eq!((scaled.readout().width(), scaled.readout().height()), (size[0], size[1]));
            assert_eq!((scaled.weight(), scaled.readout().time()), (0.5, 0.02));
            let by = Vector2::new(size[0] as f64 / 640.0, size[1] as f64 / 480.0);
            let expected = motion.path().carry(point, 0.1, 0.5).component_mul(&by);
            let moved = scaled.path().carry(point.component_mul(&by), 0.1, 0.5);
            assert!((moved - expected).norm() < tolerance, "{size:?}: {moved} for {expected}");
            // There and back again.
            let back = scaled.scaled_to(640, 480).path().carry(point, 0.1, 0.5);
            assert!((back - motion.path().carry(point, 0.1, 0.5)).norm() < 2.0 * tolerance);
        }
        assert_eq!(motion.scaled_to(640, 480), motion);
    }

    #[test]
    fn a_turned_motion_carries_turned_points() {
        use crate::motion::{ResidualField, ResidualMesh, SampledPath};
        use nalgebra::{Matrix3, Vector2};
        let turned = |point: Vector2<f64>| Vector2::new(-point.y, point.x);
        let directions = [
            ReadoutDirection::TopToBottom,
            ReadoutDirection::RightToLeft,
            ReadoutDirection::BottomToTop,
            ReadoutDirection::LeftToRight,
        ];
        let mesh = ResidualMesh { columns: 3, rows: 2, origin: [-300.0, -90.0], spacing: [200.0, 150.0] };
        let velocities = (0..6u8).map(|node| [f32::from(node), f32::from(node * node) - 4.0]).collect();
        let field = ResidualField::new(mesh, velocities).unwrap();
        let motions: Vec<_> = (0..9)
            .map(|index| {
                let share = f64::from(index) / 8.0;
                Matrix3::new(
                    1.0,
                    -0.02 * share,
                    9.0 * share,
                    0.01,
                    1.0,
                    -4.0 * share,
                    1e-5,
                    2e-5 * share,
                    1.0,
                )
            })
            .collect();
        let sampled = MotionPath::from(SampledPath::new(&motions, 0.02).unwrap());
        let uniform = MotionPath::uniform(Twist::new(3.0, 400.0, -700.0), 0.02);
        for (direction, next) in directions.into_iter().zip(directions.into_iter().cycle().skip(1)) {
            let readout = Readout::new(640, 480, direction, ReadoutTime::WholePeriod, 0.02).unwrap();
            for path in [&sampled, &uniform] {
                let motion = FrameMotion::new(readout, path.clone().with_residual(field.clone()));
                let after = motion.turned();
                assert_eq!(after.readout().direction(), next);
                // The pixel (30, 50) comes to column 480 − 1 − 50, row 30.
                let share = readout.share(30.0, 50.0);
                assert!((after.readout().share(429.0, 30.0) - share).abs() < 1e-12);
                let point = Vector2::new(30.0 - 319.5, 50.0 - 239.5);
                let expected = turned(motion.path().carry(point, share, 0.5));
                let moved = after.path().carry(turned(point), share, 0.5);
                assert!((moved - expected).norm() < 1e-9, "{moved} for {expected}");
                let back = after.turned().turned().turned();
                assert!(
                    (back.path().carry(point, share, 0.5) - turned(turned(turned(expected)))).norm() < 1e-9
                );
                assert_eq!(back.readout(), motion.readout());
            }
        }
    }

    #[test]
    fn a_placement_is_scaled_and_turned_with_the_frame() {
        use nalgebra::Vector2;
        let readout =
            Readout::new(640, 480, ReadoutDirection::TopToBottom, ReadoutTime::WholePeriod, 0.02).unwrap();
        let placement = Matrix3::new(0.9, -0.1, 20.0, 0.1, 0.95, -7.0, 1e-5, 2e-5, 1.0);
        let motion = FrameMotion::new(readout, MotionPath::STILL).with_placement(Some(placement * 3.0));
        let shown = |motion: &FrameMotion, point: Vector2<f64>| {
            let shown = motion.placement().unwrap() * point.push(1.0);
            shown.xy() / shown.z
        };
        let point = Vector2::new(100.0, -60.0);
        let expected = placement * point.push(1.0);
        let expected = expected.xy() / expected.z;
        assert!(!motion.is_still() && (shown(&motion, point) - expected).norm() < 1e-9);
        let half = shown(&motion.scaled_to(320, 120), Vector2::new(50.0, -15.0));
        assert!((half - Vector2::new(expected.x / 2.0, expected.y / 4.0)).norm() < 1e-9);
        let turned = shown(&motion.turned(), Vector2::new(60.0, 100.0));
        assert!((turned - Vector2::new(-expected.y, expected.x)).norm() < 1e-9);
        let flat = motion.with_placement(Some(Matrix3::zeros()));
        assert!(flat.placement().is_none() && flat.is_still());
    }

    #[test]
    fn weights_are_shares() {
        let readout =
            Readout::new(8, 4, ReadoutDirection::TopToBottom, ReadoutTime::WholePeriod, 1.0).unwrap();
        let motion = FrameMotion::new(readout, MotionPath::uniform(Twist::new(0.0, 1.0, 0.0), 1.0));
        assert_eq!(motion.weight(), 1.0);
        for (weight, share) in
            [(0.25, 0.25), (-1.0, 0.0), (7.0, 1.0), (f64::NAN, 0.0), (f64::INFINITY, 1.0), (-0.0, 0.0)]
        {
            let motion = motion.clone().with_weight(weight);
            assert_eq!((motion.weight(), motion.is_still()), (share, share == 0.0));
        }
        assert!(FrameMotion::new(readout, MotionPath::STILL).is_still());
    }
}
