// SPDX-License-Identifier: MIT OR Apache-2.0

//! The flow that residual velocities are found in.

use crate::flow::FlowField;

/// The flow from a frame to a neighbour in time.
#[derive(Clone, Copy, Debug)]
pub struct FrameFlow<'a> {
    /// Flow field on the cells of the frame.
    pub field: &'a FlowField,
    /// Seconds from the frame's timestamp to the neighbour's; negative for the previous frame.
    pub interval: f64,
}
