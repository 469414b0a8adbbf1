//! The places of nodes along an axis of the frame.

/// Equidistant places along one axis of the frame.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Axis {
    /// Frame pixel of the first.
    pub first: f64,
    /// Frame pixels from one to the next.
    pub spacing: f64,
    /// How many there are.
    pub count: usize,
}

impl Axis {
    /// Places from `from` to `to` with at least one to spare on each side.
    pub fn over(from: f64, to: f64, spacing: f64) -> Self {
        let first = ((from / spacing).floor() - 1.0) * spacing;
        let count = (((to - first) / spacing).ceil() as usize + 2).max(4);
        Self { first, spacing, count }
    }

    /// Frame pixel of a place.
    pub fn at(&self, index: usize) -> f64 {
        self.first + index as f64 * self.spacing
    }
}
