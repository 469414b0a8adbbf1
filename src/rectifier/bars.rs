// SPDX-License-Identifier: MIT OR Apache-2.0

//! Black bars beside the picture, as of a portrait clip in a wide frame: they move with nothing and must stay straight.
//!
//! A bar is the lines at a side of the frame of which all samples are black, where a picture begins sharply behind them. Night
//! and fades have black lines, too, but no such edge. As soon as there is something in a bar it is none, for the rest of the
//! segment: too small an area would bend what lies beside it, too large a one only costs accuracy.

use crate::area::PictureArea;
use crate::plane::Luma;
use std::ops::Range;

/// Largest sample of black, as a share of the largest possible one: black is 16 of 255 in most video, and encoders add some
/// steps beside the edge of a picture.
const BLACK: f64 = 24.0 / 255.0;
/// Least luma of a picture's edge: as far from black again.
const BRIGHT: f64 = 2.0 * BLACK;
/// Lines from the bar on of which one is bright: in a clip that was scaled, one or two lie between black and picture.
const EDGE: usize = 3;
/// Lines of a bar that need not stay black: encoders spread the edge of the picture over a block.
const BLOCK: usize = 8;

/// What is known of a side of the frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Side {
    /// All frames so far were dark there.
    #[default]
    Unknown,
    /// A bar of so many lines.
    Bar(usize),
    /// The picture reaches it.
    Picture,
}

impl Side {
    fn lines(self) -> usize {
        if let Self::Bar(lines) = self { lines } else { 0 }
    }
}

/// The bars of a stream's frames.
#[derive(Clone, Debug, Default)]
pub struct Bars {
    /// Those across x (left, right) and across y (top, bottom).
    sides: [[Side; 2]; 2],
}

impl Bars {
    /// Where the picture lies, given one more frame.
    pub fn area(&mut self, luma: &Luma<'_>) -> PictureArea {
        let layout = luma.plane.layout();
        let size = [layout.width, layout.height];
        let lines = Lines { luma, black: sample(luma, BLACK), bright: sample(luma, BRIGHT) };
        let black = [0, 1].map(|axis| [0, 1].map(|end| lines.black(axis, end, self.sides[axis][end])));
        for (axis, end) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let (side, count) = (&mut self.sides[axis][end], black[axis][end]);
            let [from, to] = black[1 - axis];
            let across = from..size[1 - axis].saturating_sub(to);
            *side = match *side {
                Side::Unknown if count == 0 => Side::Picture,
                Side::Unknown if lines.has_edge(axis, end, count, &across) => Side::Bar(count),
                Side::Bar(bar) if count < bar.saturating_sub(BLOCK).max(1) => Side::Picture,
                known => known,
            };
        }
        let bars = self.sides.map(|sides| sides.map(Side::lines));
        let rest = |axis: usize| size[axis].saturating_sub(bars[axis][0] + bars[axis][1]);
        PictureArea::new(size, [bars[0][0], bars[1][0]], [rest(0), rest(1)])
            .unwrap_or(PictureArea::whole(size[0], size[1]))
    }
}

/// A share of the largest sample.
fn sample(luma: &Luma<'_>, share: f64) -> f64 {
    share * f64::from(luma.plane.layout().format.max_value())
}

/// The rows (axis 1) and columns (axis 0) of a frame, counted from one of its sides.
struct Lines<'a> {
    luma: &'a Luma<'a>,
    black: f64,
    bright: f64,
}

impl Lines<'_> {
    /// Black lines at a side: no more are counted than its bar has, and none where it has none.
    fn black(&self, axis: usize, end: usize, side: Side) -> usize {
        let most = match side {
            Side::Unknown => self.size()[axis],
            Side::Bar(lines) => lines,
            Side::Picture => 0,
        };
        let across = 0..self.size()[1 - axis];
        (0..most)
            .take_while(|&line| self.values(axis, end, line, &across).all(|luma| luma <= self.black))
            .count()
    }

    /// Whether most of a line is bright, of those which follow so many black ones.
    fn has_edge(&self, axis: usize, end: usize, black: usize, across: &Range<usize>) -> bool {
        (black..(black + EDGE).min(self.size()[axis])).any(|line| {
            let bright = self.values(axis, end, line, across).filter(|&luma| luma >= self.bright).count();
            2 * bright > across.len()
        })
    }

    /// The luma of a line's pixels within `across`.
    fn values(
        &self,
        axis: usize,
        end: usize,
        line: usize,
        across: &Range<usize>,
    ) -> impl Iterator<Item = f64> + '_ {
        let line = if end == 0 { line } else { self.size()[axis] - 1 - line };
        across.clone().map(move |at| if axis == 0 { self.luma.at(line, at) } else { self.luma.at(at, line) })
    }

    fn size(&self) -> [usize; 2] {
        let layout = self.luma.plane.layout();
        [layout.width, layout.height]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::{Plane, PlaneLayout, SampleFormat};

    const SIZE: [usize; 2] = [32, 24];

    /// The area of frames whose luma is a function of the pixel.
    fn area(bars: &mut Bars, luma: impl Fn(usize, usize) -> u8) -> PictureArea {
        let [width, height] = SIZE;
        let samples: Vec<u8> = (0..width * height).map(|at| luma(at % width, at / width)).collect();
        let plane = Plane::new(&samples, PlaneLayout::packed(width, height, SampleFormat::U8)).unwrap();
        bars.area(&plane.into())
    }

    fn picture(x: usize, y: usize) -> u8 {
        (60 + (7 * x + 13 * y) % 180) as u8
    }

    fn whole() -> PictureArea {
        PictureArea::whole(SIZE[0], SIZE[1])
    }

    #[test]
    fn bars_end_where_the_picture_begins() {
        // Noise of encoders, and a line between black and picture.
        let luma = |x: usize, y: usize| match (x, y) {
            (8..20, 6) => 40,
            (8..20, 7..21) => picture(x, y),
            _ => 15 + (x * y % 5) as u8,
        };
        let mut bars = Bars::default();
        let expected = PictureArea::new(SIZE, [8, 6], [12, 15]).unwrap();
        assert_eq!(area(&mut bars, luma), expected);
        // A picture that is dark for a while is still there.
        assert_eq!(area(&mut bars, |_, _| 16), expected);
    }

    #[test]
    fn fades_and_nights_have_no_bars() {
        let mut bars = Bars::default();
        assert_eq!(area(&mut bars, |_, _| 16), whole());
        // A night sky over lamps.
        let night = |x: usize, y: usize| if y < 9 || !(3 * x + y).is_multiple_of(5) { 16 } else { 200 };
        assert_eq!(area(&mut bars, night), whole());
        // What comes out of the black has bars.
        let letterbox = |x: usize, y: usize| if (3..21).contains(&y) { picture(x, y) } else { 16 };
        let expected = PictureArea::new(SIZE, [0, 3], [32, 18]).unwrap();
        assert_eq!(area(&mut Bars::default(), letterbox), expected);
        bars = Bars::default();
        area(&mut bars, |_, _| 16);
        assert_eq!(area(&mut bars, letterbox), expected);
    }

    #[test]
    fn a_bar_with_something_in_it_is_none() {
        let letterbox = |x: usize, y: usize| if (3..21).contains(&y) { picture(x, y) } else { 16 };
        let mut bars = Bars::default();
        area(&mut bars, letterbox);
        // Beside the picture, as encoders leave it, and all over the bar.
        let spread = |x: usize, y: usize| if y == 2 && x == 9 { 40 } else { letterbox(x, y) };
        assert_eq!(area(&mut bars, spread), PictureArea::new(SIZE, [0, 3], [32, 18]).unwrap());
        let subtitle = |x: usize, y: usize| if y > 21 && x == 9 { 235 } else { letterbox(x, y) };
        let expected = PictureArea::new(SIZE, [0, 3], [32, 21]).unwrap();
        assert_eq!(area(&mut bars, subtitle), expected);
        assert_eq!(area(&mut bars, letterbox), expected);
    }
}
