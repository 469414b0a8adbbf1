// SPDX-License-Identifier: MIT OR Apache-2.0

//! Pictures between black bars: their motion is that of the picture alone, and the bars stay.

use super::film::*;
use super::*;
use crate::plane::{Plane, PlaneLayout, SampleFormat};
use crate::readout::{ReadoutDirection, ReadoutTime};
use crate::warp::{FrameLayout, WarpSettings, Warper};

/// Rows of each bar: at an odd row, so that no pixel of chroma ends where the bar does.
const BAR: usize = 35;
const FRAME: [usize; 2] = [WIDTH, HEIGHT + 2 * BAR];

fn rectifier(height: usize) -> Rectifier {
    let settings = Settings {
        lookahead: 2,
        direction: Some(ReadoutDirection::TopToBottom),
        readout_time: ReadoutTime::WholePeriod,
        ..Settings::default()
    };
    Rectifier::new(settings, WIDTH, height, Some(PERIOD)).unwrap()
}

fn letterboxed(picture: &[u8]) -> Vec<u8> {
    let bar = [16; WIDTH * BAR];
    [&bar[..], picture, &bar[..]].concat()
}

fn solutions(rectifier: &mut Rectifier, frames: impl Iterator<Item = Vec<u8>>) -> Vec<FrameSolution> {
    let height = rectifier.area.frame()[1];
    for (index, luma) in frames.enumerate() {
        let plane = Plane::new(&luma, PlaneLayout::packed(WIDTH, height, SampleFormat::U8)).unwrap();
        rectifier.push(&plane.into(), Some(index as f64 * PERIOD), Duplicate::Detect).unwrap();
    }
    rectifier.drain();
    pops(rectifier)
}

fn picture(index: usize) -> Vec<u8> {
    frame(index as f64 * PERIOD, VELOCITY).to_vec()
}

#[test]
fn the_motion_is_that_of_the_picture() {
    let alone = solutions(&mut rectifier(HEIGHT), (0..8).map(picture));
    let between = solutions(&mut rectifier(FRAME[1]), (0..8).map(|index| letterboxed(&picture(index))));
    let area = PictureArea::new(FRAME, [0, BAR], [WIDTH, HEIGHT]).unwrap();
    for (alone, between) in alone.into_iter().zip(between) {
        assert_eq!(alone.within(area), between);
    }
}

#[test]
fn a_picture_that_comes_out_of_the_black_loses_no_frame() {
    let frames =
        (0..12).map(|index| letterboxed(&if index < 4 { vec![16; WIDTH * HEIGHT] } else { picture(index) }));
    let found = solutions(&mut rectifier(FRAME[1]), frames);
    assert_eq!(found.iter().map(|solution| solution.index).collect::<Vec<_>>(), (0..12).collect::<Vec<_>>());
    assert!(found[..4].iter().all(|solution| solution.motion.area().is_whole()));
    for solution in &found[5..] {
        assert_eq!(solution.motion.area().origin(), [0, BAR]);
        assert!(solution.confidence > 0.9, "{solution:?}");
    }
}

#[test]
fn bars_stay_and_nothing_of_them_is_drawn_into_the_picture() {
    let luma = letterboxed(&picture(3));
    let frames = (0..8).map(|index| letterboxed(&picture(index)));
    let found = solutions(&mut rectifier(FRAME[1]), frames);
    // 4:2:0: an odd row of chroma shows the bar and the picture.
    let layout = FrameLayout::yuv420(FRAME[0], FRAME[1], SampleFormat::U8);
    let chroma_rows = FRAME[1].div_ceil(2);
    let chroma: Vec<u8> = (0..chroma_rows)
        .flat_map(|row| [if (18..chroma_rows - 18).contains(&row) { 90 } else { 128 }; WIDTH.div_ceil(2)])
        .collect();
    let source = [luma.clone(), chroma.clone(), chroma.clone()];
    let mut target = source.clone().map(|plane| vec![0; plane.len()]);
    let mut warper = Warper::new();
    warper
        .prepare(&found[3].motion, &WarpSettings::default())
        .warp_frame(&layout, &source, &mut target)
        .unwrap();
    let (bar, end) = (WIDTH * BAR, WIDTH * (BAR + HEIGHT));
    assert_ne!(target[0], source[0]);
    assert!(target[0][..bar].iter().chain(&target[0][end..]).all(|&luma| luma == 16));
    let darkest = |luma: &[u8]| luma[bar..end].iter().copied().min().unwrap();
    assert!(darkest(&target[0]) >= darkest(&luma).saturating_sub(12), "{}", darkest(&target[0]));
    assert_eq!(target[1..], source[1..]);
}
