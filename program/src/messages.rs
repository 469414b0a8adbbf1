// SPDX-License-Identifier: MIT OR Apache-2.0

//! The program's messages: results on the standard output, everything else on the standard error, and all of them in a
//! file, too, where that is asked for.

use crate::progress;
use anyhow::{Context, Result};
use gst::glib;
use log::{Level, LevelFilter, Log, Metadata, Record};
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// The target of results.
pub const RESULT: &str = "rsrectify::result";

static MESSAGES: Messages = Messages {
    file: Mutex::new(None),
    warnings: Mutex::new(Vec::new()),
    is_output_taken: AtomicBool::new(false),
};

struct Messages {
    file: Mutex<Option<File>>,
    /// Warnings since they were last taken.
    warnings: Mutex<Vec<String>>,
    /// Whether the standard output is for data alone.
    is_output_taken: AtomicBool,
}

impl Log for Messages {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        // Libraries are silent.
        metadata.target().starts_with("rsrectify")
    }

    fn log(&self, record: &Record<'_>) {
        if !self.enabled(record.metadata()) {
            return;
        }
        let text = match record.level() {
            Level::Error => format!("error: {}", record.args()),
            Level::Warn => format!("warning: {}", record.args()),
            _ => record.args().to_string(),
        };
        if record.target() == RESULT && !self.is_output_taken.load(Ordering::Relaxed) {
            // Who closes the standard output wants no more of it; the files are written all the same.
            let _ = progress::print(format!("{text}\n").as_bytes());
        } else {
            eprintln!("{text}");
        }
        if record.level() == Level::Warn {
            self.warnings.lock().unwrap_or_else(PoisonError::into_inner).push(record.args().to_string());
        }
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(target) = file.as_mut() else { return };
        if let Err(error) = writeln!(target, "{} {text}", now()) {
            *file = None;
            eprintln!("warning: the log cannot be written any more: {error}");
        }
    }

    fn flush(&self) {}
}

/// The time as people of this place read it.
fn now() -> String {
    let time = glib::DateTime::now_local().and_then(|time| time.format("%Y-%m-%d %H:%M:%S"));
    time.map_or_else(|_| String::new(), |time| time.to_string())
}

/// Has messages printed from now on.
pub fn start() -> Result<()> {
    log::set_logger(&MESSAGES).context("messages go elsewhere already")?;
    log::set_max_level(LevelFilter::Info);
    Ok(())
}

/// Leaves the standard output to data: results go where everything else goes.
pub fn leave_standard_output() {
    MESSAGES.is_output_taken.store(true, Ordering::Relaxed);
}

/// Has messages added to a file as well.
pub fn add_to(path: &Path) -> Result<()> {
    let file = File::options().append(true).create(true).open(path);
    let file = file.with_context(|| format!("cannot write {}", path.display()))?;
    *MESSAGES.file.lock().unwrap_or_else(PoisonError::into_inner) = Some(file);
    Ok(())
}

/// The warnings since this was last called.
pub fn take_warnings() -> Vec<String> {
    std::mem::take(&mut *MESSAGES.warnings.lock().unwrap_or_else(PoisonError::into_inner))
}
