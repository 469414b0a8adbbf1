//! What the user sees while a clip is worked on.

use anyhow::Result;
use indicatif::{ProgressBar, ProgressStyle};

/// A sign of life without a known end.
pub fn spinner() -> Result<ProgressBar> {
    Ok(ProgressBar::no_length().with_style(ProgressStyle::with_template("{spinner} {msg}")?))
}
