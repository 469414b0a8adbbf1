// SPDX-License-Identifier: MIT OR Apache-2.0

//! GStreamer plugin with the element `rsrectify`, which takes rolling-shutter distortion out of
//! video from unknown cameras.
//!
//! The algorithm is the library `rsrectify`; here is what a pipeline needs around it: negotiation,
//! the queue of held frames and events, properties and messages.

// Whoever builds the pipeline owns the terminal.
#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr))]
#![allow(clippy::non_send_fields_in_send_ty, unused_doc_comments)]

use gst::glib;

pub mod rsrectify;

pub use plugin::plugin_register_static;

fn plugin_init(plugin: &gst::Plugin) -> Result<(), glib::BoolError> {
    rsrectify::register(plugin)
}

mod plugin {
    // The items that the macro makes carry no documentation.
    #![allow(missing_docs)]

    gst::plugin_define!(
        rsrectify,
        env!("CARGO_PKG_DESCRIPTION"),
        plugin_init,
        concat!(env!("CARGO_PKG_VERSION"), "-", env!("COMMIT_ID")),
        // GStreamer knows a fixed list of licences; MIT is on it, `MIT OR Apache-2.0` is not.
        "MIT/X11",
        env!("CARGO_PKG_NAME"),
        env!("CARGO_PKG_NAME"),
        env!("CARGO_PKG_HOMEPAGE"),
        env!("BUILD_REL_DATE")
    );

    use super::plugin_init;
}
