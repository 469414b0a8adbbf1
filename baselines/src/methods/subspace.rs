// SPDX-License-Identifier: MIT OR Apache-2.0

//! Subspace video stabilisation, as a remover of rolling shutter.
//!
//! Source: F. Liu, M. Gleicher, J. Wang, H. Jin and A. Agarwala, *Subspace video stabilization*, ACM Trans. Graphics 30(1),
//! 2011. The matrix M of feature tracks, two rows a track and a column a frame, has nearly low rank over a short time:
//! M ≈ C·E with nine eigen-trajectories E. These are low-pass filtered, and each frame is warped from its tracks to those of
//! C·Ê by a content-preserving warp ([`mesh`](super::mesh)). What the rolling shutter does to the tracks at the
//! frequency of the shake is filtered out with it; what it does to slow motions stays. The method is not told the shutter.
//!
//! - Moving factorisation: a window of up to 50 frames is factorised by the singular values of the tracks that span it; then it
//!   moves on by five frames at a time, E at the new frames being the least-squares solution given the coefficients of the
//!   tracks that come from the window. Ten rounds of alternating least squares over all tracks follow.
//! - Low-pass filter: a Gaussian of a given standard deviation, corrected at the ends of the run ([`low_pass`](super::low_pass)).
//!
//! Departures. Four serve clips whose picture moves so fast that few tracks are long: the first window is not the first 50 frames
//! but the longest, of at least 18, that 18 tracks span, and of those the one with most such tracks, from which it moves on
//! both ways; tracks need not span a window, but be seen in 18 frames, which is twice the rank; their coefficients are found under a
//! Gaussian prior of unit variance, the spread of the coefficients in the first window; and the alternation takes out the errors that
//! build up from window to window. And tracks whose residual is above three
//! times the median one are outliers; epipolar geometry, by which the paper finds them, takes the shutter for a global
//! one.

use super::low_pass::weights;
use super::mesh::{Moved, corrections};
use super::timed::untouched;
use super::tracks::{Track, following, link, most_residual};
use super::{Corrections, Input, Method};
use anyhow::Result;
use nalgebra::{DMatrix, SMatrix, SVector, Vector2};
use std::ops::Range;

/// Rank of the matrix of tracks: nine for a rigid scene over a short time (M. Irani, *Multi-frame correspondence estimation using
/// subspace constraints*, IJCV 48, 2002).
const RANK: usize = 9;
/// Tracks that fewer frames see are not used: twice as many observations of each coordinate as coefficients.
const LEAST_SEEN: usize = 2 * RANK;
/// Known frames that must see a track from which the eigen-trajectories at new frames are found.
const LEAST_KNOWN: usize = RANK + 1;
/// Rounds of alternating least squares.
const ROUNDS: usize = 10;
/// Frames of the window that is factorised.
const WINDOW: usize = 50;
/// Frames by which it moves on.
const STRIDE: usize = 5;
/// Fewer tracks than these, of two rows each, do not determine nine eigen-trajectories well.
const LEAST_TRACKS: usize = 2 * RANK;
/// Standard deviation of a track's residuals in pixels, against which the prior of its coefficients counts.
const NOISE: f64 = 0.5;
/// Added to the sums of squared coefficients, each about the number of tracks: far less than these where the tracks determine a
/// trajectory, and enough that one which they do not determine stays near zero.
const RIDGE: f64 = 1e-3;

/// Subspace video stabilisation.
#[derive(Clone, Copy, Debug)]
pub struct Subspace {
    /// Standard deviation of the low-pass filter in seconds.
    pub deviation: f64,
}

impl Method for Subspace {
    fn name(&self) -> String {
        "subspace-stabilisation".into()
    }

    /// A frame that has too few tracks in common with the others takes the warp of the nearest one that has enough.
    fn solve(&self, input: &Input) -> Result<Corrections> {
        let mut tracks = following(link(input), input.stamps.len());
        tracks.retain(|track| track.places.len() >= LEAST_SEEN);
        let Some(basis) = Basis::factorise(&tracks, input.stamps.len()) else {
            return Ok(input.stamps.iter().map(|_| untouched()).collect());
        };
        let smooth = basis.filtered(self.deviation / input.period);
        let moved =
            basis.fitted(&tracks, &basis.known(), LEAST_SEEN).into_iter().map(|(track, coefficients)| {
                let to = (track.first..track.end()).map(|frame| smooth.place(frame, &coefficients));
                Moved { track, to: to.collect() }
            });
        Ok(corrections(input, &moved.collect::<Vec<_>>()))
    }
}

/// The coefficients of a track: a column for x, one for y.
type Coefficients = SMatrix<f64, RANK, 2>;

/// The eigen-trajectories E of successive frames.
#[derive(Clone, Debug)]
struct Basis {
    first: usize,
    frames: Vec<SVector<f64, RANK>>,
}

impl Basis {
    /// The moving factorisation of tracks in so many frames; `None` where no window has enough tracks that span it.
    fn factorise(tracks: &[Track], frames: usize) -> Option<Self> {
        let spanning =
            |window: &Range<usize>| tracks.iter().filter(|track| track.spans(window)).collect::<Vec<_>>();
        let windows = (LEAST_SEEN..=WINDOW.min(frames)).rev().filter_map(|length| {
            let all = (0..=frames - length).map(|start| start..start + length);
            all.max_by_key(|window| spanning(window).len())
        });
        let window = windows.into_iter().find(|window| spanning(window).len() >= LEAST_TRACKS)?;
        let first = Self::of_complete(&spanning(&window), &window);
        let kept: Vec<_> =
            first.fitted(spanning(&window), &window, LEAST_SEEN).into_iter().map(|kept| kept.0).collect();
        let mut basis = Self::of_complete(&kept, &window);
        let length = window.len();
        while basis.known().end < frames {
            let Range { start, end } = basis.known();
            let new = end..(end + STRIDE).min(frames);
            let Some(found) = basis.extended(tracks, &(start.max(new.end.saturating_sub(length))..end), &new)
            else {
                break;
            };
            basis.frames.extend(found);
        }
        while basis.first > 0 {
            let Range { start, end } = basis.known();
            let new = start.saturating_sub(STRIDE)..start;
            let Some(found) = basis.extended(tracks, &(start..end.min(new.start + length)), &new) else {
                break;
            };
            basis.frames.splice(0..0, found);
            basis.first = new.start;
        }
        Some(basis.refined(tracks))
    }

    /// From tracks that span a window: the right singular vectors of their matrix, by the eigenvectors of MᵀM, each as long as
    /// makes the coefficients' mean square 1.
    fn of_complete(tracks: &[&Track], window: &Range<usize>) -> Self {
        let row = |track: &Track, axis: usize| -> Vec<f64> {
            window.clone().filter_map(|frame| Some(track.at(frame)?[axis])).collect()
        };
        let rows = tracks.iter().flat_map(|track| [row(track, 0), row(track, 1)]);
        let matrix = DMatrix::from_row_iterator(2 * tracks.len(), window.len(), rows.flatten());
        let gram = matrix.tr_mul(&matrix) / (2 * tracks.len()) as f64;
        let eigen = gram.symmetric_eigen();
        let mut order: Vec<usize> = (0..window.len()).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let entry = |frame: usize, rank: usize| {
            let index = order[rank];
            eigen.eigenvalues[index].max(0.0).sqrt() * eigen.eigenvectors[(frame, index)]
        };
        let frames = (0..window.len()).map(|frame| SVector::from_fn(|rank, _| entry(frame, rank))).collect();
        Self { first: window.start, frames }
    }

    /// The frames that it covers.
    fn known(&self) -> Range<usize> {
        self.first..self.first + self.frames.len()
    }

    /// The eigen-trajectories at new frames, from the tracks that are seen in all of these and in enough of the known ones
    /// given; `None` where there are too few such tracks.
    fn extended(
        &self,
        tracks: &[Track],
        known: &Range<usize>,
        new: &Range<usize>,
    ) -> Option<Vec<SVector<f64, RANK>>> {
        let through = self.fitted(tracks.iter().filter(|track| track.spans(new)), known, LEAST_KNOWN);
        if through.len() < LEAST_TRACKS {
            return None;
        }
        new.clone().map(|frame| at_frame(&through, frame)).collect()
    }

    /// Alternates between the coefficients of all tracks given E, and E given these.
    fn refined(mut self, tracks: &[Track]) -> Self {
        for _ in 0..ROUNDS {
            let fitted = self.fitted(tracks, &self.known(), LEAST_SEEN);
            for frame in self.known() {
                let seen = fitted.iter().filter(|(track, _)| track.at(frame).is_some()).copied();
                let seen: Vec<_> = seen.collect();
                if let Some(found) = at_frame(&seen, frame).filter(|_| seen.len() >= LEAST_TRACKS) {
                    self.frames[frame - self.first] = found;
                }
            }
        }
        self
    }

    /// Where a track with these coefficients is; the nearest known frame counts for others.
    fn place(&self, frame: usize, coefficients: &Coefficients) -> Vector2<f64> {
        let index = frame.saturating_sub(self.first).min(self.frames.len() - 1);
        coefficients.tr_mul(&self.frames[index])
    }

    /// The coefficients of a track from those of the given frames, all of them known, that see it; and the RMS residual in pixels.
    /// `None` where fewer than `least` see it.
    fn coefficients(
        &self,
        track: &Track,
        frames: &Range<usize>,
        least: usize,
    ) -> Option<(Coefficients, f64)> {
        let seen = track.first.max(frames.start)..track.end().min(frames.end);
        if seen.len() < least {
            return None;
        }
        let mut normal = SMatrix::<f64, RANK, RANK>::identity() * (NOISE * NOISE);
        let mut right = Coefficients::zeros();
        for frame in seen.clone() {
            let basis = self.frames[frame - self.first];
            normal += basis * basis.transpose();
            right += basis * track.at(frame)?.transpose();
        }
        let found = normal.cholesky()?.solve(&right);
        let off = |frame| track.at(frame).map_or(0.0, |at| (at - self.place(frame, &found)).norm_squared());
        let count = seen.len() as f64;
        Some((found, (seen.map(off).sum::<f64>() / count).sqrt()))
    }

    /// The tracks that are no outliers, with their coefficients from the given frames, at least `least` of which see
    /// them.
    fn fitted<'a>(
        &self,
        tracks: impl IntoIterator<Item = &'a Track>,
        frames: &Range<usize>,
        least: usize,
    ) -> Vec<(&'a Track, Coefficients)> {
        let found =
            tracks.into_iter().filter_map(|track| Some((track, self.coefficients(track, frames, least)?)));
        let found: Vec<_> = found.collect();
        let most = most_residual(found.iter().map(|(_, (_, residual))| *residual).collect());
        let kept = found.into_iter().filter(|(_, (_, residual))| *residual <= most);
        kept.map(|(track, (coefficients, _))| (track, coefficients)).collect()
    }

    /// Ê: each eigen-trajectory, low-pass filtered with a standard deviation in frames.
    fn filtered(&self, deviation: f64) -> Self {
        let count = self.frames.len();
        let filtered =
            |at: usize| weights(count, at, deviation).iter().zip(&self.frames).map(|(w, e)| e * *w).sum();
        Self { first: self.first, frames: (0..count).map(filtered).collect() }
    }
}

/// The eigen-trajectories at a frame that sees all of these tracks, by least squares.
fn at_frame(tracks: &[(&Track, Coefficients)], frame: usize) -> Option<SVector<f64, RANK>> {
    // A trajectory that no track has anything of, where the rank is lower, is not determined.
    let mut normal = SMatrix::<f64, RANK, RANK>::identity() * RIDGE;
    let mut right = SVector::<f64, RANK>::zeros();
    for (track, coefficients) in tracks {
        normal += coefficients * coefficients.transpose();
        right += coefficients * track.at(frame)?;
    }
    Some(normal.cholesky()?.solve(&right))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::tracks::closed_form::{input, pairs};
    use nalgebra::Matrix2;

    /// Places after `frames` frames of an affine motion whose parameters are smooth or shake.
    fn flow(p: Vector2<f64>, time: f64, shake: f64) -> Vector2<f64> {
        let map = Matrix2::new(1.0 + 0.001 * time, 0.0005 * time, -0.0004 * time, 1.0);
        map * p + Vector2::new(0.8 * time + 2.0 * shake, 0.3 * time - shake)
    }

    /// ±1 by turns.
    fn shake(frame: usize) -> f64 {
        if frame.is_multiple_of(2) { 1.0 } else { -1.0 }
    }

    /// Tracks of 60 frames, some of which start later or end earlier.
    fn tracks(amplitude: f64) -> Vec<Track> {
        let track = |index: usize| {
            let start = Vector2::new((index % 10 * 30) as f64, (index / 10 * 30) as f64);
            let (first, end) = [(0, 60), (0, 60), (0, 40), (25, 60)][index % 4];
            let place = |frame: usize| flow(start, frame as f64, amplitude * shake(frame));
            Track { first, places: (first..end).map(place).collect() }
        };
        (0..80).map(track).collect()
    }

    #[test]
    fn tracks_of_low_rank_are_reproduced_beyond_the_first_window() {
        let tracks = tracks(1.0);
        let basis = Basis::factorise(&tracks, 60).unwrap();
        assert_eq!(basis.frames.len(), 60);
        for (track, coefficients) in basis.fitted(&tracks, &(0..60), LEAST_SEEN) {
            for frame in track.first..track.end() {
                let off = basis.place(frame, &coefficients) - track.at(frame).unwrap();
                assert!(off.norm() < 0.05, "frame {frame}: {off}");
            }
        }
    }

    #[test]
    fn the_filter_keeps_smooth_tracks_and_takes_the_shake_out_of_others() {
        for amplitude in [0.0, 1.0] {
            let tracks = tracks(amplitude);
            let basis = Basis::factorise(&tracks, 60).unwrap();
            let smooth = basis.filtered(6.0);
            let fitted = basis.fitted(&tracks, &(0..60), LEAST_SEEN);
            assert!(fitted.len() > 70, "{}", fitted.len());
            for (track, coefficients) in fitted {
                let start = (track.first..track.end()).map(|frame| {
                    let still = track.at(frame).unwrap() - amplitude * shake(frame) * Vector2::new(2.0, -1.0);
                    (smooth.place(frame, &coefficients) - still).norm()
                });
                // At the ends a line through a shake of 2.2 px is not quite a smooth track.
                let (first, last) = (track.first, track.end());
                let ends = |frame: usize| !(6..54).contains(&frame);
                for (frame, off) in (first..last).zip(start) {
                    let most = if ends(frame) { 0.8 } else { 0.15 } * amplitude + 0.1;
                    assert!(off < most, "frame {frame}: {off} px");
                }
            }
        }
    }

    #[test]
    fn a_track_of_its_own_is_an_outlier() {
        let mut tracks = tracks(1.0);
        let own = |place: (usize, &mut Vector2<f64>)| place.1.x += if place.0 % 7 < 3 { 9.0 } else { -4.0 };
        tracks[5].places.iter_mut().enumerate().for_each(own);
        let lone = tracks[5].clone();
        let basis = Basis::factorise(&tracks, 60).unwrap();
        assert!(basis.fitted(&tracks, &(0..60), LEAST_SEEN).iter().all(|(track, _)| **track != lone));
    }

    #[test]
    fn a_shaking_picture_becomes_a_still_one() {
        let by = |k: usize| Vector2::new(4.0, -3.0) * shake(k);
        let pairs = pairs(24, |p, k| p + by(k), |p, k| p - by(k));
        let corrections = Subspace { deviation: 0.24 }.solve(&input(&pairs)).unwrap();
        assert_eq!(corrections.len(), 24);
        let point = Vector2::new(130.0, 90.0);
        let shown: Vec<_> = corrections.iter().enumerate().map(|(k, c)| c.correct(point + by(k))).collect();
        for pair in shown[4..20].windows(2) {
            assert!((pair[1] - pair[0]).norm() < 0.5, "{shown:?}");
        }
    }

    #[test]
    fn without_correspondences_frames_stay() {
        crate::methods::timed::closed_form::assert_survives_ignorance(&Subspace { deviation: 0.5 });
    }
}
