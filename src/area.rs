// SPDX-License-Identifier: MIT OR Apache-2.0

//! Where the picture lies in its frame: all of it, or what is left between black bars.

use std::ops::Range;

/// The part of a frame that shows the picture, in pixels of the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PictureArea {
    /// Width and height of the frame.
    frame: [usize; 2],
    /// Column and row of the picture's first pixel.
    origin: [usize; 2],
    /// Width and height of the picture.
    size: [usize; 2],
}

impl PictureArea {
    /// A picture that fills its frame.
    #[must_use]
    pub const fn whole(width: usize, height: usize) -> Self {
        Self { frame: [width, height], origin: [0, 0], size: [width, height] }
    }

    /// A picture of `size` at `origin` in a frame of `frame` pixels, each as x and y; `None` where it has no pixels or is
    /// not within the frame.
    #[must_use]
    pub fn new(frame: [usize; 2], origin: [usize; 2], size: [usize; 2]) -> Option<Self> {
        let fits = |axis: usize| {
            size[axis] > 0 && origin[axis].checked_add(size[axis]).is_some_and(|end| end <= frame[axis])
        };
        (fits(0) && fits(1)).then_some(Self { frame, origin, size })
    }

    /// Width and height of the frame.
    #[must_use]
    pub const fn frame(&self) -> [usize; 2] {
        self.frame
    }

    /// Column and row of the picture's first pixel.
    #[must_use]
    pub const fn origin(&self) -> [usize; 2] {
        self.origin
    }

    /// Width and height of the picture.
    #[must_use]
    pub const fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Columns and rows of the picture.
    #[must_use]
    pub fn ranges(&self) -> [Range<usize>; 2] {
        [0, 1].map(|axis| self.origin[axis]..self.origin[axis] + self.size[axis])
    }

    /// Whether the picture fills its frame.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.size == self.frame
    }

    /// The same of the frame scaled to `width` × `height` pixels.
    #[must_use]
    pub(crate) fn scaled_to(&self, width: usize, height: usize) -> Self {
        let to = [width, height];
        // Bounds are rounded to whole pixels; a picture of less than one keeps that.
        let scaled = |axis: usize, at: usize| {
            let from = self.frame[axis].max(1) as u128;
            ((at as u128 * to[axis] as u128 + from / 2) / from) as usize
        };
        let bounds = [0, 1].map(|axis| {
            let end = scaled(axis, self.origin[axis] + self.size[axis]).clamp(1.min(to[axis]), to[axis]);
            [scaled(axis, self.origin[axis]).min(end.saturating_sub(1)), end]
        });
        Self { frame: to, origin: bounds.map(|[from, _]| from), size: bounds.map(|[from, end]| end - from) }
    }

    /// The same of the frame turned clockwise by a quarter: the first row becomes the last column.
    #[must_use]
    pub(crate) const fn turned(&self) -> Self {
        let Self { frame, origin, size } = *self;
        Self {
            frame: [frame[1], frame[0]],
            origin: [frame[1] - origin[1] - size[1], origin[0]],
            size: [size[1], size[0]],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_lies_within_its_frame() {
        assert_eq!(PictureArea::new([64, 48], [0, 0], [64, 48]), Some(PictureArea::whole(64, 48)));
        assert_eq!(PictureArea::new([64, 48], [0, 8], [64, 41]), None);
        assert_eq!(PictureArea::new([64, 48], [0, 8], [64, 0]), None);
        assert_eq!(PictureArea::new([64, 48], [usize::MAX, 0], [64, 48]), None);
    }

    #[test]
    fn areas_are_scaled_and_turned_with_their_frames() {
        let area = PictureArea::new([640, 480], [0, 60], [640, 340]).unwrap();
        assert_eq!(area.scaled_to(1280, 960), PictureArea::new([1280, 960], [0, 120], [1280, 680]).unwrap());
        assert_eq!(area.scaled_to(640, 480), area);
        assert_eq!(area.scaled_to(3, 2).size(), [3, 2]);
        assert_eq!(area.scaled_to(0, 0).size(), [0, 0]);
        assert_eq!(area.turned(), PictureArea::new([480, 640], [80, 0], [340, 640]).unwrap());
        assert_eq!((0..4).fold(area, |area, _| area.turned()), area);
    }
}
