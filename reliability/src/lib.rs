// SPDX-License-Identifier: MIT OR Apache-2.0

//! Attacks on the element: random sequences of everything that can happen to it, and long runs of
//! what is known to break filters. Each attack counts frames. The report is `docs/reliability.md`.

pub mod child;
pub mod fuzz;
pub mod outcome;
pub mod page;
pub mod promises;
pub mod saved;
pub mod soak;
