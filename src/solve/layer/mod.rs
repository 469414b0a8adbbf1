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
//!
//! That takes some thousand operations a node, and away from edges neighbours say the same: every second
//! node of every second row is solved first, and those between only where their neighbours, or the samples
//! next to them, disagree.

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

/// Velocities that differ by less than this share of what may be the same are interpolated.
const ALIKE: f32 = 0.1;

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
    /// Velocities at every second node of every second row.
    coarse: Vec<Vector2<f32>>,
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
        let coarse = vec![Vector2::zeros(); (columns / 2 + 1) * (rows / 2 + 1)];
        Self { samples: Samples::new(columns, rows, spacing), mesh, coarse }
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
        let (columns, rows) = (self.mesh.columns, self.mesh.rows);
        let mut velocities = std::mem::take(&mut self.mesh.velocities);
        let (mesh, samples) = (&self.mesh, &self.samples);
        let solve = |column: usize, row: usize, surroundings: &mut Surroundings| {
            samples.around(column, row, surroundings);
            surroundings.velocity(readout, mesh.node(row * columns + column))
        };
        let width = columns / 2 + 1;
        self.coarse.par_chunks_mut(width).enumerate().for_each(|(row, velocities)| {
            let mut surroundings = Surroundings::default();
            let row = (2 * row).min(rows.saturating_sub(1));
            for (column, velocity) in velocities.iter_mut().enumerate() {
                *velocity = solve((2 * column).min(columns.saturating_sub(1)), row, &mut surroundings);
            }
        });
        let coarse = &self.coarse;
        velocities.par_chunks_mut(columns.max(1)).enumerate().for_each(|(row, velocities)| {
            let mut surroundings = Surroundings::default();
            let [above, below] = beside(row, rows);
            for (column, velocity) in velocities.iter_mut().enumerate() {
                let [left, right] = beside(column, columns);
                let corners = [(left, above), (right, above), (left, below), (right, below)];
                let corners = corners.map(|(column, row)| coarse[row * width + column]);
                let mean = corners.iter().sum::<Vector2<f32>>() / 4.0;
                let alike = ALIKE * samples.tolerance();
                let is_plain = corners.iter().all(|corner| (corner - mean).norm_squared() <= alike * alike)
                    && samples.agree(column, row, mean);
                let is_solved = left == right && above == below;
                *velocity = if is_plain || is_solved { mean } else { solve(column, row, &mut surroundings) };
            }
        });
        self.mesh.velocities = velocities;
        &self.mesh
    }
}

/// The nodes of the coarse mesh, in which every second of `count` is and the last, on both sides of a node.
fn beside(node: usize, count: usize) -> [usize; 2] {
    let is_coarse = node.is_multiple_of(2) || node + 1 == count;
    [if is_coarse { node.div_ceil(2) } else { node / 2 }, node.div_ceil(2)]
}
