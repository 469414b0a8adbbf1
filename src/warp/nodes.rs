// SPDX-License-Identifier: MIT OR Apache-2.0

//! The nodes of the warp's map along x or y.

/// Equidistant nodes along x or y.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Nodes {
    /// Frame pixel of the first node.
    pub first: f64,
    /// Frame pixels from one node to the next.
    pub spacing: f64,
    /// Number of nodes.
    pub count: usize,
}

impl Nodes {
    /// Nodes from `from` to `to` with a margin of at least one on each side.
    pub fn over(from: f64, to: f64, spacing: f64) -> Self {
        let first = ((from / spacing).floor() - 1.0) * spacing;
        let count = (((to - first) / spacing).ceil() as usize + 2).max(4);
        Self { first, spacing, count }
    }

    /// Frame pixel of a node.
    #[inline(always)]
    pub fn at(&self, index: usize) -> f64 {
        // Signed, as one instruction makes a float of it.
        self.first + index as isize as f64 * self.spacing
    }
}
