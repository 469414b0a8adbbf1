// SPDX-License-Identifier: MIT OR Apache-2.0

//! What becomes of a clip's streams.

mod beside;
mod destination;
mod early;
mod excerpt;
pub mod label;
mod linker;
mod markup;
mod programs;
mod remux;
mod routes;
pub mod timecode;
mod unheld;

pub use beside::collect;
pub use destination::{Destination, Video};
pub use excerpt::Excerpt;
pub use remux::Remux;
pub use routes::Audio;
