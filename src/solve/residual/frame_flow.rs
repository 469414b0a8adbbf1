//! The flow that residual velocities are found in.

use crate::flow::FlowField;

/// The flow from a frame to a neighbour in time.
#[derive(Clone, Copy, Debug)]
pub struct FrameFlow<'a> {
    /// On the cells of the frame.
    pub field: &'a FlowField,
    /// From the frame's timestamp to the neighbour's in seconds: negative for the frame before.
    pub interval: f64,
}
