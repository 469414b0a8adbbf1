// SPDX-License-Identifier: MIT OR Apache-2.0

//! The element `rsrectify`.

use gst::glib;
use gst::prelude::*;
use gst::subclass::prelude::ObjectSubclassIsExt;
use rsrectify::motion::FrameMotion;
use rsrectify::rectifier::FrameSolution;
use std::sync::Arc;

mod allocation;
mod enums;
mod ffi;
mod flow;
mod formats;
mod imp;
mod interval;
mod latency;
mod load;
mod padding;
mod picture;
mod properties;
mod queue;
mod report;
mod shared;
mod state;
mod timer;

pub use enums::{BorderMode, Effort, Estimator, Interpolation, Model, ReadoutDirection};
pub use imp::object::RsRectify;

impl RsRectify {
    /// Has frames rectified by motions from elsewhere, without analysis and lookahead: `source` gives that of the frame
    /// that is shown at a stream time, for frames of this width and height, or `None` for one that goes out as it came. For
    /// programs that the element is linked into, before it is started.
    pub fn set_motion_source(
        &self,
        source: impl Fn(Option<gst::ClockTime>, [usize; 2]) -> Option<FrameMotion> + Send + Sync + 'static,
    ) {
        shared::lock(&self.imp().hooks).source = Some(Arc::new(source));
    }

    /// Has `observer` told the motion of each frame that was analysed, and its stream time, when the frame goes out. For
    /// programs that the element is linked into, before it is started.
    pub fn observe_motions(
        &self,
        observer: impl Fn(Option<gst::ClockTime>, &FrameSolution) + Send + Sync + 'static,
    ) {
        shared::lock(&self.imp().hooks).observer = Some(Arc::new(observer));
    }
}

/// Registers the element with `plugin`. It is never plugged in on its own: its rank is none.
pub fn register(plugin: &gst::Plugin) -> Result<(), glib::BoolError> {
    report::register_meta();
    #[cfg(feature = "doc")]
    enums::document();
    gst::Element::register(Some(plugin), "rsrectify", gst::Rank::NONE, RsRectify::static_type())
}
