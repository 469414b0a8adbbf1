//! The report: systems run on sequences, and what people read of it.

pub mod progress;
pub mod results;
pub mod runner;
