// SPDX-License-Identifier: MIT OR Apache-2.0

//! The library under test, and all systems that the report compares with it.

pub mod product;
pub mod registry;
