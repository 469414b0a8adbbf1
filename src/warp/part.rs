// SPDX-License-Identifier: MIT OR Apache-2.0

//! The part of a plane that shows the picture, without the black bars beside it.

use super::sample_grid::SampleGrid;
use crate::area::PictureArea;
use crate::plane::PlaneLayout;
use std::ops::Range;

/// The pixels of a plane that show the picture.
pub(super) struct PlanePart {
    pub columns: Range<usize>,
    pub rows: Range<usize>,
    /// Where they lie in the picture.
    pub grid: SampleGrid,
}

impl PlanePart {
    /// The part of a plane with this grid. Pixels that show the picture and a bar belong to the bar.
    pub fn new(area: &PictureArea, grid: &SampleGrid, layout: &PlaneLayout) -> Self {
        let count = [layout.width, layout.height];
        let pixels = |axis: usize| {
            let (from, to) = (area.origin()[axis], area.origin()[axis] + area.size()[axis]);
            let at = |pixel: usize| pixel as f64 / grid.scale[axis];
            // A plane may have a pixel more than its frame's size divided by the scale.
            let end = if to == area.frame()[axis] { count[axis] } else { at(to).floor() as usize };
            (at(from).ceil() as usize).min(count[axis])..end.min(count[axis])
        };
        let (columns, rows) = (pixels(0), pixels(1));
        let first = [columns.start, rows.start];
        let offset = |axis: usize| {
            grid.scale[axis] * first[axis] as f64 + grid.offset[axis] - area.origin()[axis] as f64
        };
        let grid = SampleGrid { offset: [offset(0), offset(1)], ..*grid };
        Self { columns, rows, grid }
    }

    /// Whether it is all of the plane.
    pub fn is_whole(&self, layout: &PlaneLayout) -> bool {
        (self.columns.clone(), self.rows.clone()) == (0..layout.width, 0..layout.height)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::SampleFormat;

    #[test]
    fn pixels_of_chroma_that_show_a_bar_belong_to_it() {
        let area = PictureArea::new([641, 480], [0, 61], [641, 358]).unwrap();
        let luma = PlaneLayout::packed(641, 480, SampleFormat::U8);
        let part = PlanePart::new(&area, &SampleGrid::FULL, &luma);
        assert_eq!((part.columns.clone(), part.rows.clone()), (0..641, 61..419));
        assert_eq!(part.grid, SampleGrid::FULL);
        let chroma = PlaneLayout::packed(321, 240, SampleFormat::U8);
        let part = PlanePart::new(&area, &SampleGrid::CHROMA_420, &chroma);
        assert_eq!((part.columns, part.rows), (0..321, 31..209));
        // Row 31 lies between the rows 62 and 63 of the frame: 1 and 2 of the picture.
        assert_eq!(part.grid.offset, [0.0, 1.5]);
    }

    #[test]
    fn a_picture_without_bars_is_the_whole_plane() {
        let area = PictureArea::whole(5, 3);
        let chroma = PlaneLayout::packed(3, 2, SampleFormat::U8);
        let part = PlanePart::new(&area, &SampleGrid::CHROMA_420, &chroma);
        assert!(part.is_whole(&chroma));
        assert_eq!(part.grid, SampleGrid::CHROMA_420);
    }
}
