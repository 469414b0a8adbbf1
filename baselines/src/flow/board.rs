// SPDX-License-Identifier: MIT OR Apache-2.0

//! The pixels of a picture as the black and the white squares of a chessboard.
//!
//! The four neighbours of a square have the other colour. So the squares of one colour can be changed
//! all at once while those of the other are read, and the squares of one colour and row lie side by
//! side in memory, ready for vectors.

use super::image::Image;

/// Squares that are worked on at once.
pub const LANES: usize = 8;

/// Where the squares of a picture are kept: for each colour as many rows as the picture has and one
/// above and below, each of whole lanes and one square on the left and on the right, all of them 0
/// where there is no pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    /// Columns of the picture.
    pub width: usize,
    /// Rows of the picture.
    pub height: usize,
}

/// The squares of one colour in one row of the board; rows are counted from 1.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// 0 or 1: x + y of its pixels is even or odd (y counted from 0).
    pub colour: usize,
    /// Row of the board: that of the picture, plus 1.
    pub row: usize,
}

/// One number a pixel.
pub struct Board {
    layout: Layout,
    /// The squares of each colour.
    pub colours: [Vec<f32>; 2],
}

/// What lies next to the squares of a line, in the order of the line.
pub struct Around<'a> {
    /// To the left of each.
    pub left: &'a [f32],
    /// To the right.
    pub right: &'a [f32],
    /// Above.
    pub up: &'a [f32],
    /// Below.
    pub down: &'a [f32],
}

impl Layout {
    /// Squares of a line, whole lanes.
    pub fn span(&self) -> usize {
        self.width.div_ceil(2).next_multiple_of(LANES)
    }

    /// From one row to the next.
    pub fn stride(&self) -> usize {
        self.span() + 2
    }

    /// Columns x = 2k + shift belong to the line.
    fn shift(line: Line) -> usize {
        (line.row + 1 + line.colour) % 2
    }

    /// How many squares of the line are pixels with x < `width`.
    pub fn pixels(line: Line, width: usize) -> usize {
        (width + 1 - Self::shift(line)) / 2
    }
}

impl Board {
    /// A board of zeros.
    pub fn new(layout: Layout) -> Self {
        let zeros = vec![0.0; layout.stride() * (layout.height + 2)];
        Self { layout, colours: [zeros.clone(), zeros] }
    }

    /// A picture on the board.
    pub fn of(image: &Image) -> Self {
        let layout = Layout { width: image.width, height: image.height };
        let mut board = Self::new(layout);
        for (row, colour) in (1..=layout.height).flat_map(|row| [(row, 0), (row, 1)]) {
            let line = Line { colour, row };
            let start = row * layout.stride() + 1;
            let pixels = image.row(row - 1).iter().skip(Layout::shift(line)).step_by(2);
            board.colours[colour][start..]
                .iter_mut()
                .zip(pixels)
                .for_each(|(square, pixel)| *square = *pixel);
        }
        board
    }

    /// The picture on the board.
    pub fn picture(&self) -> Image {
        let Layout { width, height } = self.layout;
        Image::from_fn(width, height, |x, y| {
            self.colours[(x + y) % 2][(y + 1) * self.layout.stride() + 1 + x / 2]
        })
    }

    /// The squares of a line.
    pub fn line(&self, line: Line) -> &[f32] {
        self.squares(line.colour, line.row, 1)
    }

    /// The neighbours of the squares of a line.
    pub fn around(&self, line: Line) -> Around<'_> {
        let (other, shift) = (1 - line.colour, Layout::shift(line));
        Around {
            left: self.squares(other, line.row, shift),
            right: self.squares(other, line.row, shift + 1),
            up: self.squares(other, line.row - 1, 1),
            down: self.squares(other, line.row + 1, 1),
        }
    }

    fn squares(&self, colour: usize, row: usize, from: usize) -> &[f32] {
        &self.colours[colour][row * self.layout.stride() + from..][..self.layout.span()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_are_those_of_the_picture() {
        for (width, height) in [(7, 4), (34, 3)] {
            let image = Image::from_fn(width, height, |x, y| (1 + x + 100 * y) as f32);
            let board = Board::of(&image);
            assert_eq!(board.picture(), image);
            let pixel = |x: isize, y: isize| {
                let inside = x >= 0 && y >= 0 && x < width as isize && y < height as isize;
                if inside { image.at(x as usize, y as usize) } else { 0.0 }
            };
            for y in 0..height as isize {
                for x in 0..width as isize {
                    let line = Line { colour: (x + y) as usize % 2, row: y as usize + 1 };
                    let (around, k) = (board.around(line), x as usize / 2);
                    let found =
                        [board.line(line)[k], around.left[k], around.right[k], around.up[k], around.down[k]];
                    let exact =
                        [pixel(x, y), pixel(x - 1, y), pixel(x + 1, y), pixel(x, y - 1), pixel(x, y + 1)];
                    assert_eq!(found, exact, "at {x}, {y}");
                }
            }
        }
    }
}
