// SPDX-License-Identifier: MIT OR Apache-2.0

//! What a camera sees: textured geometry, a camera on its path, and the frames it takes.
//!
//! This part knows nothing of the library under test, so that its truth is independent.

pub mod camera;
mod deep;
pub mod geometry;
pub mod kind;
mod line;
pub mod mover;
mod noise;
pub mod path;
pub mod photographs;
pub mod picture;
pub mod procedural;
pub mod render;
mod room;
mod special;
pub mod texture;

pub use camera::{CameraPath, FirstEdge, Lens, Pose, RollingCamera, Shutter};
pub use geometry::{Hit, Scene, Surface};
pub use kind::SceneKind;
pub use mover::Mover;
pub use picture::{Frame, Picture};
pub use render::Renderer;
