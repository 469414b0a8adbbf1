// SPDX-License-Identifier: MIT OR Apache-2.0

//! Attacks on the element: random sequences of everything that can happen to it, and long runs of
//! what is known to break filters. Each attack counts frames. The report is `docs/reliability.md`.
//!
//! Apart from the tests of the element, because an attack runs for as long as one likes, in processes of its own that may
//! crash or hang; `tests/attack.rs` runs each in a short form.

pub mod child;
pub mod fuzz;
pub mod outcome;
pub mod page;
pub mod promises;
pub mod saved;
pub mod soak;
