// SPDX-License-Identifier: MIT OR Apache-2.0

//! How much a frame must be enlarged so that its borders stay out of sight.

use super::correction::Correction;
use super::settings::{Interpolation, WarpSettings};
use crate::motion::FrameMotion;
use nalgebra::Vector2;

/// Points along each edge: as many as the warp's map has nodes along the readout, and more than a residual field has cells.
const POINTS: usize = 256;

/// Share of the crop up to which borders may come while nothing is bent. `rsrectify fix --crop auto` crops by so much more than the
/// borders need.
pub const UNBENT_SHARE: f64 = 0.95;
/// The least zoom with which no border of the frame is seen when it is rectified by this motion with these settings, whose
/// own zoom does not count; at least 1, and infinite where a border crosses the picture's centre.
///
/// The outermost pixels that the interpolation needs beside the one shown count as border.
#[must_use]
pub fn least_zoom(motion: &FrameMotion, settings: &WarpSettings) -> f64 {
    if motion.is_still() || settings.strength <= 0.0 {
        return 1.0;
    }
    1.0 / (1.0 - Correction::new(motion, settings).depth(settings.interpolation))
}

impl Correction<'_> {
    /// How far borders come into the rectified frame, zoom aside: as a share of half its width or height, at most 1. The outermost
    /// pixels that the interpolation needs beside the one shown count as border.
    fn depth(&self, interpolation: Interpolation) -> f64 {
        let outwards = self.edge_points(interpolation).map(|point| self.outwards(&point));
        1.0 - outwards.fold(1.0, f64::min).max(0.0)
    }

    /// The outermost points of the frame that can be shown.
    fn edge_points(&self, interpolation: Interpolation) -> impl Iterator<Item = EdgePoint> {
        let taps = interpolation.taps() as f64 / 2.0;
        let seen = self.centre.map(|half| (half - taps).max(0.0));
        let along = |index: usize| 2.0 * index as f64 / POINTS as f64 - 1.0;
        let edges = [(0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0)];
        edges.into_iter().flat_map(move |(axis, end)| {
            (0..=POINTS).map(move |index| {
                let mut at = seen;
                at[axis] *= end;
                at[1 - axis] *= along(index);
                EdgePoint { at, axis, end }
            })
        })
    }

    /// Where an outermost point is shown: as a share of the way from the centre to its edge of the output.
    fn outwards(&self, &EdgePoint { at, axis, end }: &EdgePoint) -> f64 {
        let half = self.centre[axis];
        let shown = at + self.displacement(&self.interval_at(at), at);
        if half > 0.0 { end * shown[axis] / half } else { 1.0 }
    }
}

/// A point near an edge of the frame, in centred pixels, the axis across the edge, and its end.
struct EdgePoint {
    at: Vector2<f64>,
    axis: usize,
    end: f64,
}

/// The correction of a frame, bent so that the zoom hides the borders, where that is asked for.
///
/// What is left out depends on this frame alone, so that any frame can be rectified without those before; as the motion does, it
/// changes gradually from frame to frame.
pub(super) fn kept_inside<'a>(motion: &'a FrameMotion, settings: &WarpSettings) -> Correction<'a> {
    let correction = Correction::new(motion, settings);
    if !settings.hide_borders || correction.zoom == 1.0 || motion.is_still() {
        return correction;
    }
    let (whole, crop) = (correction.depth(settings.interpolation), 1.0 - 1.0 / correction.zoom);
    let unbent = crop * UNBENT_SHARE;
    if whole <= unbent {
        return correction;
    }
    // From there on it comes nearer to the whole crop, without a kink, but does not reach it.
    let rest = crop - unbent;
    let wanted = crop - rest * (-(whole - unbent) / rest).exp();
    let with = |of_path, of_placement| Correction::with_shares(motion, settings, of_path, of_placement);
    let unplaced = with(1.0, 0.0);
    // With the other share fixed, displacements are proportional to each.
    if motion.placement().is_some() && unplaced.depth(settings.interpolation) <= wanted {
        with(1.0, share_inside(&unplaced, &correction, wanted, settings.interpolation))
    } else {
        with(share_inside(&with(0.0, 0.0), &unplaced, wanted, settings.interpolation), 0.0)
    }
}

/// How far, as a share of the way from one correction to the other, borders come in by no more than a depth; 0 to 1.
fn share_inside(from: &Correction<'_>, to: &Correction<'_>, depth: f64, interpolation: Interpolation) -> f64 {
    let least = 1.0 - depth;
    let shares = from.edge_points(interpolation).map(|point| {
        let [near, far] = [from, to].map(|correction| correction.outwards(&point));
        if far >= least { 1.0 } else { (near - least).max(0.0) / (near - far) }
    });
    // Of a point that is outside with the one correction and farther with the other: 0 / 0 or 0 / −x.
    shares.fold(1.0, |all: f64, share| all.min(share.max(0.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{MotionPath, Twist};
    use crate::readout::{Readout, ReadoutDirection, ReadoutTime};
    use nalgebra::Matrix3;

    #[test]
    fn a_shift_is_hidden_by_as_much_on_both_sides() {
        let motion = FrameMotion::new(Readout::global_shutter(641, 481), MotionPath::STILL);
        let settings = WarpSettings { interpolation: Interpolation::Linear, ..WarpSettings::default() };
        assert_eq!(least_zoom(&motion, &settings), 1.0);
        let shift = Matrix3::new(1.0, 0.0, 19.0, 0.0, 1.0, -4.0, 0.0, 0.0, 1.0);
        let motion = motion.with_placement(Some(shift));
        // 19 px and the row beside: 20 of 320.
        assert!((least_zoom(&motion, &settings) - 320.0 / 300.0).abs() < 1e-9);
        let half = WarpSettings { strength: 0.5, ..settings };
        assert!((least_zoom(&motion, &half) - 320.0 / 309.5).abs() < 1e-9);
        let far = Matrix3::new(1.0, 0.0, 400.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
        assert_eq!(least_zoom(&motion.with_placement(Some(far)), &settings), f64::INFINITY);
    }

    #[test]
    fn what_the_zoom_does_not_hide_is_left_out() {
        let readout =
            Readout::new(641, 481, ReadoutDirection::TopToBottom, ReadoutTime::WholePeriod, 0.04).unwrap();
        let path = |vx: f64| MotionPath::uniform(Twist::new(0.2, vx, 40.0), 0.04);
        let mut settings = WarpSettings::default();
        (settings.zoom, settings.hide_borders) = (1.0 / 0.9, true);
        let depth = |correction: &Correction<'_>| correction.depth(settings.interpolation);
        let mut before = 0.0;
        for step in 0..60 {
            // In the end five times as much as the crop hides.
            let motion = FrameMotion::new(readout, path(150.0 * f64::from(step)));
            let shift = 3.0 * f64::from(step);
            let placement = Matrix3::new(1.0, 0.0, shift, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
            for motion in [motion.clone(), motion.with_placement(Some(placement))] {
                let [whole, kept] = [Correction::new(&motion, &settings), kept_inside(&motion, &settings)];
                let [whole, kept] = [depth(&whole), depth(&kept)];
                assert!(kept < 0.1 + 1e-9 && kept < whole + 1e-9, "step {step}: {kept} of {whole}");
                if whole < 0.1 * UNBENT_SHARE {
                    assert_eq!(kept, whole);
                } else {
                    assert!(kept > 0.094, "step {step}: {kept} of {whole}");
                }
            }
            // Nothing jumps where bending begins.
            let motion = FrameMotion::new(readout, path(150.0 * f64::from(step)));
            let kept = depth(&kept_inside(&motion, &settings));
            assert!((kept - before).abs() < 0.02, "step {step}: {before}, then {kept}");
            before = kept;
        }
        // The placement is given up before the correction.
        let motion = FrameMotion::new(readout, path(100.0));
        let far = Matrix3::new(1.0, 0.0, 80.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
        let placed = motion.clone().with_placement(Some(far));
        let (kept, correction) = (kept_inside(&placed, &settings), Correction::new(&motion, &settings));
        let point = Vector2::new(0.0, -200.0);
        let [kept, whole] = [&kept, &correction].map(|one| one.displacement(&one.interval_at(point), point));
        assert!(kept.x > whole.x + 20.0 && (kept.y - whole.y).abs() < 1e-9, "{kept} with {whole}");
        settings.hide_borders = false;
        assert!(depth(&kept_inside(&placed, &settings)) > 0.2);
    }
}
