//! Small patches against pictures whose motion is written down.

use crate::correspond::{Correspondence, Pyramid, Sampler};
use crate::plane::{Luma, Plane, PlaneLayout, SampleFormat};
use nalgebra::Vector2;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;

/// Waves of many lengths and directions.
fn texture(x: f64, y: f64, kind: f64) -> f64 {
    let wave = |i: f64| {
        let (sin, cos) = (2.4 * i + kind).sin_cos();
        (4.0 + i) * (std::f64::consts::TAU * (cos * x + sin * y) / (9.0 * 1.35f64.powf(i)) + i * kind).sin()
    };
    128.0 + (0..9).map(|i| wave(f64::from(i))).sum::<f64>()
}

/// A block of 120 × 100 pixels before a background that stands still; true inside the block.
fn inside(at: Vector2<f64>, block: Vector2<f64>) -> bool {
    let place = at - block;
    place.x >= 0.0 && place.y >= 0.0 && place.x < 120.0 && place.y < 100.0
}

fn frame(block: Vector2<f64>) -> Vec<u8> {
    let grey = |index: usize| {
        let at = Vector2::new((index % WIDTH) as f64, (index / WIDTH) as f64);
        let place = at - block;
        let grey = if inside(at, block) { texture(place.x, place.y, 1.7) } else { texture(at.x, at.y, 0.3) };
        grey.clamp(0.0, 255.0) as u8
    };
    (0..WIDTH * HEIGHT).map(grey).collect()
}

/// What the grid found, and what the refinement added.
fn found(first: &[u8], second: &[u8]) -> (Vec<Correspondence>, Vec<Correspondence>) {
    let mut sampler = Sampler::new(WIDTH, HEIGHT, 32, 24);
    let pyramid = |data: &[u8]| {
        let layout = PlaneLayout::packed(WIDTH, HEIGHT, SampleFormat::U8);
        let mut pyramid = Pyramid::new();
        sampler.build(&Luma::from(Plane::new(data, layout).unwrap()), &mut pyramid);
        pyramid
    };
    let (first, second) = (pyramid(first), pyramid(second));
    let mut out = Vec::new();
    sampler.correspond(&first, &second, |at| at, &mut out);
    let grid = out.clone();
    sampler.refine(&first, &second, &mut out);
    let added = out.split_off(grid.len());
    (grid, added)
}

#[test]
fn a_block_that_flies_by_is_found_with_its_edges() {
    let (block, shift) = (Vector2::new(230.0, 170.0), Vector2::new(52.0, -21.0));
    let (_, added) = found(&frame(block), &frame(block + shift));
    // Patches that lie on one side of the edge in both frames.
    let corners = [(-4.0, -4.0), (4.0, -4.0), (-4.0, 4.0), (4.0, 4.0)].map(|(x, y)| Vector2::new(x, y));
    let touches = |at, block| corners.iter().filter(|corner| inside(at + *corner, block)).count();
    let truth = |at| match (touches(at, block), touches(at, block + shift)) {
        (4, _) => Some(shift),
        (0, 0) => Some(Vector2::zeros()),
        _ => None,
    };
    let judged: Vec<_> = added.iter().filter_map(|p| Some((p.to - p.from - truth(p.from)?).norm())).collect();
    let wrong = judged.iter().filter(|error| **error > 1.0).count();
    let of_block = added.iter().filter(|point| inside(point.from, block)).count();
    // The block covers 187 tiles; its inner ones follow from the grid's points.
    assert!(of_block > 40, "{of_block} on the block");
    assert!(wrong * 10 < judged.len(), "{wrong} of {} wrong", judged.len());
}

#[test]
fn one_motion_needs_no_refinement() {
    let whole = |shift: f64| -> Vec<u8> {
        let grey = |i: usize| texture((i % WIDTH) as f64 - shift, (i / WIDTH) as f64, 0.3);
        (0..WIDTH * HEIGHT).map(|i| grey(i).clamp(0.0, 255.0) as u8).collect()
    };
    let (grid, added) = found(&whole(0.0), &whole(3.5));
    // A cell has the area of six tiles, and is not alone in missing its point.
    let missing = 32 * 24 - grid.len();
    assert!(missing < 60 && added.len() < 4 * missing, "{missing} {}", added.len());
    let error = |point: &Correspondence| (point.to - point.from - Vector2::new(3.5, 0.0)).norm();
    assert!(added.iter().all(|point| error(point) < 0.5));
}

#[test]
fn a_thing_that_comes_near_is_followed_from_tile_to_tile() {
    let block = Vector2::new(200.0, 150.0);
    let (shift, growth) = (Vector2::new(-30.0, 12.0), 1.14);
    let moved = |at: Vector2<f64>| block + shift + (at - block) * growth;
    let first = frame(block);
    let second: Vec<u8> = (0..WIDTH * HEIGHT)
        .map(|index| {
            let at = Vector2::new((index % WIDTH) as f64, (index / WIDTH) as f64);
            let place = (at - block - shift) / growth;
            let is_block = inside(place, Vector2::zeros());
            let grey = if is_block { texture(place.x, place.y, 1.7) } else { texture(at.x, at.y, 0.3) };
            grey.clamp(0.0, 255.0) as u8
        })
        .collect();
    let (_, added) = found(&first, &second);
    let is_right =
        |point: &&Correspondence| inside(point.from, block) && (point.to - moved(point.from)).norm() < 1.0;
    let right = added.iter().filter(is_right).count();
    // The points of the grid lead to four of its 187 tiles.
    assert!(right > 60, "{right}");
}

#[test]
fn empty_pyramids_add_nothing() {
    let mut out = Vec::new();
    Sampler::new(WIDTH, HEIGHT, 32, 24).refine(&Pyramid::new(), &Pyramid::new(), &mut out);
    assert!(out.is_empty());
}
