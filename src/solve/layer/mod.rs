//! The local residual layer: what parallax and things that move on their own add to the global path.
//!
//! A correspondence of a frame with a neighbour says where the global path is wrong at its point: the
//! point lies at x′ in the neighbour, where the path carries it to x̂. What is left, over the time
//! between the two exposures,
//!
//! > v = (x′ − x̂) / (t′ − t),
//!
//! is the residual velocity there. The layer is these velocities on a regular mesh over the frame.
//! It is applied with the path's own row timing: a point exposed at share s is shown v·(ref − s)
//! further, with v in pixels per whole readout.
//!
//! | step | file |
//! |---|---|
//! | correspondences of both neighbours → residual velocities, sorted by place | `samples` |
//! | residual velocities around a node → the node's velocity | `node` |
//!
//! Depth has edges, and a mean over an edge is wrong on both sides of it: a node takes the velocity that
//! most of its surroundings share (the mode, not the mean), in sharper surroundings the denser the samples
//! lie.

mod node;
mod samples;
#[cfg(test)]
mod tests;

use crate::correspond::Correspondence;
use crate::readout::Readout;
use nalgebra::Vector2;
use node::Surroundings;
use rayon::prelude::*;
use samples::Samples;

/// Analysed pixels from node to node.
const SPACING: f64 = 8.0;

/// The correspondences of a frame with a neighbour in time.
#[derive(Clone, Copy, Debug)]
pub struct Neighbour<'a> {
    /// Points of the frame and of the neighbour: the frame's are `to` where the neighbour is
    /// earlier and `from` where it is later, as the sampler gives them.
    pub correspondences: &'a [Correspondence],
    /// From the frame's timestamp to the neighbour's in seconds: negative for the frame before.
    pub interval: f64,
}

/// Velocities at the nodes of a regular mesh over a frame, bilinear between them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VelocityMesh {
    /// Nodes in a row; node (i, j) lies at frame pixel (i, j)·`spacing`.
    pub columns: usize,
    /// Rows of nodes.
    pub rows: usize,
    /// Frame pixels from node to node; the last ones lie on the frame's last pixel or beyond.
    pub spacing: f64,
    /// One velocity a node, row by row, in pixels per whole readout.
    pub velocities: Vec<Vector2<f32>>,
}

impl VelocityMesh {
    /// The frame pixel of a node by its index.
    fn node(&self, index: usize) -> Vector2<f64> {
        let columns = self.columns.max(1);
        Vector2::new((index % columns) as f64, (index / columns) as f64) * self.spacing
    }
}

/// Solves the residual velocities of one frame after another.
#[derive(Debug)]
pub struct Layer {
    mesh: VelocityMesh,
    samples: Samples,
}

impl Layer {
    /// For frames of `width` × `height` pixels, of which `pixel_scale` make an analysed pixel
    /// ([`Sampler::pixel_scale`](crate::correspond::Sampler::pixel_scale)).
    pub fn new(width: usize, height: usize, pixel_scale: f64) -> Self {
        let spacing = SPACING * pixel_scale;
        let nodes = |length: usize| (length.saturating_sub(1) as f64 / spacing).ceil() as usize + 1;
        let (columns, rows) = (nodes(width), nodes(height));
        let velocities = vec![Vector2::zeros(); columns * rows];
        let mesh = VelocityMesh { columns, rows, spacing, velocities };
        Self { samples: Samples::new(columns, rows, spacing), mesh }
    }

    /// The residual velocities of a frame, given its neighbours in time.
    ///
    /// `carry` is the global path: where it takes a point (frame pixels) from one exposure time to
    /// another (seconds after the frame's timestamp). `readout` is that of the frame and its neighbours, of the
    /// size given to [`new`](Self::new). Nothing to go by leaves zeros.
    pub fn solve(
        &mut self,
        readout: &Readout,
        neighbours: &[Neighbour<'_>],
        carry: impl Fn(Vector2<f64>, f64, f64) -> Vector2<f64>,
    ) -> &VelocityMesh {
        self.samples.fill(readout, neighbours, carry);
        let mut velocities = std::mem::take(&mut self.mesh.velocities);
        let (mesh, samples) = (&self.mesh, &self.samples);
        velocities.par_chunks_mut(mesh.columns.max(1)).enumerate().for_each(|(row, velocities)| {
            let (mut chosen, mut surroundings) = (Vec::new(), Surroundings::default());
            for (column, velocity) in velocities.iter_mut().enumerate() {
                let at = mesh.node(row * mesh.columns + column);
                samples.around(column, row, &mut chosen, &mut surroundings);
                *velocity = surroundings.velocity(readout, at);
            }
        });
        self.mesh.velocities = velocities;
        &self.mesh
    }
}
