//! The report: systems run on sequences, and what people read of it.

pub mod charts;
pub mod document;
pub mod pictures;
pub mod progress;
pub mod quick;
pub mod results;
pub mod runner;
pub mod tables;
