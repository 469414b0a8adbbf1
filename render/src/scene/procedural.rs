// SPDX-License-Identifier: MIT OR Apache-2.0

//! Procedural textures of a room, with detail at every scale down to the texel.

use super::noise::{Noise, mix};
use super::texture::{Colour, Texture};
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};

/// What a surface is covered with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pattern {
    /// Courses of bricks with mortar.
    Brick,
    /// Floorboards with grain.
    Planks,
    /// Painted panels with stains.
    Panels,
    /// Two-coloured tiles with joints.
    Tiles,
    /// Shelves of book spines.
    Books,
    /// A collage of discs and bars.
    Collage,
    /// Crate wood with battens.
    Crate,
    /// Coarse striped cloth.
    Cloth,
}

impl Pattern {
    /// All patterns, in the order in which [`bake_all`] returns them.
    pub const ALL: [Self; 8] = [
        Self::Brick,
        Self::Planks,
        Self::Panels,
        Self::Tiles,
        Self::Books,
        Self::Collage,
        Self::Crate,
        Self::Cloth,
    ];

    /// Texels along a side: a texture that covers walls is finer than one for small things.
    const fn size(self) -> usize {
        match self {
            Self::Brick | Self::Planks | Self::Panels | Self::Tiles => 1024,
            Self::Books | Self::Collage | Self::Crate | Self::Cloth => 512,
        }
    }

    fn colour(self, noise: Noise, shapes: &[Shape], u: f32, v: f32, texel: f32) -> Colour {
        match self {
            Self::Brick => brick(noise, u, v, texel),
            Self::Planks => planks(noise, u, v, texel),
            Self::Panels => panels(noise, u, v, texel),
            Self::Tiles => tiles(noise, u, v, texel),
            Self::Books => books(noise, u, v, texel),
            Self::Collage => collage(noise, shapes, u, v, texel),
            Self::Crate => crate_wood(noise, u, v, texel),
            Self::Cloth => cloth(noise, u, v),
        }
    }

    /// The texture of this pattern for a seed.
    pub fn bake(self, seed: u64) -> Texture {
        let size = self.size();
        let texel = 1.0 / size as f32;
        let noise = Noise::new(seed).fork(self as u32);
        let (coarse, fine) = (noise.fork(100), noise.fork(101));
        let shapes: Vec<Shape> = (1..48).map(|number| Shape::new(noise, number)).collect();
        let octaves = size.ilog2();
        let pixel = |index: usize| {
            let (u, v) = ((index % size) as f32 + 0.5, (index / size) as f32 + 0.5);
            let (u, v) = (u * texel, v * texel);
            // Gain 0.8 an octave: amplitude falls slowly, so that every distance shows contrast.
            let detail = fine.fractal(u, v, 3..octaves, 0.8);
            let tint = coarse.fractal(u, v, 1..4, 0.7);
            let gain = (1.0 + 0.34 * detail + 0.25 * tint).clamp(0.15, 1.9);
            self.colour(noise, &shapes, u, v, texel).map(|channel| (channel * gain).clamp(0.0, 1.0))
        };
        Texture::new(size, (0..size * size).into_par_iter().map(pixel).collect())
    }
}

/// The textures of all patterns for a seed, in the order of [`Pattern::ALL`]. Those of the last seed are kept, as most scenes of a
/// run have the same seed, and to make them takes seconds.
pub fn bake_all(seed: u64) -> Vec<Texture> {
    static LAST: Mutex<Option<(u64, Vec<Texture>)>> = Mutex::new(None);
    // Held meanwhile, so that whoever else needs them does not make them too.
    let mut last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
    let known = last.take().filter(|(other, _)| *other == seed);
    let textures = known.map(|(_, textures)| textures);
    let textures =
        textures.unwrap_or_else(|| Pattern::ALL.iter().map(|pattern| pattern.bake(seed)).collect());
    *last = Some((seed, textures.clone()));
    textures
}

fn blend(a: Colour, b: Colour, share: f32) -> Colour {
    [mix(a[0], b[0], share), mix(a[1], b[1], share), mix(a[2], b[2], share)]
}

/// 1 where `distance` > 0, with a ramp two texels wide so that the edge is band-limited.
fn inside(distance: f32, texel: f32) -> f32 {
    let t = (distance / (2.0 * texel) + 0.5).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Distance to the nearest edge of cell `[0, 1)` at `x`, in units of `1 / cells`.
fn edge(x: f32, cells: f32) -> f32 {
    let t = x.rem_euclid(1.0);
    t.min(1.0 - t) / cells
}

/// A saturated colour from a number in 0..1.
fn hue(number: f32, saturation: f32, value: f32) -> Colour {
    [0.0, 1.0 / 3.0, 2.0 / 3.0].map(|phase| {
        let wave = 0.5 + 0.5 * (std::f32::consts::TAU * (number + phase)).cos();
        value * (1.0 - saturation * (1.0 - wave))
    })
}

fn brick(noise: Noise, u: f32, v: f32, texel: f32) -> Colour {
    let (columns, rows) = (8.0, 24.0);
    let row = (v * rows).floor();
    let x = u * columns + 0.5 * (row as i32 % 2) as f32;
    let column = (x.floor() as i32).rem_euclid(columns as i32);
    let stone = noise.cell(column, row as i32);
    let shade = blend([0.62, 0.27, 0.2], [0.85, 0.55, 0.38], stone);
    let joint = edge(x, columns).min(edge(v * rows, rows)) - 0.004;
    blend([0.78, 0.76, 0.7], shade, inside(joint, texel))
}

fn planks(noise: Noise, u: f32, v: f32, texel: f32) -> Colour {
    let boards = 8.0;
    let board = (u * boards).floor() as i32;
    let start = noise.cell(board, 3);
    let plank = ((v + start) * 2.0).floor() as i32 % 2;
    let grain = noise.fork(board as u32).gradient(u * 128.0, v * 8.0, [128, 8])
        + 0.6 * noise.gradient(u * 256.0, v * 16.0, [256, 16]);
    let tone = noise.cell(board, 10 + plank);
    let wood =
        blend([0.42, 0.25, 0.13], [0.82, 0.6, 0.36], (0.5 * tone + 0.25 + 0.3 * grain).clamp(0.0, 1.0));
    let gap = edge(u * boards, boards).min(edge((v + start) * 2.0, 2.0)) - 0.0025;
    blend([0.12, 0.08, 0.05], wood, inside(gap, texel))
}

fn panels(noise: Noise, u: f32, v: f32, texel: f32) -> Colour {
    let cells = 4.0;
    let panel = noise.cell((u * cells) as i32, (v * cells) as i32);
    let stain = noise.fractal(u, v, 2..7, 0.75);
    let paint = blend([0.55, 0.68, 0.66], [0.9, 0.86, 0.72], (panel + 0.4 * stain).clamp(0.0, 1.0));
    let frame = edge(u * cells, cells).min(edge(v * cells, cells));
    let moulding = inside(0.028 - frame, texel) * inside(frame - 0.02, texel);
    let joint = inside(frame - 0.003, texel);
    blend([0.25, 0.24, 0.22], blend(paint, [0.42, 0.44, 0.4], moulding), joint)
}

fn tiles(noise: Noise, u: f32, v: f32, texel: f32) -> Colour {
    let cells = 8.0;
    let (column, row) = ((u * cells) as i32, (v * cells) as i32);
    let veins = (noise.fractal(u, v, 3..8, 0.6) * 9.0).sin();
    let light = [[0.88, 0.86, 0.8], [0.3, 0.42, 0.46]][((column + row) % 2) as usize];
    let tone = 0.8 + 0.2 * noise.cell(column, row) + 0.12 * veins;
    let joint = edge(u * cells, cells).min(edge(v * cells, cells)) - 0.003;
    blend([0.35, 0.33, 0.3], light.map(|c| c * tone), inside(joint, texel))
}

fn books(noise: Noise, u: f32, v: f32, texel: f32) -> Colour {
    let (shelves, spines) = (4.0, 22.0);
    let shelf = (v * shelves).floor() as i32;
    let y = (v * shelves).rem_euclid(1.0);
    let shift = noise.cell(shelf, 77);
    let x = (u + shift) * spines;
    let book = (x.floor() as i32).rem_euclid(spines as i32);
    let own = noise.fork(shelf as u32);
    let top = 0.12 + 0.25 * own.cell(book, 1);
    let cover = hue(own.cell(book, 2), 0.75, 0.35 + 0.6 * own.cell(book, 3));
    let band = 0.45 + 0.35 * own.cell(book, 4);
    let title = inside(0.03 - (y - band).abs() / shelves, texel);
    // Rows of lettering: blocks that are on or off.
    let letters = own.cell((x * 4.0).floor() as i32, 1000 + (y * 60.0).floor() as i32).round();
    let cover = blend(cover, [0.95 * letters, 0.9 * letters, 0.7 * letters], title);
    let spine = inside(edge(x, spines) - 0.002, texel) * inside((y - top) / shelves, texel);
    let board = inside((y - 0.93) / shelves, texel);
    blend(blend([0.07, 0.06, 0.06], cover, spine), [0.55, 0.37, 0.2], board)
}

/// A disc or a bar of the collage.
struct Shape {
    is_disc: bool,
    centre: [f32; 2],
    radius: f32,
    /// Sine and cosine of its angle.
    turn: (f32, f32),
    paint: Colour,
}

impl Shape {
    fn new(noise: Noise, number: u32) -> Self {
        let own = noise.fork(number);
        Self {
            is_disc: number.is_multiple_of(2),
            centre: [own.cell(1, 0), own.cell(2, 0)],
            radius: 0.03 + 0.14 * own.cell(3, 0) * own.cell(3, 1),
            turn: (std::f32::consts::TAU * own.cell(4, 0)).sin_cos(),
            paint: hue(own.cell(5, 0), 0.85, 0.25 + 0.75 * own.cell(6, 0)),
        }
    }
}

fn collage(noise: Noise, shapes: &[Shape], u: f32, v: f32, texel: f32) -> Colour {
    let mut colour = hue(noise.cell(0, 0), 0.18, 0.92);
    for Shape { is_disc, centre, radius, turn: (sin, cos), paint } in shapes {
        let wrap = |t: f32| t - t.round();
        let (x, y) = (wrap(u - centre[0]), wrap(v - centre[1]));
        let distance = if *is_disc {
            radius - x.hypot(y)
        } else {
            let (along, across) = ((cos * x + sin * y).abs(), (cos * y - sin * x).abs());
            (2.0 * radius - along).min(0.35 * radius - across)
        };
        colour = blend(colour, *paint, inside(distance, texel));
    }
    colour
}

fn crate_wood(noise: Noise, u: f32, v: f32, texel: f32) -> Colour {
    let boards = 6.0;
    let board = noise.cell(9, (v * boards) as i32);
    let grain = noise.gradient(u * 8.0, v * 64.0, [8, 64]);
    let wood = blend([0.5, 0.36, 0.2], [0.86, 0.7, 0.46], (board + 0.35 * grain).clamp(0.0, 1.0));
    let gaps = blend([0.15, 0.1, 0.06], wood, inside(edge(v * boards, boards) - 0.004, texel));
    let frame = u.min(1.0 - u).min(v).min(1.0 - v);
    let diagonal = 0.06 - (u - v).abs() * std::f32::consts::FRAC_1_SQRT_2;
    let batten = (0.1 - frame).max(diagonal);
    let across = noise.gradient(u * 64.0, v * 64.0, [64, 64]);
    let batten_wood = blend([0.56, 0.38, 0.2], [0.72, 0.52, 0.3], 0.5 + 0.5 * across);
    let rim = inside(0.008 - batten.abs(), texel);
    blend(blend(gaps, batten_wood, inside(batten, texel)), [0.16, 0.1, 0.06], rim)
}

fn cloth(noise: Noise, u: f32, v: f32) -> Colour {
    let thread = 0.5 + 0.25 * ((u * 402.0).sin() + (v * 402.0).sin());
    let stripe = noise.cell((u * 16.0) as i32, 5);
    let weft = noise.cell(6, (v * 16.0) as i32);
    let a = hue(stripe, 0.8, 0.85);
    let b = hue(0.5 * weft + 0.25, 0.7, 0.75);
    blend(a, b, 0.35 + 0.3 * weft).map(|channel| channel * (0.7 + 0.4 * thread))
}
