// SPDX-License-Identifier: MIT OR Apache-2.0

//! A frame's motion path and a plane → the rectified plane.
//!
//! A point at x in the frame (centred pixels, exposed at share s) is moved to
//! z · (x + α·(carry(x, s, ref) − x)) in the rectified frame: 25.11 with a strength α and a zoom z. If the frame is stabilised,
//! its placement P, a homography, is applied before the zoom: z · P(x + α·(…)).
//! [`Warper::prepare`] inverts this map once a frame, [`PreparedFrame::warp_frame`] resamples the
//! frame's planes by it, without the bars beside the picture, in two passes: first down the columns, then along the rows (see `kernels`).
//!
//! Positions are accurate to 0.01 px: the map is solved at nodes, interpolated between them, and
//! rounded to 1/2048 px.

mod blocks;
mod border;
mod borders;
mod correction;
mod frame;
mod inverse;
mod kernels;
mod knots;
mod monotone;
mod nodes;
mod part;
mod rows;
mod sample_grid;
mod settings;
#[cfg(test)]
mod tests;
mod weights;

pub use crate::cpu::CpuLevel;
pub use borders::{UNBENT_SHARE, least_zoom};
pub use frame::FrameLayout;
pub use sample_grid::SampleGrid;
pub use settings::{BorderMode, Fill, Interpolation, WarpSettings};

use crate::area::PictureArea;
use crate::motion::FrameMotion;
use crate::plane::{Plane, PlaneError, PlaneLayout, PlaneMut};
use border::PlaneBorder;
use inverse::InverseMap;
use knots::KnotTable;
use part::PlanePart;
use std::sync::{Arc, Mutex, PoisonError};
use thiserror::Error;

/// Why a plane cannot be rectified.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum WarpError {
    /// Source and destination differ in size, channels or sample format.
    #[error("source and destination planes differ in size, channels or sample format")]
    Mismatch,
    /// The sample grid is invalid: a scale that is not positive or a number that is not finite.
    #[error("a plane's scale must be positive and its offset finite")]
    SampleGrid,
    /// A frame has more or fewer planes than its layout.
    #[error("a frame has more or fewer planes than its layout")]
    Planes,
    /// The bytes of a plane do not fit its layout.
    #[error(transparent)]
    Plane(#[from] PlaneError),
}

/// Rectifies the planes of successive frames; reuses its buffers.
///
/// With the feature `rayon`, rows are distributed over the thread pool in which [`prepare`](Self::prepare)
/// and the methods of [`PreparedFrame`] are called.
#[derive(Debug)]
pub struct Warper {
    level: CpuLevel,
    settings: WarpSettings,
    identity: bool,
    /// Where the picture lies that is rectified; what is beside it stays.
    area: PictureArea,
    map: InverseMap,
    /// Knots of the planes warped since `prepare`, and spare memory.
    planes: Mutex<PlaneMaps>,
}

/// The inverse map at the knots of one kind of plane.
#[derive(Clone, Debug, Default)]
struct PlaneMap {
    across: KnotTable,
    down: KnotTable,
}

#[derive(Debug, Default)]
struct PlaneMaps {
    used: Vec<(SampleGrid, usize, Arc<PlaneMap>)>,
    spare: Vec<Arc<PlaneMap>>,
}

impl Default for Warper {
    fn default() -> Self {
        Self::new()
    }
}

impl Warper {
    /// A warper with empty buffers, with the best instructions of this machine.
    #[must_use]
    pub fn new() -> Self {
        Self::with_cpu(CpuLevel::detect())
    }

    /// A warper with the instructions of `level`.
    #[must_use]
    pub fn with_cpu(level: CpuLevel) -> Self {
        Self {
            level,
            settings: WarpSettings::default(),
            identity: true,
            area: PictureArea::whole(0, 0),
            map: InverseMap::default(),
            planes: Mutex::default(),
        }
    }

    /// Computes the inverse map of one frame, common to all its planes.
    ///
    /// The applied strength is that of the settings times the motion's weight.
    /// Settings are clamped to their range; the zoom to at most 8.
    pub fn prepare(&mut self, motion: &FrameMotion, settings: &WarpSettings) -> PreparedFrame<'_> {
        self.solve(motion, settings);
        PreparedFrame { warper: self }
    }

    /// Computes the inverse map of one frame.
    fn solve(&mut self, motion: &FrameMotion, settings: &WarpSettings) {
        self.settings = *settings;
        self.area = *motion.area();
        let is_still = motion.is_still() || settings.strength <= 0.0;
        self.identity = is_still && settings.zoom <= 1.0;
        let planes = self.planes.get_mut().unwrap_or_else(PoisonError::into_inner);
        // The last comes first: each finds memory of its own size again where frames have the same planes in the same order.
        planes.spare.extend(planes.used.drain(..).rev().map(|(_, _, map)| map));
        if !self.identity {
            self.map.solve(self.level, motion, settings);
        }
    }

    /// Fills `dst` with the rectified `src`; see [`PreparedFrame::warp_plane`].
    fn warp(
        &self,
        src: &Plane<'_>,
        dst: &mut PlaneMut<'_>,
        grid: SampleGrid,
        index: usize,
    ) -> Result<(), WarpError> {
        let key = |layout: &PlaneLayout| (layout.width, layout.height, layout.channels, layout.format);
        if key(src.layout()) != key(dst.layout()) {
            return Err(WarpError::Mismatch);
        }
        if !grid.is_valid() {
            return Err(WarpError::SampleGrid);
        }
        if src.layout().width == 0 || src.layout().height == 0 {
            return Ok(());
        }
        if self.identity {
            rows::copy(src, dst);
            return Ok(());
        }
        let part = PlanePart::new(&self.area, &grid, src.layout());
        if !part.is_whole(src.layout()) {
            rows::copy(src, dst);
        }
        let parts = src.part(&part.columns, &part.rows).zip(dst.part(&part.columns, &part.rows));
        let Some((source, mut dst)) = parts else { return Ok(()) };
        let map = self.plane_map(part.grid, source.layout().width);
        let task = rows::PlaneTask {
            level: self.level,
            interpolation: self.settings.interpolation,
            border: PlaneBorder::of(self.settings.border, index),
            across: &map.across,
            down: &map.down,
            source,
        };
        task.run(&mut dst);
        Ok(())
    }

    /// The knots of planes of this sample grid and width, computed on first use.
    fn plane_map(&self, grid: SampleGrid, width: usize) -> Arc<PlaneMap> {
        let mut planes = self.planes.lock().unwrap_or_else(PoisonError::into_inner);
        let cached = planes.used.iter().find(|(at, columns, _)| *at == grid && *columns == width);
        if let Some((_, _, map)) = cached {
            return map.clone();
        }
        let mut map = planes.spare.pop().unwrap_or_default();
        Arc::make_mut(&mut map).fill(self.level, &self.map, &grid, width);
        planes.used.push((grid, width, map.clone()));
        map
    }
}

/// A frame whose planes can be rectified, in any order and from any thread.
#[derive(Debug)]
#[must_use = "only `warp` rectifies"]
pub struct PreparedFrame<'a> {
    warper: &'a Warper,
}

impl PreparedFrame<'_> {
    /// Fills `dst` with the rectified `src`, the frame's only plane or its first; see
    /// [`warp_plane`](Self::warp_plane).
    ///
    /// # Errors
    /// As [`warp_plane`](Self::warp_plane).
    pub fn warp(&self, src: &Plane<'_>, dst: &mut PlaneMut<'_>, grid: SampleGrid) -> Result<(), WarpError> {
        self.warp_plane(0, src, dst, grid)
    }

    /// Fills `dst` with the rectified `src`, plane `index` of the frame, counted from 0. The index
    /// chooses the sample values of [`BorderMode::Constant`], nothing else.
    ///
    /// The steps of the two planes may differ; samples that belong to other views of the same bytes are
    /// not written.
    ///
    /// # Errors
    /// If the planes differ in size, channels or sample format, or the grid is invalid; see
    /// [`WarpError`].
    pub fn warp_plane(
        &self,
        index: usize,
        src: &Plane<'_>,
        dst: &mut PlaneMut<'_>,
        grid: SampleGrid,
    ) -> Result<(), WarpError> {
        self.warper.warp(src, dst, grid, index)
    }

    /// Fills the planes `dst` with those of the rectified frame, whose planes are `src`; both have this
    /// layout.
    ///
    /// # Errors
    /// If there are more or fewer planes than in the layout, or one of them is shorter, or the layout is
    /// invalid; see [`WarpError`].
    pub fn warp_frame(
        &self,
        layout: &FrameLayout,
        src: &[impl AsRef<[u8]>],
        dst: &mut [impl AsMut<[u8]>],
    ) -> Result<(), WarpError> {
        if [src.len(), dst.len()] != [layout.planes.len(); 2] {
            return Err(WarpError::Planes);
        }
        let planes = layout.planes.iter().zip(src).zip(dst).enumerate();
        for (index, ((&(layout, grid), src), dst)) in planes {
            let (src, mut dst) = (Plane::new(src.as_ref(), layout)?, PlaneMut::new(dst.as_mut(), layout)?);
            self.warp_plane(index, &src, &mut dst, grid)?;
        }
        Ok(())
    }
}

impl PlaneMap {
    fn fill(&mut self, level: CpuLevel, map: &InverseMap, grid: &SampleGrid, width: usize) {
        let last = width as isize - 1;
        self.across.fill(level, &map.across, grid, 0, [0, last]);
        let down = &map.down;
        let column = |x: f64| ((x - grid.offset[0]) / grid.scale[0]) as isize;
        let from = column(down.x.first).clamp(-2 * last - 2, 0);
        let to = column(down.x.at(down.x.count)).clamp(last, 3 * last + 3);
        self.down.fill(level, down, grid, 1, [from, to]);
    }
}
