// SPDX-License-Identifier: MIT OR Apache-2.0

//! What any thread may read and set.

use super::properties::Settings;
use gst::glib::property::{PropertyGet, PropertySetNested};
use rsrectify::motion::FrameMotion;
use rsrectify::rectifier::FrameSolution;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The settings, which any thread may read and write.
#[derive(Default)]
pub struct Shared(Mutex<Settings>);

impl PropertyGet for Shared {
    type Value = Settings;

    fn get<R, F: Fn(&Settings) -> R>(&self, read: F) -> R {
        read(&lock(&self.0))
    }
}

impl PropertySetNested for Shared {
    type SetNestedValue = Settings;

    fn set_nested<F: FnOnce(&mut Settings)>(&self, write: F) {
        write(&mut lock(&self.0));
    }
}

/// Gives the motion of the frame of this width and height that is shown at a stream time; `None` where it has none.
pub type Source = dyn Fn(Option<gst::ClockTime>, [usize; 2]) -> Option<FrameMotion> + Send + Sync;
/// Is told the motion of the frame that is shown at a stream time.
pub type Observer = dyn Fn(Option<gst::ClockTime>, &FrameSolution) + Send + Sync;

/// What a program that the element is linked into has to do with the motions of its frames.
#[derive(Clone, Default)]
pub struct Hooks {
    /// Where they come from instead of from an analysis.
    pub source: Option<Arc<Source>>,
    /// Who is told them.
    pub observer: Option<Arc<Observer>>,
}

impl fmt::Debug for Hooks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { source, observer } = self;
        write!(f, "source: {}, observer: {}", source.is_some(), observer.is_some())
    }
}

/// Locks a mutex; a panic elsewhere, which is reported there, does not make its data unreadable.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
