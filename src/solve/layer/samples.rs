//! Residual velocities of one frame, sorted by place.

use super::Neighbour;
use super::node::{Scale, Surroundings, kernel};
use crate::correspond::Correspondence;
use crate::readout::Readout;
use crate::solve::median::{MEDIAN_TO_VARIANCE, median};
use nalgebra::Vector2;

/// Samples that a node asks for.
const WANTED: usize = 7;

/// Cells (a mesh spacing wide) around a node within which it looks for them.
const FARTHEST: usize = 5;

/// Displacements over the interval to a neighbour that differ by less, in mesh spacings, may be the same:
/// one analysed pixel.
const SAME_MOTION: f64 = 0.125;

/// Pixels in a readout, at most, that parts of a picture move by beside the whole: more cannot be squared and weighed in
/// `f32`, and is no measurement.
const FASTEST: f64 = 1e6;

/// Readouts to a neighbour, at most, for the same reason.
const FARTHEST_AHEAD: f32 = 1e12;

/// Texture (squared grey levels) of a patch whose place counts half, where it is seen without noise.
const WEAK_TEXTURE: f32 = 4.0;

/// What noise adds to the texture of a patch, as a share of the squared difference of two patches: the central
/// difference of two noisy pixels has half the variance of one, and so have two patches twice that.
const NOISE_IN_TEXTURE: f32 = 0.25;

/// A correspondence whose patches differ by so many times what is usual in the frame counts a quarter.
const UNUSUAL: f32 = 3.0;

/// A residual velocity.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Frame pixels.
    pub(super) at: Vector2<f32>,
    /// Pixels per readout.
    pub(super) velocity: Vector2<f32>,
    /// How far it is to be believed, 0 to 1.
    pub(super) trust: f32,
    /// Readouts from the frame to the neighbour; negative for the frame before.
    pub(super) ahead: f32,
}

/// How far a correspondence is to be believed: less where there is little texture, or as much noise, or where its
/// patches differ more than by noise, whose square in this frame is `usual`.
fn trust(correspondence: &Correspondence, usual: f32) -> f32 {
    let square = correspondence.residual * correspondence.residual;
    let noise = NOISE_IN_TEXTURE * square;
    let texture = (correspondence.texture - noise).max(0.0);
    let unusual = UNUSUAL * UNUSUAL * usual + f32::MIN_POSITIVE;
    texture / (texture + noise + WEAK_TEXTURE) * kernel(square / unusual)
}

/// The samples of a frame in cells around the nodes of the mesh.
#[derive(Debug)]
pub(super) struct Samples {
    columns: usize,
    rows: usize,
    spacing: f64,
    /// Velocities (pixels per readout) that differ by less may be the same.
    tolerance: f32,
    unsorted: Vec<(usize, Sample)>,
    /// Where the samples of each cell start, and one end.
    starts: Vec<usize>,
    /// Samples above and left of each corner of a cell.
    sums: Vec<usize>,
    /// By cell, row by row, so that the cells between two of a row are one slice.
    sorted: Vec<Sample>,
    squares: Vec<f64>,
}

impl Samples {
    pub(super) fn new(columns: usize, rows: usize, spacing: f64) -> Self {
        Self {
            columns,
            rows,
            spacing,
            tolerance: 0.0,
            unsorted: Vec::new(),
            starts: Vec::new(),
            sums: Vec::new(),
            sorted: Vec::new(),
            squares: Vec::new(),
        }
    }

    /// Takes the residual velocities of all neighbours.
    pub(super) fn fill(
        &mut self,
        readout: &Readout,
        neighbours: &[Neighbour<'_>],
        carry: impl Fn(Vector2<f64>, f64, f64) -> Vector2<f64>,
    ) {
        self.unsorted.clear();
        self.tolerance = 0.0;
        for neighbour in neighbours {
            let ahead = (neighbour.interval / readout.time) as f32;
            if !(ahead.abs() < FARTHEST_AHEAD && ahead.abs() > FARTHEST_AHEAD.recip()) {
                continue;
            }
            self.tolerance = self.tolerance.max((SAME_MOTION * self.spacing) as f32 / ahead.abs());
            let usual = self.usual_square(neighbour.correspondences);
            for correspondence in neighbour.correspondences {
                let (here, there) = match neighbour.interval > 0.0 {
                    true => (correspondence.from, correspondence.to),
                    false => (correspondence.to, correspondence.from),
                };
                let from = readout.offset(here.x, here.y);
                let to = neighbour.interval + readout.offset(there.x, there.y);
                let apart = to - from;
                let velocity = (there - carry(here, from, to)) * (readout.time / apart);
                let trust = trust(correspondence, usual);
                let is_sound = velocity.iter().all(|v| v.abs() < FASTEST) && trust.is_finite();
                let Some(cell) = self.cell(here).filter(|_| is_sound) else { continue };
                let sample = Sample { at: here.cast(), velocity: velocity.cast(), trust, ahead };
                self.unsorted.push((cell, sample));
            }
        }
        self.sort();
    }

    /// The median of the squared differences of patches.
    fn usual_square(&mut self, correspondences: &[Correspondence]) -> f32 {
        self.squares.clear();
        self.squares.extend(correspondences.iter().map(|pair| f64::from(pair.residual * pair.residual)));
        median(&mut self.squares) as f32
    }

    /// The cell of a frame pixel; `None` outside the frame.
    fn cell(&self, at: Vector2<f64>) -> Option<usize> {
        let place = (at / self.spacing).map(f64::round);
        let inside = |place: f64, count: usize| place >= 0.0 && place < count as f64;
        let within = inside(place.x, self.columns) && inside(place.y, self.rows);
        within.then(|| place.y as usize * self.columns + place.x as usize)
    }

    /// Counting sort by cell.
    fn sort(&mut self) {
        let cells = self.columns * self.rows;
        self.starts.clear();
        self.starts.resize(cells + 2, 0);
        for (cell, _) in &self.unsorted {
            self.starts[cell + 2] += 1;
        }
        for cell in 2..self.starts.len() {
            self.starts[cell] += self.starts[cell - 1];
        }
        self.sorted.clear();
        self.sorted.extend(self.unsorted.iter().map(|(_, sample)| *sample));
        for (cell, sample) in &self.unsorted {
            let place = &mut self.starts[cell + 1];
            self.sorted[*place] = *sample;
            *place += 1;
        }
        self.starts.pop();
        self.sum_up();
    }

    /// Counts the samples above and left of each corner of a cell.
    fn sum_up(&mut self) {
        let width = self.columns + 1;
        self.sums.clear();
        self.sums.resize(width * (self.rows + 1), 0);
        for row in 0..self.rows {
            let first = row * self.columns;
            for column in 1..width {
                let in_row = self.starts[first + column] - self.starts[first];
                self.sums[(row + 1) * width + column] = self.sums[row * width + column] + in_row;
            }
        }
    }

    /// The variance in squared pixels, from the median, of a coordinate that the neighbours after the frame (or
    /// those before it) see elsewhere than `velocity` says; `None` without samples.
    pub(super) fn variance(
        &mut self,
        later: bool,
        velocity: impl Fn(Vector2<f32>) -> Vector2<f32>,
    ) -> Option<f64> {
        let samples = self.sorted.iter().filter(|sample| (sample.ahead > 0.0) == later);
        let square =
            |sample: &Sample| (sample.velocity - velocity(sample.at)).norm_squared() * sample.ahead.powi(2);
        self.squares.clear();
        self.squares.extend(samples.map(|sample| f64::from(square(sample))));
        (!self.squares.is_empty()).then(|| median(&mut self.squares) * MEDIAN_TO_VARIANCE)
    }

    /// Velocities (pixels per readout) that differ by less may be the same.
    pub(super) fn tolerance(&self) -> f32 {
        self.tolerance
    }

    /// Whether the samples next to a node may all have this velocity.
    pub(super) fn agree(&self, (column, row): (usize, usize), velocity: Vector2<f32>) -> bool {
        let cell = row * self.columns + column;
        let own = &self.sorted[self.starts[cell]..self.starts[cell + 1]];
        own.iter().all(|sample| (sample.velocity - velocity).norm_squared() < self.tolerance * self.tolerance)
    }

    /// Collects the samples in the smallest square of cells around a node that holds enough.
    pub(super) fn around(&self, (column, row): (usize, usize), out: &mut Surroundings) {
        for reach in 1..=FARTHEST {
            let (left, right) = (column.saturating_sub(reach), (column + reach).min(self.columns - 1));
            let (top, bottom) = (row.saturating_sub(reach), (row + reach).min(self.rows - 1));
            let count = self.count([left, right + 1], [top, bottom + 1]);
            if count < WANTED && reach < FARTHEST {
                continue;
            }
            let cells = (right - left + 1) * (bottom - top + 1);
            let scale = Scale {
                apart: (self.spacing * (cells as f64 / count.max(1) as f64).sqrt()) as f32,
                spacing: self.spacing as f32,
                tolerance: self.tolerance,
            };
            let slice = |row: usize| {
                let first = row * self.columns;
                &self.sorted[self.starts[first + left]..self.starts[first + right + 1]]
            };
            out.fill(scale, count, (top..=bottom).map(slice));
            return;
        }
    }

    /// Samples in a rectangle of cells.
    fn count(&self, columns: [usize; 2], rows: [usize; 2]) -> usize {
        let [above, below] =
            rows.map(|row| columns.map(|column| self.sums[row * (self.columns + 1) + column]));
        below[1] + above[0] - below[0] - above[1]
    }
}
