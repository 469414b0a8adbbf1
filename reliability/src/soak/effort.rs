// SPDX-License-Identifier: MIT OR Apache-2.0

//! How much an attack tries.

/// How long an attack takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// Seconds: what each change must pass.
    Short,
    /// As long as it takes.
    Long,
}

impl Effort {
    /// One of two values.
    pub(super) fn pick<T>(self, short: T, long: T) -> T {
        match self {
            Effort::Short => short,
            Effort::Long => long,
        }
    }
}
