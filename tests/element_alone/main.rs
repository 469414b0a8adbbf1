// SPDX-License-Identifier: MIT OR Apache-2.0

//! Tests of the element that no busy test may run beside: those that follow a clock, and those that look at the whole process.

#[path = "../common/mod.rs"]
mod common;
mod live;
mod process;
