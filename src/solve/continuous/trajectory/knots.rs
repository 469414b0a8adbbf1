// SPDX-License-Identifier: MIT OR Apache-2.0

//! The knot density of a path.

/// The bandwidth of a path. Its clock counts *blocks*, a fixed number to a frame period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum KnotDensity {
    /// Up to about one cycle a frame period: hand shake.
    #[default]
    Usual,
    /// Up to about two and a half: engines, rotors, bad roads.
    Vibrating,
}

impl KnotDensity {
    /// Blocks to a frame period.
    #[inline(always)]
    pub const fn blocks(self) -> f64 {
        match self {
            Self::Usual => 1.0,
            Self::Vibrating => 2.5,
        }
    }

    /// Pairs of a window before the frame that is settled.
    pub const fn past(self) -> usize {
        match self {
            Self::Usual => 4,
            Self::Vibrating => 6,
        }
    }

    /// Initial variance in px² of the turns' second differences.
    pub const fn start_variance(self) -> f64 {
        match self {
            Self::Usual => 1.0,
            Self::Vibrating => 30.0,
        }
    }

    pub const fn other(self) -> Self {
        match self {
            Self::Usual => Self::Vibrating,
            Self::Vibrating => Self::Usual,
        }
    }
}
