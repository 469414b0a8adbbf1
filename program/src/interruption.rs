// SPDX-License-Identifier: MIT OR Apache-2.0

//! Ctrl-C, and what else asks the program to end.

use anyhow::{Result, anyhow};
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether the user wants the program to end.
#[derive(Clone, Debug, Default)]
pub struct Interruption(Arc<AtomicBool>);

/// The error of work that was given up because of it.
#[derive(Debug)]
pub struct Interrupted;

impl fmt::Display for Interrupted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("interrupted")
    }
}

impl std::error::Error for Interrupted {}

impl Interruption {
    /// Catches SIGINT, SIGTERM and SIGHUP, so that files in the making are removed before the program ends.
    pub fn catch() -> Result<Self> {
        let interruption = Self::default();
        let flag = interruption.0.clone();
        ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed))?;
        Ok(interruption)
    }

    /// Whether it has come.
    pub fn has_come(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// An error if it has come.
    pub fn check(&self) -> Result<()> {
        if self.has_come() { Err(anyhow!(Interrupted)) } else { Ok(()) }
    }
}
