// SPDX-License-Identifier: MIT OR Apache-2.0

//! A room with clutter at depths from 1.2 m to 6 m; the camera stands near the origin and looks
//! along +z.

use super::geometry::Surface;
use super::mover::Mover;
use super::path::{Oscillations, two};
use super::procedural::Pattern;
use nalgebra::{Vector2, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// x of the left and right wall, y of ceiling and floor, z of rear and front wall, in metres.
const WALLS: [[f64; 2]; 3] = [[-2.7, 2.7], [-1.6, 1.25], [-2.0, 6.0]];
/// The middle of the foreground at rest.
const FOREGROUND: Vector3<f64> = Vector3::new(0.05, 0.0, 1.45);
pub(super) const LAMP: Vector3<f64> = Vector3::new(0.6, -1.45, 2.2);

/// The room with clutter; without that where it is `bare`.
pub(super) fn furnished(builder: &mut Builder, bare: bool) {
    builder.shell();
    builder.pictures();
    builder.furniture();
    if !bare {
        builder.crates();
        builder.hanging();
    }
}

/// A swing that takes the foreground some ten pixels of 640 from one frame to the next.
fn swing(random: &mut ChaCha8Rng) -> Oscillations {
    let mut own = |amplitude| two(random, amplitude, [(1.0, 0.03), (0.5, 0.05)]);
    let rotation = [0.05, 0.08, 0.08].map(&mut own);
    let position = [0.12, 0.06, 0.03].map(&mut own);
    Oscillations { fps: 30.0, rotation, position, zoom: Vec::new() }
}

/// What puts surfaces into a scene.
pub(super) struct Builder {
    pub(super) surfaces: Vec<Surface>,
    pub(super) random: ChaCha8Rng,
    /// How many textures there are.
    pub(super) textures: usize,
}

/// A box that stands upright.
pub(super) struct Block {
    /// Centre of its base.
    base: Vector3<f64>,
    /// Width, height, depth.
    size: Vector3<f64>,
    /// Turn about the vertical in radians.
    turn: f64,
}

impl Block {
    pub(super) fn new(base: [f64; 3], size: [f64; 3], turn: f64) -> Self {
        Self { base: Vector3::from(base), size: Vector3::from(size), turn }
    }
}

impl Builder {
    pub(super) fn rectangle(
        &mut self,
        corner: [f64; 3],
        u: [f64; 3],
        v: [f64; 3],
        pattern: Pattern,
        metres: f64,
    ) {
        let surface = Surface::new(Vector3::from(corner), Vector3::from(u), Vector3::from(v));
        self.cover(surface, pattern, metres);
    }

    fn cover(&mut self, surface: Surface, pattern: Pattern, metres: f64) {
        let shift = Vector2::new(self.random.random(), self.random.random());
        // Crates and books have edges of their own: they start at the corner.
        let shift = match pattern {
            Pattern::Crate | Pattern::Books => Vector2::zeros(),
            _ => shift,
        };
        self.surfaces.push(surface.covered(pattern as usize % self.textures, metres, shift).lit(LAMP));
    }

    /// Walls, floor and ceiling.
    pub(super) fn shell(&mut self) {
        let [[left, right], [top, floor], [rear, front]] = WALLS;
        let (w, h, d) = (right - left, floor - top, front - rear);
        self.rectangle([left, top, front], [w, 0.0, 0.0], [0.0, h, 0.0], Pattern::Brick, 2.0);
        self.rectangle([left, top, rear], [w, 0.0, 0.0], [0.0, h, 0.0], Pattern::Brick, 2.0);
        self.rectangle([left, top, rear], [0.0, 0.0, d], [0.0, h, 0.0], Pattern::Panels, 2.4);
        self.rectangle([right, top, rear], [0.0, 0.0, d], [0.0, h, 0.0], Pattern::Tiles, 2.4);
        self.rectangle([left, floor, rear], [w, 0.0, 0.0], [0.0, 0.0, d], Pattern::Planks, 1.8);
        self.rectangle([left, top, rear], [w, 0.0, 0.0], [0.0, 0.0, d], Pattern::Panels, 2.0);
    }

    /// Posters a centimetre off the walls.
    pub(super) fn pictures(&mut self) {
        let [[left, right], _, [_, front]] = WALLS;
        for (x, y, w, h) in [(-2.2, -1.1, 0.9, 1.2), (-0.9, -1.3, 1.4, 0.9), (1.0, -1.2, 1.2, 1.3)] {
            let z = front - 0.01;
            self.rectangle([x, y, z], [w, 0.0, 0.0], [0.0, h, 0.0], Pattern::Collage, 1.3);
        }
        for (z, y, w, h) in [(2.0, -1.0, 1.0, 0.8), (4.3, -1.1, 1.2, 1.1)] {
            self.rectangle([left + 0.01, y, z], [0.0, 0.0, w], [0.0, h, 0.0], Pattern::Cloth, 1.1);
            self.rectangle([right - 0.01, y, z], [0.0, 0.0, w], [0.0, h, 0.0], Pattern::Collage, 1.2);
        }
    }

    /// Pillars, book cases, a table.
    fn furniture(&mut self) {
        let [_, [top, floor], _] = WALLS;
        let tall = floor - top;
        self.block(Block::new([-1.25, floor, 3.6], [0.22, tall, 0.22], 0.3), Pattern::Tiles, 0.8);
        self.block(Block::new([1.75, floor, 4.4], [0.3, tall, 0.3], 0.0), Pattern::Brick, 1.2);
        self.block(Block::new([-2.3, floor, 4.7], [0.6, 1.9, 1.3], 0.0), Pattern::Books, 0.95);
        self.block(Block::new([2.35, floor, 2.7], [0.6, 1.6, 1.1], -0.1), Pattern::Books, 0.8);
        let (x, z) = (0.35, 3.1);
        self.block(Block::new([x, 0.62, z], [1.3, 0.06, 0.8], 0.25), Pattern::Planks, 0.9);
        for (dx, dz) in [(-0.55, -0.3), (0.55, -0.3), (-0.55, 0.3), (0.55, 0.3)] {
            let leg = Block::new([x + dx, floor, z + dz - 0.25 * dx], [0.07, 0.63, 0.07], 0.25);
            self.block(leg, Pattern::Planks, 0.5);
        }
        self.block(Block::new([0.1, 0.56, 3.05], [0.34, 0.3, 0.26], 0.6), Pattern::Collage, 0.6);
        self.block(Block::new([0.62, 0.56, 3.1], [0.24, 0.42, 0.2], -0.2), Pattern::Books, 0.42);
    }

    /// Crates and parcels on the floor and on each other, near and far.
    fn crates(&mut self) {
        let [_, [_, floor], _] = WALLS;
        let places = [
            ([-1.7, floor, 2.6], 0.62, Pattern::Crate),
            ([-1.65, floor - 0.62, 2.65], 0.4, Pattern::Cloth),
            ([-0.6, floor, 2.1], 0.36, Pattern::Crate),
            ([1.25, floor, 2.2], 0.5, Pattern::Crate),
            ([1.2, floor - 0.5, 2.2], 0.3, Pattern::Collage),
            ([-0.35, floor, 4.9], 0.8, Pattern::Crate),
            ([-0.3, floor - 0.8, 4.9], 0.5, Pattern::Cloth),
            ([1.0, floor, 5.3], 0.9, Pattern::Crate),
            ([0.9, floor - 0.9, 5.3], 0.45, Pattern::Tiles),
            ([-1.5, floor, 5.4], 0.7, Pattern::Cloth),
        ];
        for (base, side, pattern) in places {
            let turn = self.random.random_range(-0.6..0.6);
            self.block(Block::new(base, [side; 3], turn), pattern, side);
        }
    }

    /// Things that hang from the ceiling: the nearest ones.
    fn hanging(&mut self) {
        let places = [
            ([-0.75, -0.62, 1.7], [0.3, 0.3, 0.3], Pattern::Collage),
            ([0.95, -0.5, 1.9], [0.24, 0.5, 0.24], Pattern::Cloth),
            ([0.15, -0.75, 2.9], [0.5, 0.3, 0.2], Pattern::Books),
            ([-1.7, -0.8, 3.1], [0.35, 0.45, 0.35], Pattern::Crate),
            ([1.5, -0.85, 3.4], [0.4, 0.4, 0.4], Pattern::Collage),
        ];
        for (base, size, pattern) in places {
            let turn = self.random.random_range(-0.8..0.8);
            self.block(Block::new(base, size, turn), pattern, size[0].max(size[1]));
            let top = base[1] - size[1];
            let cord = Block::new([base[0], top, base[2]], [0.025, top - WALLS[1][0], 0.025], turn);
            self.block(cord, Pattern::Cloth, 0.4);
        }
    }

    /// The block that swings: the first mover, in whose axes its sides are given.
    pub(super) fn foreground(&mut self) -> Mover {
        let room = self.surfaces.len();
        self.block(Block::new([0.0, 0.36, 0.0], [0.72, 0.72, 0.16], 0.0), Pattern::Collage, 0.72);
        for side in &mut self.surfaces[room..] {
            *side = side.clone().carried(0).lit(LAMP - FOREGROUND);
        }
        Mover { rest: FOREGROUND, path: swing(&mut self.random) }
    }

    /// The six sides of a block.
    pub(super) fn block(&mut self, block: Block, pattern: Pattern, metres: f64) {
        let (sin, cos) = block.turn.sin_cos();
        let across = Vector3::new(cos, 0.0, sin) * block.size.x;
        let up = Vector3::new(0.0, -block.size.y, 0.0);
        let deep = Vector3::new(-sin, 0.0, cos) * block.size.z;
        let corner = block.base - (across + deep) / 2.0;
        let top = corner + up;
        let sides = [
            (top, across, -up),
            (top + deep, across, -up),
            (top, deep, -up),
            (top + across, deep, -up),
            (top, across, deep),
            (corner, across, deep),
        ];
        for (origin, u, v) in sides {
            self.cover(Surface::new(origin, u, v), pattern, metres);
        }
    }
}
