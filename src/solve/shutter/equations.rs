//! From the fields of successive pairs to equations that are linear in the readout time.

use super::chart::{self, Chart, ORDERS, SLOPES, Split, Times};
use super::derivative::{self, REACH};
use nalgebra::{SMatrix, Vector2, Vector6};

/// Unknowns: the readout time by columns and by rows, and the slopes of inverse depth.
pub(super) const UNKNOWNS: usize = 2 + SLOPES;

/// The distortion of some pairs and what each unknown contributes to it.
pub(super) type Regressors = SMatrix<f64, 2, UNKNOWNS>;

/// One pair of frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pair {
    /// Pairs that follow each other without a gap have the same.
    pub run: u64,
    /// Seconds from the first frame's timestamp to the second's.
    pub interval: f64,
    /// Its displacement field.
    pub field: Split,
    /// What an interval of 1 and a readout of 1 along each axis add by the rows that points cross.
    pub stretch: [Split; 2],
    /// Mean square of what the bands of columns, and of rows, move beyond the field.
    pub ripple: [f64; 2],
}

/// Two equations: `distortion` = `by` · unknowns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Equation {
    pub distortion: Vector2<f64>,
    pub by: Regressors,
}

/// Weights of neighbouring equations: what changes from frame to frame, where derivatives between
/// frames are poor, is averaged away on both sides alike.
const SMOOTHING: [f64; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];

/// Builds equations; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Builder {
    instants: Vec<f64>,
    path: Vec<Vector6<f64>>,
    slopes: Vec<Option<[Vector6<f64>; ORDERS]>>,
    raw: Vec<Option<Equation>>,
}

impl Builder {
    /// Appends the equations of pairs that follow each other, linearised at `times`, in units of
    /// `period` seconds.
    ///
    /// The readout bends the path that is read off the pairs, too: `bends` holds what it adds to the
    /// motion of each pair, from the round before, and is brought up to date.
    pub fn run(
        &mut self,
        chart: &Chart,
        pairs: &[Pair],
        period: f64,
        times: Times,
        bends: &mut [Vector6<f64>],
        equations: &mut Vec<Equation>,
    ) {
        self.integrate(pairs, period, bends);
        self.differentiate();
        self.raw.clear();
        for (index, (pair, bend)) in pairs.iter().zip(bends).enumerate() {
            let slopes = (self.slopes[index], self.slopes[index + 1]);
            let (Some(before), Some(after)) = slopes else {
                self.raw.push(None);
                continue;
            };
            let changes: [Vector6<f64>; ORDERS] = std::array::from_fn(|order| after[order] - before[order]);
            let mut by = Regressors::zeros();
            *bend = Vector6::zeros();
            for axis in 0..2 {
                let mut added = chart.added(axis, times[axis], &changes);
                added.motion += pair.stretch[axis].motion * (period / pair.interval);
                added.distortion += pair.stretch[axis].distortion * (period / pair.interval);
                *bend += added.motion * times[axis];
                by.set_column(axis, &added.distortion);
            }
            by.fixed_columns_mut::<SLOPES>(2).copy_from(&chart::depth(pair.field.motion.xy()));
            self.raw.push(Some(Equation { distortion: pair.field.distortion, by }));
        }
        equations.extend(self.raw.windows(SMOOTHING.len()).filter_map(smoothed));
    }

    /// The path at each frame: the sum of the motions so far, without what the readout added.
    fn integrate(&mut self, pairs: &[Pair], period: f64, bends: &[Vector6<f64>]) {
        let (mut instant, mut place) = (0.0, Vector6::zeros());
        self.instants.clear();
        self.path.clear();
        self.instants.push(instant);
        self.path.push(place);
        for (pair, bend) in pairs.iter().zip(bends) {
            instant += pair.interval / period;
            place += pair.field.motion - bend;
            self.instants.push(instant);
            self.path.push(place);
        }
    }

    /// The derivatives of the path at each frame that has enough neighbours on both sides.
    fn differentiate(&mut self) {
        self.slopes.clear();
        let count = self.instants.len();
        for middle in 0..count {
            let reach = middle.min(count - 1 - middle).min(REACH);
            if reach < 2 {
                self.slopes.push(None);
                continue;
            }
            let stencil = middle - reach..middle + reach + 1;
            let weights = derivative::weights(&self.instants[stencil.clone()], self.instants[middle]);
            let path = &self.path[stencil];
            let slope = |weights: &[f64]| path.iter().zip(weights).map(|(place, w)| place * *w).sum();
            self.slopes.push(Some(weights.each_ref().map(|weights| slope(weights))));
        }
    }
}

/// The weighted sum of neighbouring equations, if all are there.
fn smoothed(neighbours: &[Option<Equation>]) -> Option<Equation> {
    let mut sum = Equation { distortion: Vector2::zeros(), by: Regressors::zeros() };
    for (equation, weight) in neighbours.iter().zip(SMOOTHING) {
        let Equation { distortion, by } = (*equation)?;
        sum.distortion += distortion * weight;
        sum.by += by * weight;
    }
    Some(sum)
}
