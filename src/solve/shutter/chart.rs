//! What a readout adds to the motion between two frames, for frames of one size.

use super::field::{Field, Moved, generators, terms};
use crate::correspond::Correspondence;
use crate::motion::image_centre;
use nalgebra::{Matrix2, Matrix2x6, Matrix6, SMatrix, Vector2, Vector6};

/// Places along each side of the grid on which fields of higher degree are projected.
const GRID: usize = 12;
/// Derivatives of the path whose change over the readout is taken into account.
pub(super) const ORDERS: usize = 3;
/// Slopes of inverse depth: along x and along y.
pub(super) const SLOPES: usize = 2;

/// A field split into what a motion can be and what only the shutter or depth makes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Split {
    pub motion: Vector6<f64>,
    pub distortion: Vector2<f64>,
}

impl From<Field> for Split {
    fn from(field: Field) -> Self {
        Self { motion: field.motion(), distortion: field.distortion() }
    }
}

/// What a readout along one axis does.
#[derive(Clone, Debug)]
struct Axis {
    /// Elapsed share of the readout in a unit of the chart, 0 at the centre.
    share: Vector2<f64>,
    /// For each order n the fields φⱼ·sⁿ/n! of the generators, as columns: their motion.
    motion: [Matrix6<f64>; ORDERS],
    /// Their distortion.
    distortion: [Matrix2x6<f64>; ORDERS],
}

/// Frame geometry: places in halves of the longer side, from the centre.
#[derive(Clone, Debug)]
pub(super) struct Chart {
    centre: Vector2<f64>,
    /// Pixels to the unit.
    pub unit: f64,
    /// Half the frame's width and height.
    half: Vector2<f64>,
    /// Inverse of the normal matrix of the quadratics over the whole frame.
    inverse: Matrix6<f64>,
    /// Columns read one after another, and rows.
    axes: [Axis; 2],
}

impl Chart {
    pub fn new(width: usize, height: usize) -> Self {
        let size = Vector2::new(width.max(1) as f64, height.max(1) as f64);
        let unit = size.max() / 2.0;
        let half = size / (2.0 * unit);
        let none = Axis {
            share: Vector2::zeros(),
            motion: [Matrix6::zeros(); ORDERS],
            distortion: [Matrix2x6::zeros(); ORDERS],
        };
        let mut chart = Self {
            centre: image_centre(width.max(1), height.max(1)),
            unit,
            half,
            inverse: Matrix6::identity(),
            axes: [none.clone(), none],
        };
        let normal: Matrix6<f64> = chart.grid().map(|u| terms(u) * terms(u).transpose()).sum();
        chart.inverse = normal.try_inverse().unwrap_or_else(Matrix6::zeros);
        let shares = [Vector2::new(0.5 / half.x, 0.0), Vector2::new(0.0, 0.5 / half.y)];
        chart.axes = shares.map(|share| chart.axis(share));
        chart
    }

    /// A correspondence in full-frame pixels, on the chart.
    pub fn place(&self, pair: &Correspondence) -> Moved {
        let middle = (pair.from + pair.to) / 2.0;
        Moved { middle: (middle - self.centre) / self.unit, way: (pair.to - pair.from) / self.unit }
    }

    /// Where points move by `field`, the second of their exposures is later (or earlier) by the part of
    /// the readout that they cross. For an interval of 1 and a readout of 1 along `axis` this is what
    /// that adds to the field.
    pub fn stretch(&self, field: &Field, axis: usize) -> Split {
        let share = self.axes[axis].share;
        self.project(|u| field.at(u) * share.dot(&field.at(u))).into()
    }

    /// What a readout time adds by the axis, as the derivatives of the path change from one frame to
    /// the next: `changes[n]` is that of derivative n + 1 of the motion.
    pub fn added(&self, axis: usize, time: f64, changes: &[Vector6<f64>; ORDERS]) -> Split {
        let Axis { motion, distortion, .. } = &self.axes[axis];
        let mut sum = Split { motion: Vector6::zeros(), distortion: Vector2::zeros() };
        let mut power = 1.0;
        for (order, change) in changes.iter().enumerate() {
            sum.motion += motion[order] * change * power;
            sum.distortion += distortion[order] * change * power;
            power *= time;
        }
        sum
    }

    fn axis(&self, share: Vector2<f64>) -> Axis {
        let spread = |order: usize| {
            let degree = order as i32 + 1;
            let factorial: f64 = (1..=degree).map(f64::from).product();
            let fields: [Split; 6] = std::array::from_fn(|j| {
                self.project(|u| generators(u)[j] * (share.dot(&u).powi(degree) / factorial)).into()
            });
            fields
        };
        let spreads: [[Split; 6]; ORDERS] = std::array::from_fn(spread);
        Axis {
            share,
            motion: spreads.map(|fields| Matrix6::from_columns(&fields.map(|field| field.motion))),
            distortion: spreads.map(|fields| Matrix2x6::from_columns(&fields.map(|field| field.distortion))),
        }
    }

    /// The quadratic closest to a field over the whole frame.
    fn project(&self, field: impl Fn(Vector2<f64>) -> Vector2<f64>) -> Field {
        let right: SMatrix<f64, 6, 2> = self.grid().map(|u| terms(u) * field(u).transpose()).sum();
        Field(self.inverse * right)
    }

    /// The middles of a grid of cells that cover the frame.
    fn grid(&self) -> impl Iterator<Item = Vector2<f64>> + use<> {
        let half = self.half;
        let middle = |cell: usize| (2 * cell + 1) as f64 / GRID as f64 - 1.0;
        (0..GRID * GRID)
            .map(move |cell| Vector2::new(middle(cell % GRID), middle(cell / GRID)).component_mul(&half))
    }
}

/// The distortions that unit slopes of inverse depth along x and along y make of a translation (u, v):
/// the fields x·(u, v) and y·(u, v).
pub(super) fn depth(translation: Vector2<f64>) -> Matrix2<f64> {
    let (u, v) = (translation.x, translation.y);
    Matrix2::new(v, u, -u, v)
}

/// The readout along x and along y, in the unit of the intervals.
pub(super) type Times = Vector2<f64>;
