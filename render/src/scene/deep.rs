// SPDX-License-Identifier: MIT OR Apache-2.0

//! Scenes whose depth, or turn, varies down the picture.

use super::geometry::Surface;
use super::mover::Mover;
use super::path::{Motion, Oscillations, two};
use super::procedural::Pattern;
use super::room::Builder;
use super::special::{carry, with_camera};
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Half the width and height of a wall without an end.
const FAR: f64 = 40.0;

/// A wall that faces the camera, across the whole picture, from `top` (slope of the ray to it) down.
fn wall(builder: &mut Builder, top: f64, depth: f64, pattern: Pattern) {
    let corner = [-FAR, top * depth, depth];
    builder.rectangle(corner, [2.0 * FAR, 0.0, 0.0], [0.0, FAR, 0.0], pattern, 0.45 * depth);
}

/// Five walls one before the other.
pub(super) fn layers(builder: &mut Builder) {
    wall(builder, -FAR, 10.0, Pattern::Brick);
    let patterns = [Pattern::Collage, Pattern::Tiles, Pattern::Cloth, Pattern::Brick];
    for ((top, depth), pattern) in
        [(-0.24, 7.0), (-0.08, 4.5), (0.08, 3.0), (0.22, 2.0)].into_iter().zip(patterns)
    {
        wall(builder, top, depth, pattern);
    }
}

/// The layers seen through a window whose frame goes with the camera.
pub(super) fn window(builder: &mut Builder, seed: u64) -> Mover {
    layers(builder);
    let first = builder.surfaces.len();
    let bars = [
        ([-0.55, -0.42], [1.1, 0.12]),
        ([-0.55, 0.3], [1.1, 0.12]),
        ([-0.55, -0.42], [0.13, 0.84]),
        ([0.42, -0.42], [0.13, 0.84]),
        ([-0.03, -0.42], [0.05, 0.84]),
    ];
    for ([x, y], [width, height]) in bars {
        builder.rectangle([x, y, 1.0], [width, 0.0, 0.0], [0.0, height, 0.0], Pattern::Panels, 0.3);
    }
    carry(builder, first, 0);
    with_camera(Motion::Scroll { lowest: 0.02, highest: 0.3 }, seed, builder, 0.0, 0.0)
}

/// A plain and a sky.
pub(super) fn ground(builder: &mut Builder) {
    builder.rectangle([-200.0, 1.0, -20.0], [400.0, 0.0, 0.0], [0.0, 0.0, 320.0], Pattern::Tiles, 2.0);
    builder.rectangle(
        [-600.0, -300.0, 290.0],
        [1200.0, 0.0, 0.0],
        [0.0, 600.0, 0.0],
        Pattern::Collage,
        120.0,
    );
}

/// A cylinder that lies across the picture, before a wall.
pub(super) fn roller(builder: &mut Builder) -> Mover {
    wall(builder, -FAR, 6.0, Pattern::Panels);
    const SIDES: usize = 48;
    const RADIUS: f64 = 1.3;
    let first = builder.surfaces.len();
    let at = |side: usize| {
        let (sin, cos) = (side as f64 / SIDES as f64 * TAU).sin_cos();
        Vector3::new(-2.2, RADIUS * sin, RADIUS * cos)
    };
    for side in 0..SIDES {
        let face = Surface::new(at(side), Vector3::new(4.4, 0.0, 0.0), at(side + 1) - at(side));
        // The pattern goes on from side to side.
        let along = RADIUS * TAU * side as f64 / SIDES as f64 / 0.8;
        let texture = Pattern::Collage as usize % builder.textures;
        builder.surfaces.push(face.covered(texture, 0.8, [0.0, along as f32].into()));
    }
    carry(builder, first, 0);
    let mut own = |amplitude| two(&mut builder.random, amplitude, [(1.0, 0.03), (0.4, 0.11)]);
    // Rolls about its axis, and a little about the upright, which leans it.
    let rotation = [own(0.3), own(0.04), Vec::new()];
    let path = Oscillations { fps: 30.0, rotation, position: Default::default(), zoom: Vec::new() };
    Mover { rest: Vector3::new(0.0, 0.0, 3.2), path }
}
