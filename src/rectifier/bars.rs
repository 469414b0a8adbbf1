// SPDX-License-Identifier: MIT OR Apache-2.0

//! Black bars beside the picture, as of a portrait clip in a wide frame: they move with nothing and must stay straight.
//!
//! A bar is the lines at a side of the frame of which all samples are black, where a picture begins sharply behind them. Night
//! and fades have black lines, too, but no such edge. As soon as there is something in a bar it is none, for the rest of the
//! segment: too small an area would bend what lies beside it, too large a one only costs accuracy.

use crate::area::PictureArea;
use crate::plane::Luma;
use crate::pyramid::grey_row;
use std::ops::Range;

/// Largest grey of black, of 255: black is 16 in most video, and encoders add some steps beside the edge of a picture. That edge
/// is as far from it again.
const BLACK: f32 = 24.0;
/// Lines from the bar on of which one is bright: in a clip that was scaled, one or two lie between black and picture.
const EDGE: usize = 3;
/// Lines of a bar that need not stay black: encoders spread the edge of the picture over a block.
const BLOCK: usize = 8;

/// Whether a bar lies at an edge of the frame.
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
    /// Lines of the bar.
    fn lines(self) -> usize {
        if let Self::Bar(lines) = self { lines } else { 0 }
    }

    /// Lines of so many that may belong to a bar.
    fn possible(self, lines: usize) -> usize {
        if self == Self::Unknown { lines } else { self.lines() }
    }
}

/// The bars of a stream's frames.
#[derive(Clone, Debug, Default)]
pub struct Bars {
    /// Those across x (left, right) and across y (top, bottom).
    sides: [[Side; 2]; 2],
    /// Memory for a row.
    row: Vec<f32>,
}

impl Bars {
    /// The next frame may be of another clip. Bars stay until something is in them: a dark frame does not show where the
    /// picture lies.
    pub fn restart(&mut self) {
        for side in self.sides.as_flattened_mut() {
            if *side == Side::Picture {
                *side = Side::Unknown;
            }
        }
    }

    /// Where the picture lies, given one more frame.
    pub fn area(&mut self, luma: &Luma<'_>) -> PictureArea {
        let layout = luma.plane.layout();
        let size = [layout.width, layout.height];
        self.row.resize(layout.width, 0.0);
        let mut rows = Rows { luma, row: &mut self.row, size };
        let possible = [0, 1].map(|axis| self.sides[axis].map(|side| side.possible(size[axis])));
        let above = rows.black_rows(0, possible[1][0]);
        // A frame that is black shows no edge.
        if above < size[1] {
            let below = rows.black_rows(1, possible[1][1]);
            let black = [rows.black_columns(possible[0]), [above, below]];
            for (axis, end) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                let (side, count) = (&mut self.sides[axis][end], black[axis][end]);
                let [from, to] = black[1 - axis];
                let across = from..size[1 - axis].saturating_sub(to);
                *side = match *side {
                    Side::Unknown if count == 0 => Side::Picture,
                    Side::Unknown if rows.has_edge(axis, end, count, across) => Side::Bar(count),
                    Side::Bar(bar) if count < bar.saturating_sub(BLOCK).max(1) => Side::Picture,
                    known => known,
                };
            }
        }
        let bars = self.sides.map(|sides| sides.map(Side::lines));
        let rest = |axis: usize| size[axis].saturating_sub(bars[axis][0] + bars[axis][1]);
        PictureArea::new(size, [bars[0][0], bars[1][0]], [rest(0), rest(1)])
            .unwrap_or(PictureArea::whole(size[0], size[1]))
    }
}

/// The grey of a frame's pixels, row by row.
struct Rows<'a> {
    luma: &'a Luma<'a>,
    row: &'a mut [f32],
    /// Width and height of the frame.
    size: [usize; 2],
}

impl Rows<'_> {
    fn row(&mut self, y: usize) -> &[f32] {
        grey_row(self.luma, y, self.row);
        self.row
    }

    /// Black rows at the top (end 0) or at the bottom, of so many.
    fn black_rows(&mut self, end: usize, most: usize) -> usize {
        let height = self.size[1];
        (0..most).take_while(|&line| self.row(place(height, end, line)).iter().all(is_black)).count()
    }

    /// Black columns on the left and on the right, of so many: those that are black in each row.
    fn black_columns(&mut self, mut least: [usize; 2]) -> [usize; 2] {
        for y in 0..self.size[1] {
            if least == [0, 0] {
                break;
            }
            let [left, right] = least;
            let row = self.row(y);
            least = [
                row.iter().take(left).take_while(|grey| is_black(grey)).count(),
                row.iter().rev().take(right).take_while(|grey| is_black(grey)).count(),
            ];
        }
        least
    }

    /// Whether most of a line is bright within `across`, of those which follow so many black ones.
    fn has_edge(&mut self, axis: usize, end: usize, black: usize, across: Range<usize>) -> bool {
        let lines = black..(black + EDGE).min(self.size[axis]);
        let size = self.size[axis];
        let mut bright = [0; EDGE];
        let least = across.len() / 2;
        if axis == 1 {
            for (line, count) in lines.zip(&mut bright) {
                let row = self.row(place(size, end, line)).get(across.clone()).unwrap_or_default();
                *count = row.iter().filter(|grey| is_bright(grey)).count();
            }
        } else {
            for y in across {
                let row = self.row(y);
                for (line, count) in lines.clone().zip(&mut bright) {
                    *count += usize::from(row.get(place(size, end, line)).is_some_and(is_bright));
                }
            }
        }
        bright.iter().any(|&count| count > least)
    }
}

/// The place of a line, of `size`, that is counted from a side.
fn place(size: usize, end: usize, line: usize) -> usize {
    if end == 0 { line } else { size - 1 - line }
}

fn is_bright(grey: &f32) -> bool {
    *grey >= 2.0 * BLACK
}

fn is_black(grey: &f32) -> bool {
    *grey <= BLACK
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

    #[test]
    fn bars_outlast_a_dark_start_of_the_next_segment() {
        let letterbox = |x: usize, y: usize| if (3..21).contains(&y) { picture(x, y) } else { 16 };
        let mut bars = Bars::default();
        let expected = area(&mut bars, letterbox);
        bars.restart();
        assert_eq!(area(&mut bars, |_, _| 16), expected);
        assert_eq!(area(&mut bars, picture), whole());
        // A frame of another clip, with bars again.
        bars.restart();
        assert_eq!(area(&mut bars, letterbox), expected);
    }
}
