//! The element `rsrectify`.

use gst::glib;
use gst::prelude::*;

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
mod state;
mod timer;

pub use enums::{BorderMode, Estimator, Interpolation, Model, ReadoutDirection};
pub use imp::object::RsRectify;

/// Registers the element with `plugin`. It is never plugged in on its own: its rank is none.
pub fn register(plugin: &gst::Plugin) -> Result<(), glib::BoolError> {
    report::register_meta();
    #[cfg(feature = "doc")]
    enums::document();
    gst::Element::register(Some(plugin), "rsrectify", gst::Rank::NONE, RsRectify::static_type())
}
