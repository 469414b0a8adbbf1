// SPDX-License-Identifier: MIT OR Apache-2.0

//! Integers in few bytes: predicted, and coded with probabilities that are learnt from those before.

use super::arithmetic::{Coder, Decoder, Encoder, Probability};
use crate::motion::precision::ELEMENTS;

/// How often differences are taken of the samples of a path. Their noise from rounding grows with the order, to 8 steps for four;
/// the path itself is smooth over four of 32 samples.
const ORDER: usize = 4;
/// Of a number of the mesh, the most steps from 1 that are counted one by one.
const COUNTED: usize = 20;
/// Classes of numbers: by their bits.
const CLASSES: usize = 64;
/// Upper limits of the activities of the first classes of them.
const ACTIVITIES: [u64; 12] = [0, 1, 2, 3, 4, 6, 8, 12, 17, 25, 40, 70];
const ACTIVITY_CLASSES: usize = ACTIVITIES.len() + 1;
/// Classes of the fraction that the prediction has beyond its integer.
const FRACTIONS: usize = 8;
/// A prediction is in units of 1/32.
const UNIT: i64 = 32;

/// The integers of a record.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Integers {
    /// Of each element in turn, its samples.
    pub(super) path: Vec<i64>,
    /// Velocities in x and in y, row by row.
    pub(super) mesh: [Vec<i64>; 2],
}

impl Integers {
    /// As many, all zero.
    fn zeros(samples: usize, nodes: usize) -> Self {
        Self { path: vec![0; samples * ELEMENTS], mesh: [vec![0; nodes], vec![0; nodes]] }
    }

    /// Codes all of them; they are replaced by those that were read.
    fn code(&mut self, coder: &mut impl Coder, columns: usize) {
        let samples = self.path.len() / ELEMENTS;
        code_path(coder, &mut self.path, samples.max(1));
        let mut model = MeshModel::new();
        for axis in &mut self.mesh {
            model.code(coder, axis, columns.max(1));
        }
    }

    /// The bytes of the integers; the mesh has so many columns.
    pub(super) fn pack(mut self, columns: usize) -> Vec<u8> {
        let mut encoder = Encoder::new();
        self.code(&mut encoder, columns);
        encoder.finish()
    }

    /// The integers of a path of so many samples, and of a mesh. Bytes that nobody has written become some integers.
    pub(super) fn unpack(bytes: &[u8], samples: usize, [columns, rows]: [usize; 2]) -> Self {
        let mut integers = Self::zeros(samples, columns.saturating_mul(rows));
        integers.code(&mut Decoder::new(bytes), columns);
        integers
    }
}

/// A number of at least 1: how many bits it has, with a probability for each, and these but the first.
fn code_magnitude(coder: &mut impl Coder, classes: &mut [Probability; CLASSES], value: u64) -> u64 {
    let wanted = value.checked_ilog2().unwrap_or(0);
    let mut bits = 0;
    for (class, probability) in (0..CLASSES as u32 - 1).zip(classes.iter_mut()) {
        if !coder.bit(probability, class < wanted) {
            break;
        }
        bits = class + 1;
    }
    (0..bits).rev().fold(1, |read, bit| {
        read << 1 | u64::from(coder.bit(&mut Probability::EVEN.clone(), value >> bit & 1 == 1))
    })
}

fn signed(magnitude: u64, is_negative: bool) -> i64 {
    if is_negative { (magnitude as i64).wrapping_neg() } else { magnitude as i64 }
}

/// Probabilities of the numbers of a path in one context.
#[derive(Clone, Copy)]
struct PathModel {
    zero: Probability,
    negative: Probability,
    classes: [Probability; CLASSES],
}

/// Contexts of a path's numbers: each of the first ones, and the others by the class of those before.
const PATH_CONTEXTS: usize = ORDER + 8;

/// Fourth differences of each element, each in the context of its place or of the two before.
fn code_path(coder: &mut impl Coder, path: &mut [i64], samples: usize) {
    let none = PathModel {
        zero: Probability::EVEN,
        negative: Probability::EVEN,
        classes: [Probability::EVEN; CLASSES],
    };
    let mut models = [none; PATH_CONTEXTS];
    for values in path.chunks_mut(samples) {
        difference(values);
        let mut before = [0u64; 2];
        for (index, value) in values.iter_mut().enumerate() {
            let activity = before[0].saturating_add(before[1]);
            let context = if index < ORDER { index } else { ORDER + activity_class(activity).min(7) };
            if let Some(model) = models.get_mut(context) {
                *value = model.code(coder, *value);
            }
            before = [before[1], value.unsigned_abs()];
        }
        sum(values);
    }
}

impl PathModel {
    fn code(&mut self, coder: &mut impl Coder, value: i64) -> i64 {
        if coder.bit(&mut self.zero, value == 0) {
            return 0;
        }
        let is_negative = coder.bit(&mut self.negative, value < 0);
        signed(code_magnitude(coder, &mut self.classes, value.unsigned_abs()), is_negative)
    }
}

/// Replaces values by their fourth differences.
fn difference(values: &mut [i64]) {
    for _ in 0..ORDER {
        let mut before = 0;
        for value in values.iter_mut() {
            (*value, before) = (value.wrapping_sub(before), *value);
        }
    }
}

/// Undoes [`difference`].
fn sum(values: &mut [i64]) {
    for _ in 0..ORDER {
        let mut before = 0i64;
        for value in values.iter_mut() {
            before = before.wrapping_add(*value);
            *value = before;
        }
    }
}

fn activity_class(activity: u64) -> usize {
    ACTIVITIES.iter().position(|limit| activity <= *limit).unwrap_or(ACTIVITIES.len())
}

/// Probabilities of the numbers of a mesh: of errors of prediction, by how much the velocities around them and the errors beside
/// them vary, and by the fraction of the prediction.
struct MeshModel {
    zero: [[Probability; FRACTIONS]; ACTIVITY_CLASSES],
    negative: [[Probability; FRACTIONS]; ACTIVITY_CLASSES],
    steps: [[Probability; COUNTED]; ACTIVITY_CLASSES],
    beyond: [Probability; CLASSES],
}

/// What is expected of a node.
struct Expected {
    /// In 1/[`UNIT`].
    prediction: i64,
    activity: u64,
}

impl MeshModel {
    const fn new() -> Self {
        const EVEN: Probability = Probability::EVEN;
        Self {
            zero: [[EVEN; FRACTIONS]; ACTIVITY_CLASSES],
            negative: [[EVEN; FRACTIONS]; ACTIVITY_CLASSES],
            steps: [[EVEN; COUNTED]; ACTIVITY_CLASSES],
            beyond: [EVEN; CLASSES],
        }
    }

    fn code(&mut self, coder: &mut impl Coder, values: &mut [i64], columns: usize) {
        // Of the nodes of the row above and of this row so far.
        let mut errors = vec![0u64; columns];
        for index in 0..values.len() {
            let column = index % columns;
            let Expected { prediction, activity } = expected(values, columns, index);
            let left = column.checked_sub(1).and_then(|left| errors.get(left)).copied().unwrap_or(0);
            let above = errors.get(column).copied().unwrap_or(0);
            let class = activity_class(activity.saturating_add(left).saturating_add(above));
            let whole = prediction.wrapping_add(UNIT / 2).div_euclid(UNIT);
            let fraction =
                prediction.wrapping_add(UNIT / 2).rem_euclid(UNIT) as usize * FRACTIONS / UNIT as usize;
            let Some(value) = values.get_mut(index) else { return };
            let error = self.error(coder, class, fraction, value.wrapping_sub(whole));
            *value = whole.wrapping_add(error);
            if let Some(place) = errors.get_mut(column) {
                *place = error.unsigned_abs();
            }
        }
    }

    /// An error of prediction.
    fn error(&mut self, coder: &mut impl Coder, class: usize, fraction: usize, value: i64) -> i64 {
        // Both are in range.
        let (class, fraction) = (class.min(ACTIVITY_CLASSES - 1), fraction.min(FRACTIONS - 1));
        if coder.bit(&mut self.zero[class][fraction], value == 0) {
            return 0;
        }
        let is_negative = coder.bit(&mut self.negative[class][fraction], value < 0);
        let wanted = value.unsigned_abs().saturating_sub(1);
        for (count, probability) in (0..).zip(self.steps[class].iter_mut()) {
            if coder.bit(probability, wanted == count) {
                return signed(count + 1, is_negative);
            }
        }
        let counted = COUNTED as u64;
        let beyond = code_magnitude(coder, &mut self.beyond, (wanted + 1).saturating_sub(counted));
        signed(beyond.saturating_add(counted), is_negative)
    }
}

/// What is expected of a node by those before it: to the left (W), above (N), and their neighbours.
fn expected(values: &[i64], columns: usize, index: usize) -> Expected {
    let (row, column) = (index / columns, index % columns);
    let at = |back: usize| index.checked_sub(back).and_then(|index| values.get(index)).copied().unwrap_or(0);
    let [w, n, nw, ne, ww, nn] = match (row, column) {
        (0, 0) => [0; 6],
        (0, _) => {
            let w = at(1);
            [w, w, w, w, if column > 1 { at(2) } else { w }, w]
        }
        (_, 0) => {
            let n = at(columns);
            let (ne, nn) =
                (if columns > 1 { at(columns - 1) } else { n }, if row > 1 { at(2 * columns) } else { n });
            [n, n, n, ne, n, nn]
        }
        _ => {
            let (w, n) = (at(1), at(columns));
            let ne = if column + 1 < columns { at(columns - 1) } else { n };
            let ww = if column > 1 { at(2) } else { w };
            [w, n, at(columns + 1), ne, ww, if row > 1 { at(2 * columns) } else { n }]
        }
    };
    // Found by least squares over real clips.
    let terms = [(w, 21i64), (n, 20), (nw, -12), (ne, 1), (ww, 1), (nn, 1)];
    let prediction =
        terms.iter().fold(0i64, |sum, (value, weight)| sum.wrapping_add(value.wrapping_mul(*weight)));
    let steps = [w.wrapping_sub(nw), n.wrapping_sub(nw), n.wrapping_sub(ne)];
    let activity = steps.iter().fold(0u64, |sum, step| sum.saturating_add(step.unsigned_abs()));
    Expected { prediction, activity }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn integers_come_back(
            path in prop::collection::vec(any::<i64>(), 0..9),
            x in prop::collection::vec(prop_oneof![any::<i64>(), -40..40_i64], 0..200),
            columns in 1..20usize,
        ) {
            let rows = x.len() / columns;
            let x = x[..rows * columns].to_vec();
            let y: Vec<_> = x.iter().map(|value| value / 7).collect();
            let integers = Integers { path: path.repeat(ELEMENTS), mesh: [x, y] };
            let bytes = integers.clone().pack(columns);
            prop_assert_eq!(Integers::unpack(&bytes, path.len(), [columns, rows]), integers);
        }

        #[test]
        fn any_bytes_are_some_integers(bytes in prop::collection::vec(any::<u8>(), 0..80), samples in 0..40usize) {
            let integers = Integers::unpack(&bytes, samples, [5, 7]);
            prop_assert_eq!(integers.path.len(), samples * ELEMENTS);
        }
    }

    #[test]
    fn smooth_integers_take_few_bytes() {
        // A cubic has constant third differences, so the fourth are 0 but at the beginning.
        let mut cubic: Vec<i64> = (0..9).map(|i| i * i * i - 7 * i).collect();
        difference(&mut cubic);
        assert!(cubic[4..].iter().all(|value| *value == 0), "{cubic:?}");
        let plane: Vec<i64> = (0..6400).map(|node| node % 80 / 3 + node / 80 / 5).collect();
        let integers = Integers { path: Vec::new(), mesh: [plane.clone(), plane] };
        let length = integers.pack(80).len();
        assert!(length < 2000, "{length} bytes");
    }

    #[test]
    fn the_prediction_is_that_of_the_documentation() {
        // 3 columns; of the last node w = 12, n = 16, nw = 11, ne = n and nn = n beyond the edges, ww = 10.
        let values = [10, 11, 16, 10, 12, 0];
        let Expected { prediction, activity } = expected(&values, 3, 5);
        assert_eq!(prediction, 21 * 12 + 20 * 16 - 12 * 11 + 16 + 10 + 16);
        assert_eq!(activity, 1 + 5);
        assert_eq!(expected(&values, 3, 0).prediction, 0);
        assert_eq!(expected(&values, 3, 1).prediction, 32 * 10);
    }
}
