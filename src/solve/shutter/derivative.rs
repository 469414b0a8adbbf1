//! Derivatives of a path that is known at some instants.

use super::chart::ORDERS;

/// Instants on each side that a derivative is taken from, at most.
pub(super) const REACH: usize = 4;
/// Instants of the widest stencil.
const WIDEST: usize = 2 * REACH + 1;

/// The weights of the values at `times` that give each derivative, from the first up, of the
/// polynomial through them at `at`: B. Fornberg, *Generation of finite difference formulas on
/// arbitrarily spaced grids*, Mathematics of Computation 51, 1988.
///
/// Takes at most nine instants, which must be distinct.
pub(super) fn weights(times: &[f64], at: f64) -> [[f64; WIDEST]; ORDERS] {
    // weights[n][i]: order n (0 is the value) of instant i, over the instants so far.
    let mut weights = [[0.0; WIDEST]; ORDERS + 1];
    weights[0][0] = 1.0;
    let mut product = 1.0;
    for (new, &time) in times.iter().enumerate().take(WIDEST).skip(1) {
        let before = times[new - 1] - at;
        let mut span = 1.0;
        for old in 0..new {
            let distance = time - times[old];
            span *= distance;
            if old + 1 == new {
                for order in (0..=ORDERS).rev() {
                    let lower = if order > 0 { order as f64 * weights[order - 1][old] } else { 0.0 };
                    weights[order][new] = product / span * (lower - before * weights[order][old]);
                }
            }
            for order in (0..=ORDERS).rev() {
                let lower = if order > 0 { order as f64 * weights[order - 1][old] } else { 0.0 };
                weights[order][old] = ((time - at) * weights[order][old] - lower) / distance;
            }
        }
        product = span;
    }
    std::array::from_fn(|order| weights[order + 1])
}
