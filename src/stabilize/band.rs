// SPDX-License-Identifier: MIT OR Apache-2.0

//! Symmetric equations with two diagonals beside the main one: plans, with a number for each pair of frames.

use super::logarithm::Coordinates;

/// A row of the lower half, and the right side.
#[derive(Clone, Copy, Debug, Default)]
pub struct Row {
    /// Element with the row two before, one before, and of the diagonal.
    pub elements: [f64; 3],
    pub right: Coordinates,
    /// Seconds that the row's frame stands for.
    pub interval: f64,
    /// Of a row that is done: factors beside the diagonal, and the diagonal.
    factors: [f64; 3],
}

/// Solves by the Cholesky factor L·D·Lᵀ inside the band. The elements stay; the right sides become those by L⁻¹.
pub fn solve(rows: &mut [Row], found: &mut Vec<Coordinates>) {
    for index in 0..rows.len() {
        let (done, rest) = rows.split_at_mut(index);
        let Some(row) = rest.first_mut() else { break };
        let one = done.last().copied().unwrap_or_default();
        let two = index.checked_sub(2).and_then(|two| done.get(two)).copied().unwrap_or_default();
        let [far, near, diagonal] = row.elements;
        let near = near - far * one.factors[1];
        let factor = |element: f64, diagonal: f64| if diagonal > 0.0 { element / diagonal } else { 0.0 };
        let (to_two, to_one) = (factor(far, two.factors[2]), factor(near, one.factors[2]));
        row.right -= two.right * to_two + one.right * to_one;
        row.factors = [to_two, to_one, diagonal - to_two * far - to_one * near];
    }
    found.resize(rows.len(), Coordinates::zeros());
    for index in (0..rows.len()).rev() {
        let Some(row) = rows.get(index) else { continue };
        let mut value = if row.factors[2] > 0.0 { row.right / row.factors[2] } else { row.right };
        for (beyond, element) in [(1, 1), (2, 0)] {
            if let (Some(row), Some(after)) = (rows.get(index + beyond), found.get(index + beyond)) {
                value -= after * row.factors[element];
            }
        }
        if let Some(slot) = found.get_mut(index) {
            *slot = value;
        }
    }
}
