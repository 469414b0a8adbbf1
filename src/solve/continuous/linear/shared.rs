// SPDX-License-Identifier: MIT OR Apache-2.0

//! The unknowns that all pairs of a window share.

/// Number of shared unknowns.
pub const SHARED: usize = 2;

/// A value for each shared unknown: γ, the signed readout time in frame periods, and κ = (R/f)², R half the
/// frame's width and f the focal length.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shared<T> {
    pub gamma: T,
    pub kappa: T,
}

impl<T> Shared<T> {
    pub fn map<U>(self, mut f: impl FnMut(T) -> U) -> Shared<U> {
        Shared { gamma: f(self.gamma), kappa: f(self.kappa) }
    }

    pub fn zip<U>(self, other: Shared<U>) -> Shared<(T, U)> {
        Shared { gamma: (self.gamma, other.gamma), kappa: (self.kappa, other.kappa) }
    }

    pub fn as_ref(&self) -> Shared<&T> {
        Shared { gamma: &self.gamma, kappa: &self.kappa }
    }

    pub fn as_mut(&mut self) -> Shared<&mut T> {
        Shared { gamma: &mut self.gamma, kappa: &mut self.kappa }
    }

    /// γ first, as in the rows of matrices.
    pub fn into_array(self) -> [T; SHARED] {
        [self.gamma, self.kappa]
    }
}

impl<T> From<[T; SHARED]> for Shared<T> {
    fn from([gamma, kappa]: [T; SHARED]) -> Self {
        Self { gamma, kappa }
    }
}
