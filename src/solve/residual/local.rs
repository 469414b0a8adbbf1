// SPDX-License-Identifier: MIT OR Apache-2.0

//! The local motions of one frame after another.

use super::frame_flow::FrameFlow;
use super::path::Path;
use super::solver::{Region, ResidualSolver};
use crate::flow::FlowField;
use crate::motion::{ResidualField, ResidualMesh, image_centre, rounded_velocity};
use crate::readout::Readout;
use std::collections::VecDeque;

/// The motion of parts of a frame beside its path.
#[derive(Clone, Debug, Default)]
pub struct LocalMotion {
    /// Residual velocities; `None` without flow.
    pub field: Option<ResidualField>,
    /// Mean velocity and expected error of each region, row by row; none without flow.
    pub regions: Vec<Region>,
}

/// The flow between the waiting frames, and the solver of their residual velocities.
#[derive(Debug, Default)]
pub struct LocalMotions {
    /// Flow from a frame to the next and back: of the frame settled last, and of the waiting ones.
    before: Option<[FlowField; 2]>,
    waiting: VecDeque<[FlowField; 2]>,
    /// Buffers for flow.
    spare: Vec<[FlowField; 2]>,
    solver: ResidualSolver,
}

impl LocalMotions {
    /// Adds the next frame, with the flow from the previous frame to it and back, if there is any.
    pub fn push(&mut self, flow: Option<[&FlowField; 2]>) {
        let last = self.waiting.back_mut().or(self.before.as_mut());
        if let Some((own, flow)) = last.zip(flow) {
            own.iter_mut().zip(flow).for_each(|(own, flow)| own.clone_from(flow));
        }
        let mut fields = self.spare.pop().unwrap_or_default();
        fields.iter_mut().for_each(FlowField::clear);
        self.waiting.push_back(fields);
    }

    /// Solves the first waiting frame, given its path and the seconds to the previous and the next frame; `None`
    /// for a frame that the path does not connect with it.
    pub fn solve(
        &mut self,
        readout: &Readout,
        [before, after]: [Option<f64>; 2],
        path: &impl Path,
    ) -> LocalMotion {
        let backward = self.before.as_ref().zip(before);
        let backward = backward.map(|([_, field], interval)| FrameFlow { field, interval });
        let forward = self.waiting.front().zip(after);
        let forward = forward.map(|([field, _], interval)| FrameFlow { field, interval });
        let flows: Vec<_> = backward.into_iter().chain(forward).collect();
        let cells = self.solver.solve(readout, &flows, path);
        let centre = image_centre(readout.width, readout.height);
        let first = 0.5 * cells.side - 0.5;
        let mesh = ResidualMesh {
            columns: cells.columns,
            rows: cells.rows,
            origin: [first - centre.x, first - centre.y],
            spacing: [cells.side; 2],
        };
        let rounded = |velocity: &[f32; 2]| velocity.map(|value| rounded_velocity(value, cells.side));
        let field = ResidualField::new(mesh, cells.velocities.iter().map(rounded).collect()).ok();
        LocalMotion { field, regions: self.solver.regions().to_vec() }
    }

    /// Advances to the next frame.
    pub fn advance(&mut self) {
        // The flow back from the next frame is still needed.
        let before = std::mem::replace(&mut self.before, self.waiting.pop_front());
        self.spare.extend(before);
    }

    /// Discards all frames.
    pub fn restart(&mut self) {
        self.spare.extend(self.before.take().into_iter().chain(self.waiting.drain(..)));
    }
}
