//! How far each cell is to be trusted.

use super::direction::Direction;
use super::field::{Cell, FlowField};
use super::level::{CELL, Mean};
use super::patch::GRADIENT_NOISE;

/// A point that does not come back to where it started by this many pixels of the level is trusted half: displacements
/// that belong together agree to some tenths, wrong ones are off by pixels.
const RETURN_ERROR: f32 = 0.5;

/// … and by this share of the displacement more, by which a motion may differ within a cell.
const RETURN_SHARE: f32 = 0.02;

/// Variance of the difference of two frames that show the same, squared grey levels.
const NOISE: f32 = 2.0;

/// Makes the field of one direction, of a level of `size` pixels; `side` of a cell in full-frame pixels.
pub(super) fn judge(
    own: &Direction,
    other: &Direction,
    size: (usize, usize),
    side: f64,
    field: &mut FlowField,
) {
    (field.columns, field.rows, field.side) = (own.columns, own.rows, side);
    let pixels = (side / CELL as f64) as f32;
    field.cells.clear();
    field.cells.extend(own.means.iter().enumerate().map(|(index, mean)| {
        let (column, row) = (index % own.columns.max(1), index / own.columns.max(1));
        let middle = |index: usize| (index as f32 + 0.5) * CELL as f32 - 0.5;
        let to = [middle(column) + mean.shift[0], middle(row) + mean.shift[1]];
        let is_inside = |at: f32, length: usize| at > -0.5 && at < length as f32 - 0.5;
        let is_seen = is_inside(to[0], size.0) && is_inside(to[1], size.1);
        let confidence = if is_seen {
            consistency(mean.shift, other.at(to[0], to[1])) * explained(mean) * texture(mean)
        } else {
            0.0
        };
        Cell {
            flow: mean.shift.map(|shift| shift * pixels),
            confidence,
            tensor: mean.tensor,
            residual: mean.residual,
        }
    }));
}

fn consistency(shift: [f32; 2], back: [f32; 2]) -> f32 {
    let length = |x: f32, y: f32| (x * x + y * y).sqrt();
    let error = length(shift[0] + back[0], shift[1] + back[1]);
    let usual = RETURN_ERROR + RETURN_SHARE * length(shift[0], shift[1]);
    let ratio = error / usual;
    1.0 / (1.0 + ratio * ratio * ratio * ratio)
}

/// The share of the patch's contrast that the displacement explains.
fn explained(mean: &Mean) -> f32 {
    let contrast = mean.energy + NOISE;
    contrast / (contrast + mean.residual)
}

/// Whether there is anything to be seen: the larger eigenvalue of the tensor against the noise of gradients.
fn texture(mean: &Mean) -> f32 {
    let [xx, xy, yy] = mean.tensor;
    let half = 0.5 * (xx - yy);
    let larger = 0.5 * (xx + yy) + (half * half + xy * xy).sqrt();
    larger / (larger + GRADIENT_NOISE)
}
