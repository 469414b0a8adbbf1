//! How densely the knots of a path lie.

/// How fast the motion may change.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum KnotDensity {
    /// Up to about a cycle a frame period: all that hands do.
    #[default]
    Usual,
    /// Up to about two and a half: engines, rotors, bad roads.
    Vibrating,
}

impl KnotDensity {
    /// Blocks to a frame period.
    pub const fn blocks(self) -> f64 {
        match self {
            Self::Usual => 1.0,
            Self::Vibrating => 2.5,
        }
    }

    /// Frames before the one that is settled whose pairs are looked at again.
    pub const fn past(self) -> usize {
        match self {
            Self::Usual => 4,
            Self::Vibrating => 6,
        }
    }

    /// Variance in px² of the turns' second differences from which learning starts.
    pub const fn start_variance(self) -> f64 {
        match self {
            Self::Usual => 1.0,
            Self::Vibrating => 30.0,
        }
    }

    /// The other one.
    pub const fn other(self) -> Self {
        match self {
            Self::Usual => Self::Vibrating,
            Self::Vibrating => Self::Usual,
        }
    }
}
