// SPDX-License-Identifier: MIT OR Apache-2.0

//! Feature tracks over many frames, linked from the correspondences between successive frames.
//!
//! Correspondences start at places of their own in each frame, so that no point has two of them in a row. A track is
//! moved on by the displacement that its neighbourhood has: an affine function of the place, fitted to the
//! correspondences around it, those nearer by with more weight. A track ends at the edge of the frame, and where its
//! neighbours do not move alike, as at the edge of something near.

use super::Input;
use super::robust::{Equation, median, tukey};
use crate::correspondences::GRID;
use nalgebra::{Matrix3, SMatrix, Vector2, Vector3};
use rsrectify::correspond::Correspondence;
use std::ops::Range;

/// Standard deviation of the weight of neighbours, in cells of the sampling grid: with less, the fit is hardly
/// determined between two of them; with more, it smooths what a vibration does to the rows.
const NEAR: f64 = 0.6;
/// Fewer neighbours are no neighbourhood.
const LEAST_NEIGHBOURS: usize = 4;
/// Weighted RMS of the residuals in pixels from which neighbours do not move alike.
const DIVIDED: f64 = 0.5;
/// Added to the second moments of the neighbours, in squared cells: the displacement is constant across a line of them.
const RIDGE: f64 = 1e-3;

/// Pixels to the unit of places in which the terms of a quadratic motion are of one size.
const UNIT: f64 = 100.0;
/// Tracks whose RMS residual is this many times the median one are outliers.
const OUTLYING: f64 = 3.0;
/// Fewer tracks do not tell the motion that most of them share from others.
const LEAST_FOLLOWING: usize = 30;

/// The places of a point in successive frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// The first frame that sees it.
    pub first: usize,
    /// Its place in that frame and in those after it, in pixels.
    pub places: Vec<Vector2<f64>>,
}

impl Track {
    /// The frame after the last one that sees it.
    pub fn end(&self) -> usize {
        self.first + self.places.len()
    }

    /// Whether all of these frames see it.
    pub fn spans(&self, frames: &Range<usize>) -> bool {
        self.first <= frames.start && self.end() >= frames.end
    }

    /// Its place in a frame; `None` where that does not see it.
    pub fn at(&self, frame: usize) -> Option<Vector2<f64>> {
        self.places.get(frame.checked_sub(self.first)?).copied()
    }
}

/// All tracks of a run. New ones start at the correspondences of each frame in whose cell no track is.
pub fn link(input: &Input) -> Vec<Track> {
    let size = [input.readout.width(), input.readout.height()];
    let (mut live, mut ended): (Vec<Track>, Vec<Track>) = Default::default();
    for (frame, pairs) in input.pairs.iter().enumerate() {
        let field = Field::new(size, pairs);
        let mut taken = vec![false; GRID[0] * GRID[1]];
        for place in live.iter().filter_map(|track| track.at(frame)) {
            taken[field.cell(place)] = true;
        }
        let free = pairs.iter().filter(|pair| !taken[field.cell(pair.from)]);
        live.extend(free.map(|pair| Track { first: frame, places: vec![pair.from] }));
        for mut track in std::mem::take(&mut live) {
            let next = track.at(frame).and_then(|place| field.carry(place));
            match next {
                Some(next) => {
                    track.places.push(next);
                    live.push(track);
                }
                None => ended.push(track),
            }
        }
    }
    ended.extend(live);
    ended
}

/// The tracks that follow the motion which most of them share, so that moving objects are left out. Between successive frames this
/// motion is a quadratic function of the place, fitted by Tukey's estimate; a track follows it if its RMS residual is at most
/// three times the median one, or a pixel.
pub fn following(tracks: Vec<Track>, frames: usize) -> Vec<Track> {
    let mut squares = vec![(0.0, 0usize); tracks.len()];
    for frame in 1..frames {
        let seen = tracks.iter().enumerate();
        let steps = seen.filter_map(|(index, track)| {
            let [from, to] = [track.at(frame - 1)?, track.at(frame)?];
            let at = from / UNIT;
            let terms = [1.0, at.x, at.y, at.x * at.x, at.x * at.y, at.y * at.y];
            Some((index, Equation::new(terms.into_iter().enumerate(), to - from)))
        });
        let (indices, equations): (Vec<usize>, Vec<Equation>) = steps.unzip();
        let Some(motion) = tukey(&equations, 6).filter(|_| equations.len() >= LEAST_FOLLOWING) else {
            continue;
        };
        for (index, equation) in indices.into_iter().zip(&equations) {
            let moved: Vector2<f64> =
                equation.terms.iter().map(|(term, factor)| motion[*term] * *factor).sum();
            squares[index].0 += (moved - equation.value).norm_squared();
            squares[index].1 += 1;
        }
    }
    let residual = |(sum, count): &(f64, usize)| (sum / (*count).max(1) as f64).sqrt();
    let residuals: Vec<f64> = squares.iter().map(residual).collect();
    let most = most_residual(residuals.clone()).max(1.0);
    tracks
        .into_iter()
        .zip(residuals)
        .filter(|(_, residual)| *residual <= most)
        .map(|(track, _)| track)
        .collect()
}

/// The RMS residual above which a track is an outlier, of those of all tracks.
pub fn most_residual(residuals: Vec<f64>) -> f64 {
    OUTLYING * median(residuals)
}

/// The correspondences between two frames, by the cell in which they start.
struct Field<'a> {
    size: Vector2<f64>,
    cells: Vec<Vec<&'a Correspondence>>,
}

impl<'a> Field<'a> {
    fn new([width, height]: [usize; 2], pairs: &'a [Correspondence]) -> Self {
        let size = Vector2::new(width as f64, height as f64);
        let mut field = Self { size, cells: vec![Vec::new(); GRID[0] * GRID[1]] };
        for pair in pairs {
            let cell = field.cell(pair.from);
            field.cells[cell].push(pair);
        }
        field
    }

    /// Size of a cell in pixels.
    fn pitch(&self) -> Vector2<f64> {
        self.size.component_div(&Vector2::new(GRID[0] as f64, GRID[1] as f64))
    }

    /// Column and row of the cell of a place; those of the nearest one outside the frame.
    fn column_and_row(&self, place: Vector2<f64>) -> [usize; 2] {
        let at = place.add_scalar(0.5).component_div(&self.pitch());
        [0, 1].map(|axis| (at[axis].max(0.0) as usize).min(GRID[axis] - 1))
    }

    fn cell(&self, place: Vector2<f64>) -> usize {
        let [column, row] = self.column_and_row(place);
        row * GRID[0] + column
    }

    /// Where a point goes; `None` where that is outside the frame or not known.
    fn carry(&self, place: Vector2<f64>) -> Option<Vector2<f64>> {
        let [column, row] = self.column_and_row(place);
        let reach = |at: usize, axis: usize| at.saturating_sub(1)..(at + 2).min(GRID[axis]);
        let cells = reach(row, 1).flat_map(|row| reach(column, 0).map(move |column| row * GRID[0] + column));
        let near: Vec<_> = cells.flat_map(|cell| &self.cells[cell]).collect();
        if near.len() < LEAST_NEIGHBOURS {
            return None;
        }
        let pitch = self.pitch();
        let terms = |pair: &Correspondence| {
            let off = (pair.from - place).component_div(&pitch);
            let weight = (-0.5 * off.norm_squared() / (NEAR * NEAR)).exp();
            (Vector3::new(1.0, off.x, off.y), pair.to - pair.from, weight)
        };
        let (mut normal, mut right) = (Matrix3::zeros(), SMatrix::<f64, 3, 2>::zeros());
        for pair in &near {
            let (terms, moved, weight) = terms(pair);
            normal += terms * terms.transpose() * weight;
            right += terms * moved.transpose() * weight;
        }
        let total = normal.m11;
        normal.m22 += RIDGE * total;
        normal.m33 += RIDGE * total;
        let solved = normal.cholesky()?.solve(&right);
        let squares = near.iter().map(|pair| {
            let (terms, moved, weight) = terms(pair);
            weight * (solved.transpose() * terms - moved).norm_squared()
        });
        let next = place + solved.row(0).transpose();
        let inside = |at: f64, length: f64| at >= 0.0 && at <= length - 1.0;
        let seen = inside(next.x, self.size.x) && inside(next.y, self.size.y);
        (seen && squares.sum::<f64>() <= DIVIDED * DIVIDED * total).then_some(next)
    }
}

/// Inputs in which all that is seen moves alike, for the tests of what works on tracks.
#[cfg(test)]
pub(super) mod closed_form {
    use super::*;
    use nalgebra::Matrix2;
    use rsrectify::readout::{Readout, ReadoutDirection, ReadoutTime};

    pub const SIZE: [usize; 2] = [320, 240];

    /// The correspondences of `frames` frames in the first of which a point is at p, and at `flow(p, k)` in frame k;
    /// `inverse` takes a point of frame k back to the first.
    pub fn pairs(
        frames: usize,
        flow: impl Fn(Vector2<f64>, usize) -> Vector2<f64>,
        inverse: impl Fn(Vector2<f64>, usize) -> Vector2<f64>,
    ) -> Vec<Vec<Correspondence>> {
        let [width, height] = SIZE.map(|length| length as f64);
        let pair = |frame: usize, cell: usize| {
            let [column, row] = [cell % GRID[0], cell / GRID[0]].map(|at| at as f64 + 0.5);
            let from =
                Vector2::new(column * width / GRID[0] as f64, row * height / GRID[1] as f64).add_scalar(-0.5);
            let to = flow(inverse(from, frame), frame + 1);
            Correspondence { from, to, texture: 1000.0, residual: 0.0, covariance: Matrix2::zeros() }
        };
        let inside = |at: Vector2<f64>| at.x >= 0.0 && at.y >= 0.0 && at.x < width && at.y < height;
        (1..frames)
            .map(|frame| {
                let all = (0..GRID[0] * GRID[1]).map(|cell| pair(frame - 1, cell));
                all.filter(|pair| inside(pair.to)).collect()
            })
            .collect()
    }

    /// What a method is given of these, at 25 frames a second and with a focal length of 300 px.
    pub fn input(pairs: &[Vec<Correspondence>]) -> Input<'_> {
        let [width, height] = SIZE;
        let time = ReadoutTime::Seconds(0.03);
        let readout = Readout::new(width, height, ReadoutDirection::TopToBottom, time, 0.04).unwrap();
        let stamps = (0..=pairs.len()).map(|k| k as f64 * 0.04).collect();
        Input { readout, focal: 300.0, period: 0.04, stamps, pairs }
    }
}

#[cfg(test)]
mod tests {
    use super::closed_form::{input, pairs};
    use super::*;
    use nalgebra::Matrix2;

    #[test]
    fn a_track_follows_an_affine_motion_exactly_to_the_edge() {
        // The same step each time: a shear and a shift.
        let step = Matrix2::new(1.0, 0.004, -0.002, 1.001);
        let shift = Vector2::new(5.0, -1.0);
        let flow = |p: Vector2<f64>, k: usize| (0..k).fold(p, |p, _| step * p + shift);
        let back = step.try_inverse().unwrap();
        let inverse = |p: Vector2<f64>, k: usize| (0..k).fold(p, |p, _| back * (p - shift));
        let pairs = pairs(20, flow, inverse);
        let tracks = link(&input(&pairs));
        assert!(tracks.iter().any(|track| track.places.len() == 20));
        for track in &tracks {
            let start = inverse(track.places[0], track.first);
            for (index, place) in track.places.iter().enumerate() {
                // The ridge takes a little of the slope where neighbours lie to one side.
                assert!((place - flow(start, track.first + index)).norm() < 0.02, "{track:?}");
            }
            let leaves = flow(start, track.end());
            assert!(track.end() == 20 || leaves.x > 300.0 || leaves.y < 20.0, "{track:?}");
        }
    }

    #[test]
    fn every_cell_with_a_correspondence_has_a_track() {
        let shift = |k: usize| Vector2::new(7.0 * k as f64, 0.0);
        let pairs = pairs(6, |p, k| p + shift(k), |p, k| p - shift(k));
        let tracks = link(&input(&pairs));
        for (frame, pairs) in pairs.iter().enumerate() {
            let field = Field::new([320, 240], pairs);
            let mut seen = vec![false; GRID[0] * GRID[1]];
            tracks.iter().filter_map(|track| track.at(frame)).for_each(|at| seen[field.cell(at)] = true);
            assert!(pairs.iter().all(|pair| seen[field.cell(pair.from)]), "frame {frame}");
        }
    }

    #[test]
    fn a_track_ends_where_its_neighbours_part() {
        // The right half moves otherwise than the left one.
        let moved = |x: f64| if x < 160.0 { 0.0 } else { 4.0 };
        let mut pairs = pairs(2, |p, _| p, |p, _| p);
        pairs[0].iter_mut().for_each(|pair| pair.to.y += moved(pair.from.x));
        for track in link(&input(&pairs)) {
            let from = track.places[0];
            let near = (from.x - 160.0).abs() < 6.0;
            assert_eq!(track.places.len(), if near { 1 } else { 2 }, "{from}");
        }
    }

    #[test]
    fn what_moves_on_its_own_follows_nothing() {
        // A ninth of the picture, in its middle, goes to and fro by 3 px while the rest pans and zooms a little.
        let block = |start: Vector2<f64>| (start - Vector2::new(160.0, 120.0)).amax() < 48.0;
        let apart = |track: &Track| block(track.places[0]);
        let track = |index: usize| {
            let start = Vector2::new((index % 32 * 10) as f64, (index / 32 * 10) as f64);
            let place = |frame: usize| {
                let own = if block(start) && frame % 2 == 1 { 3.0 } else { 0.0 };
                start * (1.0 + 0.002 * frame as f64) + Vector2::new(2.0 * frame as f64, own)
            };
            Track { first: 0, places: (0..12).map(place).collect() }
        };
        let all: Vec<_> = (0..768).map(track).collect();
        let kept = following(all.clone(), 12);
        assert!(kept.iter().all(|track| !apart(track)));
        assert_eq!(kept.len(), all.iter().filter(|track| !apart(track)).count());
    }
}
