// SPDX-License-Identifier: MIT OR Apache-2.0

//! The pyramid of one frame, and how it is made.

use super::effort::Effort;
use super::level::Level;
use super::luma::Reduction;
use crate::cpu::CpuLevel;
use crate::plane::Luma;

/// Levels are halved until the longer side is at most this, in pixels: a search of ± a quarter of the width
/// then covers at most 25 × 25 displacements.
const COARSEST_SIDE: usize = 48;

/// Least shorter side of a level, in pixels: two patches of 8 that overlap by half.
const SHORTEST_SIDE: usize = 12;

/// The image pyramid of one frame.
///
/// Filled by [`Reducer::build`], which reuses its buffers: keep two and swap them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pyramid {
    levels: Vec<Level>,
    scratch: Vec<f32>,
    filled: bool,
}

impl Pyramid {
    /// An empty pyramid, without a frame.
    #[cfg(feature = "unstable")]
    pub fn new() -> Self {
        Self::default()
    }

    /// Whether it holds no frame.
    #[cfg(feature = "unstable")]
    pub fn is_empty(&self) -> bool {
        !self.filled
    }

    /// Whether it holds a frame of this analysed size.
    pub(crate) fn is_of(&self, size: (usize, usize)) -> bool {
        self.levels().first().is_some_and(|level| (level.width(), level.height()) == size)
    }

    /// The levels, finest first; none if it holds no frame.
    pub(crate) fn levels(&self) -> &[Level] {
        if self.filled { &self.levels } else { &[] }
    }
}

/// Builds the pyramids of frames of one size.
#[derive(Debug)]
pub struct Reducer {
    cpu: CpuLevel,
    reduction: Reduction,
    count: usize,
}

impl Reducer {
    /// For full frames of `width` × `height` pixels, any size.
    #[cfg(feature = "unstable")]
    pub fn new(width: usize, height: usize) -> Self {
        Self::with_effort(width, height, Effort::default())
    }

    /// For full frames of `width` × `height` pixels, any size, analysed at the size that `effort` selects.
    pub fn with_effort(width: usize, height: usize, effort: Effort) -> Self {
        let reduction = Reduction::new(width, height, effort.scale(width.max(height)));
        let count = level_count(reduction.size());
        Self { cpu: CpuLevel::detect(), reduction, count }
    }

    /// Full-frame pixels per analysed pixel, at least 1; the same along both axes.
    pub fn scale(&self) -> f64 {
        self.reduction.scale()
    }

    /// Width and height of the analysed luma in pixels.
    pub fn size(&self) -> (usize, usize) {
        self.reduction.size()
    }

    /// Fills `pyramid` from a luma view. A view that is not of the full frame's size leaves the pyramid
    /// empty.
    pub fn build(&self, luma: &Luma<'_>, pyramid: &mut Pyramid) {
        pyramid.levels.resize_with(self.count, Level::default);
        let Some((finest, _)) = pyramid.levels.split_first_mut() else { return };
        pyramid.filled = self.reduction.reduce(self.cpu, luma, finest, &mut pyramid.scratch);
        if !pyramid.filled {
            return;
        }
        for index in 1..self.count {
            if let Some([finer, coarser]) = pyramid.levels.get_mut(index - 1..=index) {
                coarser.halve(self.cpu, finer);
            }
        }
    }
}

fn level_count((width, height): (usize, usize)) -> usize {
    let mut levels = 1;
    while width.max(height) >> (levels - 1) > COARSEST_SIDE && width.min(height) >> levels >= SHORTEST_SIDE {
        levels += 1;
    }
    levels
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::{Plane, PlaneLayout, SampleFormat};

    #[test]
    fn levels_end_at_the_coarsest_or_the_shortest_side() {
        assert_eq!(level_count((960, 540)), 6);
        assert_eq!(level_count((640, 480)), 5);
        assert_eq!(level_count((320, 240)), 4);
        assert_eq!(level_count((960, 30)), 2);
        assert_eq!(level_count((1, 1)), 1);
    }

    #[test]
    fn a_level_is_the_luma_at_its_pixels_places() {
        let at = |x: f64, y: f64| 20.0 + x + 0.5 * y;
        let data: Vec<u8> = (0..128 * 96).map(|i| at((i % 128) as f64, (i / 128) as f64) as u8).collect();
        let plane = Plane::new(&data, PlaneLayout::packed(128, 96, SampleFormat::U8)).unwrap();
        let (reducer, mut pyramid) = (Reducer::new(128, 96), Pyramid::new());
        assert!(pyramid.is_empty() && pyramid.levels().is_empty());
        reducer.build(&plane.into(), &mut pyramid);
        assert_eq!(pyramid.levels().len(), 3);
        // Level 2 has a pixel at x = 4·(x + ½) − ½; rounding costs half a grey level.
        let found = f64::from(pyramid.levels()[2].pixel(10, 7));
        assert!((found - at(41.5, 29.5)).abs() < 0.5, "{found}");
        let wrong = Plane::new(&data, PlaneLayout::packed(64, 96, SampleFormat::U8)).unwrap();
        reducer.build(&wrong.into(), &mut pyramid);
        assert!(pyramid.is_empty());
    }

    #[test]
    fn all_levels_of_the_processor_build_the_same() {
        for (width, height, step, format) in [
            (640, 480, 1, SampleFormat::U8),
            (1920, 52, 1, SampleFormat::U10),
            (1283, 71, 3, SampleFormat::U8),
            (3840, 96, 2, SampleFormat::U12_HIGH),
        ] {
            let layout = PlaneLayout { step, ..PlaneLayout::packed(width * step, height, format) };
            let layout = PlaneLayout { width, ..layout };
            let data: Vec<u8> =
                (0..layout.required_bytes().unwrap()).map(|i| (i * i % 241 * 37 % 251) as u8).collect();
            let plane = Plane::new(&data, layout).unwrap();
            let built: Vec<Pyramid> = CpuLevel::supported()
                .map(|cpu| {
                    let mut pyramid = Pyramid::new();
                    Reducer { cpu, ..Reducer::new(width, height) }.build(&plane.into(), &mut pyramid);
                    pyramid
                })
                .collect();
            assert!(!built[0].is_empty());
            assert!(built.iter().all(|pyramid| pyramid.levels() == built[0].levels()), "{layout:?}");
        }
    }
}
