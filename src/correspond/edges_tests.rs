//! Places next to depth edges of pictures whose motion is written down.

use super::*;
use crate::cpu::CpuLevel;

const WIDTH: usize = 160;
const HEIGHT: usize = 120;

/// A bar of 24 pixels, bright and rough, before a background that stands still.
fn frame(bar: f32) -> Level {
    let grey = |index: usize| {
        let (x, y) = ((index % WIDTH) as f32, (index / WIDTH) as f32);
        match x - bar {
            0.0..24.0 => 190.0 + 25.0 * ((x - bar) / 1.9).sin() * (y / 2.3).cos(),
            _ => {
                let waves = 20.0 * (x / 2.2 + 0.4 * y).sin() + 15.0 * (y / 2.7 - 0.3 * x).cos();
                90.0 + waves + 12.0 * (x / 5.3 + y / 3.9).sin() + 12.0 * (x / 3.7 - y / 6.1).cos()
            }
        }
    };
    Level { width: WIDTH, height: HEIGHT, data: (0..WIDTH * HEIGHT).map(grey).collect() }
}

/// What is chosen among motions that were found 12 pixels apart, `of` their places.
fn chosen(first: Level, second: Level, of: impl Fn(Vector2<f32>) -> Vector2<f32>) -> Vec<Correspondence> {
    let (first, second) = ([first], [second]);
    let pair = Pair { cpu: CpuLevel::Scalar, first: &first, second: &second };
    let places = (0..13 * 10).map(|i| Vector2::new((i % 13) as f32, (i / 13) as f32) * 12.0);
    let motions: Vec<Motion> = places.map(|at| Motion { at, shift: of(at) }).collect();
    let mut edges = Edges::default();
    edges.run(&pair, motions.iter().copied(), Scale { noise: 1.0, gain: 1.0 });
    edges.found(1.0).collect()
}

#[test]
fn places_beside_a_bar_choose_their_own_side() {
    let shift = 9.0;
    // As patches across the edges have it: the bar's motion reaches 10 pixels beyond it.
    let fattened =
        |at: Vector2<f32>| Vector2::new(if (50.0..94.0).contains(&at.x) { shift } else { 0.0 }, 0.0);
    let chosen = chosen(frame(60.0), frame(60.0 + shift), fattened);
    assert!(chosen.len() > 100, "{}", chosen.len());
    let is_bar = |x: f64, bar: f32| (f64::from(bar)..f64::from(bar) + 24.0).contains(&x);
    let (mut judged, mut wrong) = (0, 0);
    for pair in &chosen {
        // The places of the first frame are whole pixels, those of the second frame are others.
        let of_first = pair.from.x.fract() == 0.0 && pair.from.x % 8.0 == 0.0;
        let (in_first, in_second) = (is_bar(pair.from.x, 60.0), is_bar(pair.to.x, 60.0 + shift));
        let moves = if of_first { in_first } else { in_second };
        let hidden = match of_first {
            true => !moves && is_bar(pair.from.x, 60.0 + shift),
            false => !moves && is_bar(pair.to.x, 60.0),
        };
        // What the other frame hides fits nowhere, and says so.
        if hidden {
            continue;
        }
        judged += 1;
        let truth = if moves { f64::from(shift) } else { 0.0 };
        wrong += usize::from((pair.to.x - pair.from.x - truth).abs() > 0.5);
    }
    assert!(judged > 80 && wrong * 20 < judged, "{wrong} of {judged}");
}

#[test]
fn what_the_other_frame_hides_fits_badly() {
    let motion = |at: Vector2<f32>| Vector2::new(if (60.0..84.0).contains(&at.x) { 9.0 } else { 0.0 }, 0.0);
    let chosen = chosen(frame(60.0), frame(69.0), motion);
    // The bar covers x = 88 in the second frame; at 96 nothing changes.
    let residuals = |x: f64| {
        let mut all: Vec<f32> =
            chosen.iter().filter(|pair| pair.from.x == x).map(|pair| pair.residual).collect();
        all.sort_unstable_by(f32::total_cmp);
        all[all.len() / 2]
    };
    assert!(residuals(88.0) > 5.0 && residuals(96.0) < 1.0, "{} {}", residuals(88.0), residuals(96.0));
}

#[test]
fn a_motion_is_handed_on_along_a_thing() {
    // Only the uppermost part of the bar was found.
    let top = |at: Vector2<f32>| {
        Vector2::new(if (60.0..84.0).contains(&at.x) && at.y < 20.0 { 9.0 } else { 0.0 }, 0.0)
    };
    let chosen = chosen(frame(60.0), frame(69.0), top);
    let lowest = chosen.iter().filter(|pair| pair.from.x == 72.0 && (pair.to.x - 81.0).abs() < 0.5);
    let lowest = lowest.map(|pair| pair.from.y).fold(0.0, f64::max);
    // The motions at y = 12 are in reach of the place at 32, and are handed on over four more.
    assert_eq!(lowest, 64.0);
}

#[test]
fn one_motion_leaves_nothing_to_choose() {
    assert!(chosen(frame(60.0), frame(60.0), |_| Vector2::zeros()).is_empty());
}
