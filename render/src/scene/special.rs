// SPDX-License-Identifier: MIT OR Apache-2.0

//! Scenes of the kind in which motion is hard to measure.

use super::geometry::Surface;
use super::mover::Mover;
use super::path::{Motion, Oscillation, Oscillations};
use super::procedural::Pattern;
use super::room::{Block, Builder, furnished};
use super::texture::Texture;
use nalgebra::{Vector2, Vector3};
use rand::RngExt;

/// What is left of the contrast of a road or of the sky.
const PLAIN: f32 = 0.03;

/// Carries the surfaces added since there were `first` of them.
pub(super) fn carry(builder: &mut Builder, first: usize, mover: usize) {
    for surface in &mut builder.surfaces[first..] {
        *surface = surface.clone().carried(mover);
    }
}

/// Goes with a camera of the same motion and seed at amplitude 1, save for small motions of its own.
pub(super) fn with_camera(motion: Motion, seed: u64, builder: &mut Builder, turn: f64, shift: f64) -> Mover {
    let mut path = Oscillations::new(motion, 1.0, 30.0, seed);
    let mut own = |amplitude: f64| Oscillation {
        amplitude,
        frequency: builder.random.random_range(0.03..0.07),
        phase: builder.random.random(),
    };
    path.rotation.iter_mut().for_each(|axis| axis.push(own(turn)));
    path.position.iter_mut().for_each(|axis| axis.push(own(shift)));
    Mover { rest: Vector3::zeros(), path }
}

/// A face over a third of the picture, before the room.
pub(super) fn face(builder: &mut Builder, seed: u64) -> Mover {
    furnished(builder, false);
    let first = builder.surfaces.len();
    // Face, hair, eyes, mouth and shoulders at half a metre, the camera's axes.
    let parts = [
        ([-0.085, -0.06, 0.50], [0.17, 0.21], Pattern::Panels, 0.25),
        ([-0.1, -0.13, 0.51], [0.2, 0.09], Pattern::Cloth, 0.12),
        ([-0.055, 0.0, 0.495], [0.035, 0.018], Pattern::Collage, 0.05),
        ([0.02, 0.0, 0.495], [0.035, 0.018], Pattern::Collage, 0.05),
        ([-0.03, 0.09, 0.495], [0.06, 0.02], Pattern::Cloth, 0.06),
        ([-0.2, 0.14, 0.52], [0.4, 0.1], Pattern::Cloth, 0.2),
    ];
    for ([x, y, z], [width, height], pattern, metres) in parts {
        builder.rectangle([x, y, z], [width, 0.0, 0.0], [0.0, height, 0.0], pattern, metres);
    }
    carry(builder, first, 0);
    with_camera(Motion::Pan, seed, builder, 0.006, 0.003)
}

/// A thing that fills two fifths of the picture, followed through the room.
pub(super) fn followed(builder: &mut Builder, seed: u64) -> Mover {
    furnished(builder, false);
    let first = builder.surfaces.len();
    builder.block(Block::new([0.02, 0.3, 1.25], [0.8, 0.58, 0.12], 0.1), Pattern::Collage, 0.6);
    carry(builder, first, 0);
    with_camera(Motion::Follow, seed, builder, 0.01, 0.015)
}

/// Letters along the lower edge of the frame.
pub(super) fn caption(builder: &mut Builder, seed: u64) -> Mover {
    furnished(builder, false);
    let first = builder.surfaces.len();
    for letter in 0..22 {
        let x = -0.42 + 0.0385 * f64::from(letter);
        let height = builder.random.random_range(0.03..0.05);
        builder.rectangle(
            [x, 0.31 - height, 1.0],
            [0.026, 0.0, 0.0],
            [0.0, height, 0.0],
            Pattern::Books,
            0.03,
        );
    }
    carry(builder, first, 0);
    with_camera(Motion::Pan, seed, builder, 0.0, 0.0)
}

/// Ten things between the camera and the walls.
pub(super) fn crowd(builder: &mut Builder) -> Vec<Mover> {
    furnished(builder, false);
    let patterns = [Pattern::Collage, Pattern::Cloth, Pattern::Books, Pattern::Crate, Pattern::Tiles];
    (0..10)
        .map(|index| {
            let first = builder.surfaces.len();
            let size = builder.random.random_range(0.16..0.36);
            let pattern = patterns[index % patterns.len()];
            builder.block(Block::new([0.0, size, 0.0], [size, 2.0 * size, 0.1], 0.0), pattern, 0.4);
            carry(builder, first, index);
            let depth = 1.5 + 0.25 * index as f64;
            let across = 0.42 * depth * (f64::from((index * 7 % 10) as u8) / 4.5 - 1.0);
            let rest = Vector3::new(across, builder.random.random_range(-0.2..0.3), depth);
            let mut own = |amplitude: f64| {
                let frequency = builder.random.random_range(0.02..0.06);
                vec![Oscillation { amplitude, frequency, phase: builder.random.random() }]
            };
            let rotation = [0.05, 0.1, 0.1].map(&mut own);
            let position = [0.25, 0.08, 0.1].map(&mut own);
            Mover { rest, path: Oscillations { fps: 30.0, rotation, position, zoom: Vec::new() } }
        })
        .collect()
}

/// The lower third of the picture in tiles, each of which swings on its own as fast as waves do.
pub(super) fn water(builder: &mut Builder) -> Vec<Mover> {
    furnished(builder, false);
    const COLUMNS: usize = 6;
    const ROWS: usize = 4;
    let (width, height) = (0.28, 0.12);
    (0..COLUMNS * ROWS)
        .map(|index| {
            let first = builder.surfaces.len();
            let (u, v) = ([1.15 * width, 0.0, 0.0], [0.0, 1.15 * height, 0.0]);
            builder.rectangle([-0.58 * width, -0.58 * height, 0.0], u, v, Pattern::Cloth, 0.3);
            carry(builder, first, index);
            let x = (index % COLUMNS) as f64 - 0.5 * (COLUMNS as f64 - 1.0);
            let y = (index / COLUMNS) as f64;
            let rest = Vector3::new(x * width, 0.24 + y * height, 1.5 - 0.01 * y);
            let mut own = |amplitude: f64| {
                let frequency = builder.random.random_range(0.1..0.4);
                vec![Oscillation { amplitude, frequency, phase: builder.random.random() }]
            };
            let position = [0.02, 0.015, 0.0].map(&mut own);
            let path = Oscillations { fps: 30.0, rotation: Default::default(), position, zoom: Vec::new() };
            Mover { rest, path }
        })
        .collect()
}

/// Railings, branches and wires before the far wall.
pub(super) fn thin(builder: &mut Builder) {
    builder.shell();
    builder.pictures();
    for bar in 0..13 {
        let x = -0.95 + 0.155 * f64::from(bar);
        builder.block(Block::new([x, 0.75, 1.5], [0.02, 0.75, 0.02], 0.0), Pattern::Crate, 0.3);
    }
    builder.block(Block::new([0.0, 0.03, 1.5], [2.0, 0.03, 0.04], 0.0), Pattern::Cloth, 0.4);
    // Wires, a little slack: short level pieces.
    for (wire, y) in [-0.5, -0.42, -0.2].into_iter().enumerate() {
        let rise = 0.05 * (wire as f64 - 1.0);
        builder.rectangle(
            [-1.2, y, 1.8],
            [2.4, rise, 0.0],
            [-0.008 * rise / 2.4, 0.008, 0.0],
            Pattern::Cloth,
            0.5,
        );
    }
    for _ in 0..14 {
        let (x, y) = (builder.random.random_range(-0.8..0.8), builder.random.random_range(-0.6..-0.05));
        let turn: f64 = builder.random.random_range(-1.2..1.2);
        let length = builder.random.random_range(0.25..0.6);
        let depth = builder.random.random_range(1.7..2.3);
        let (sin, cos) = turn.sin_cos();
        let width = builder.random.random_range(0.008..0.02);
        let (u, v) = ([length * cos, length * sin, 0.0], [-width * sin, width * cos, 0.0]);
        builder.rectangle([x, y, depth], u, v, Pattern::Crate, 0.4);
    }
}

/// Near walls with things along them; road and sky are nearly plain, with the texture that is returned.
pub(super) fn street(builder: &mut Builder, textures: &[Texture]) -> Texture {
    let plain = textures.len();
    let flat = |origin: [f64; 3], u: [f64; 3], v: [f64; 3]| {
        let surface = Surface::new(Vector3::from(origin), Vector3::from(u), Vector3::from(v));
        surface.covered(plain, 6.0, Vector2::zeros())
    };
    builder.surfaces.push(flat([-8.0, 1.3, -5.0], [16.0, 0.0, 0.0], [0.0, 0.0, 205.0]));
    builder.surfaces.push(flat([-300.0, -200.0, 200.0], [600.0, 0.0, 0.0], [0.0, 400.0, 0.0]));
    let patterns = [Pattern::Brick, Pattern::Tiles, Pattern::Collage, Pattern::Panels];
    for side in [-1.0, 1.0] {
        for house in 0..12 {
            let start = -5.0 + 7.0 * f64::from(house);
            let x = side * (2.4 + builder.random.random_range(0.0..0.8));
            let height = builder.random.random_range(1.8..4.5);
            let pattern = patterns[builder.random.random_range(0..patterns.len())];
            builder.rectangle([x, 1.3 - height, start], [0.0, 0.0, 6.8], [0.0, height, 0.0], pattern, 2.2);
            builder.rectangle(
                [x, 1.3 - height, start],
                [side * 3.0, 0.0, 0.0],
                [0.0, height, 0.0],
                pattern,
                2.2,
            );
            let post = Block::new([side * 2.1, 1.3, start + 3.0], [0.1, 2.6, 0.1], 0.0);
            builder.block(post, Pattern::Cloth, 0.5);
            let parcel = Block::new([side * 1.9, 1.3, start + 5.0], [0.5, 0.7, 0.9], 0.2 * side);
            builder.block(parcel, Pattern::Crate, 0.6);
        }
    }
    textures[Pattern::Panels as usize % textures.len()].faded(PLAIN)
}

/// Stripes over a third of the picture, at the distance of the furniture; their texture is returned.
pub(super) fn blinds(builder: &mut Builder) -> Texture {
    furnished(builder, false);
    let stripes = builder.textures;
    let corner = Vector3::new(-0.75, -0.55, 1.9);
    let surface = Surface::new(corner, Vector3::new(0.95, 0.0, 0.0), Vector3::new(0.0, 1.1, 0.0));
    builder.surfaces.push(surface.covered(stripes, 0.4, Vector2::zeros()));
    const SIZE: usize = 256;
    // Eight slats a repetition.
    let grey = |index: usize| {
        let phase = (index / SIZE) as f32 / SIZE as f32 * 8.0 * std::f32::consts::TAU;
        [0.5 + 0.35 * phase.sin().clamp(-0.6, 0.6) / 0.6; 3]
    };
    Texture::new(SIZE, (0..SIZE * SIZE).map(grey).collect())
}
