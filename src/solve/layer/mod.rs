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
//! That takes some thousand operations a node, and away from edges neighbours say the same: every fourth
//! node of every fourth row is solved first, and those halfway between only where their neighbours, or the
//! samples next to them, disagree; then those halfway between these. Of the 8349 nodes of a 1080p frame some
//! two thousand are solved in a scene full of edges.

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

/// Times that the mesh that is solved first is halved.
const HALVINGS: usize = 2;

/// Velocities that differ by less than this share of what may be the same are interpolated.
const ALIKE: f32 = 0.4;

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
    /// The velocity at a frame pixel, which lies on the mesh.
    fn velocity(&self, at: Vector2<f32>) -> Vector2<f32> {
        let place = at / self.spacing as f32;
        let (left, top) = (place.x as usize, place.y as usize);
        let (right, below) = ((left + 1).min(self.columns - 1), (top + 1).min(self.rows - 1));
        let (x, y) = (place.x - left as f32, place.y - top as f32);
        let node = |column: usize, row: usize| self.velocities[row * self.columns + column];
        let mean = |row: usize| node(left, row) * (1.0 - x) + node(right, row) * x;
        mean(top) * (1.0 - y) + mean(below) * y
    }
}

/// Solves the residual velocities of one frame after another.
#[derive(Debug)]
pub struct Layer {
    mesh: VelocityMesh,
    samples: Samples,
    /// The same mesh with every second node of the next one, the coarsest first.
    coarser: [VelocityMesh; HALVINGS],
}

impl Layer {
    /// For frames of `width` × `height` pixels, of which `pixel_scale` make an analysed pixel
    /// ([`Sampler::pixel_scale`](crate::correspond::Sampler::pixel_scale)).
    pub fn new(width: usize, height: usize, pixel_scale: f64) -> Self {
        let spacing = SPACING * pixel_scale;
        let coarsest = spacing * (1 << HALVINGS) as f64;
        let cells = |length: usize| (length.saturating_sub(1) as f64 / coarsest).ceil() as usize;
        let (across, down) = (cells(width), cells(height));
        let mesh = |halvings: usize| {
            let (columns, rows) = ((across << halvings) + 1, (down << halvings) + 1);
            let velocities = vec![Vector2::zeros(); columns * rows];
            VelocityMesh { columns, rows, spacing: coarsest / (1 << halvings) as f64, velocities }
        };
        let finest = mesh(HALVINGS);
        let samples = Samples::new(finest.columns, finest.rows, spacing);
        Self { mesh: finest, samples, coarser: std::array::from_fn(mesh) }
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
        let samples = &self.samples;
        let mut step = 1 << HALVINGS;
        let mut coarser: Option<&VelocityMesh> = None;
        for mesh in self.coarser.iter_mut().chain([&mut self.mesh]) {
            solve_mesh(mesh, coarser, &Nodes { readout, samples, step });
            coarser = Some(mesh);
            step /= 2;
        }
        &self.mesh
    }

    /// What path and layer together leave of the frame that was solved last: the standard deviation of a
    /// coordinate in pixels, of the neighbour that fits worse, where most of its points are. Infinite where nothing
    /// is known.
    pub fn left(&mut self) -> f64 {
        let mesh = &self.mesh;
        let left = [false, true].map(|later| self.samples.variance(later, |at| mesh.velocity(at)));
        left.into_iter().flatten().reduce(f64::max).map_or(f64::INFINITY, f64::sqrt)
    }
}

/// What the nodes of a mesh are solved from.
struct Nodes<'a> {
    readout: &'a Readout,
    samples: &'a Samples,
    /// Cells of the samples from node to node.
    step: usize,
}

/// Solves the nodes of a mesh that the mesh of twice its spacing does not tell.
fn solve_mesh(mesh: &mut VelocityMesh, coarser: Option<&VelocityMesh>, nodes: &Nodes<'_>) {
    let &mut VelocityMesh { columns, spacing, .. } = mesh;
    let &Nodes { readout, samples, step } = nodes;
    let rows = mesh.velocities.par_chunks_mut(columns).enumerate();
    rows.for_each_init(Surroundings::default, |surroundings, (row, velocities)| {
        for (column, velocity) in velocities.iter_mut().enumerate() {
            let cell = (column * step, row * step);
            let told = coarser.and_then(|coarser| told(coarser, (column, row), samples, cell));
            *velocity = told.unwrap_or_else(|| {
                samples.around(cell, surroundings);
                surroundings.velocity(readout, Vector2::new(column as f64, row as f64) * spacing)
            });
        }
    });
}

/// The velocity of a node as a mesh of twice the spacing has it; `None` where the nodes beside it there, or
/// the samples around it, disagree.
fn told(
    coarser: &VelocityMesh,
    (column, row): (usize, usize),
    samples: &Samples,
    cell: (usize, usize),
) -> Option<Vector2<f32>> {
    let at = |column: usize, row: usize| coarser.velocities[row * coarser.columns + column];
    let (left, right) = (column / 2, column.div_ceil(2));
    let (above, below) = (row / 2, row.div_ceil(2));
    if left == right && above == below {
        return Some(at(left, above));
    }
    let corners = [at(left, above), at(right, above), at(left, below), at(right, below)];
    let mean = corners.iter().sum::<Vector2<f32>>() / 4.0;
    let alike = ALIKE * samples.tolerance();
    let are_alike = corners.iter().all(|corner| (corner - mean).norm_squared() <= alike * alike);
    (are_alike && samples.agree(cell, mean)).then_some(mean)
}
