//! A frame's motion path and a plane → the rectified plane.
//!
//! A point at x in the frame (centred pixels, exposed at share s) is moved to
//! z · (x + α·(carry(x, s, ref) − x)) in the rectified frame: 25.11 with a strength α and a zoom z.
//! [`Warper::prepare`] inverts this map once a frame, [`PreparedFrame::warp`] resamples any of the
//! frame's planes by it, in two passes: first down the columns, then along the rows (see `kernels`).
//!
//! Positions are accurate to 0.01 px: the map is solved at nodes, interpolated between them, and
//! rounded to 1/2048 px.

mod blocks;
mod border;
mod correction;
mod inverse;
mod kernels;
mod monotone;
mod rows;
#[cfg(test)]
mod tests;
mod weights;

pub use crate::cpu::CpuLevel;

use crate::motion::FrameMotion;
use crate::plane::{Plane, PlaneLayout, PlaneMut};
use blocks::KnotTable;
use inverse::InverseMap;
use std::sync::{Arc, Mutex, PoisonError};
use thiserror::Error;

/// The interpolation kernel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Interpolation {
    /// The nearest sample.
    Nearest,
    /// 2 × 2 samples.
    Linear,
    /// 4 × 4 samples, Catmull–Rom kernel.
    #[default]
    Cubic,
    /// 6 × 6 samples, Lanczos kernel with three lobes.
    Lanczos,
}

/// The picture outside the frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum BorderMode {
    /// The nearest edge sample.
    #[default]
    Replicate,
    /// The picture mirrored at its edge.
    Mirror,
    /// A fill value.
    Constant,
}

/// How a frame is rectified.
///
/// ```
/// let mut settings = rsrectify::warp::WarpSettings::default();
/// settings.strength = 0.5;
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct WarpSettings {
    /// The interpolation kernel.
    pub interpolation: Interpolation,
    /// The picture outside the frame.
    pub border: BorderMode,
    /// Share of the readout whose instant the output shows, 0 to 1; 0 = first read.
    pub reference_row: f64,
    /// Share of the correction that is applied, 0 to 1: each point is displaced by this share of its full
    /// displacement, so that 0 gives the original frame and the transition is linear for any motion.
    pub strength: f64,
    /// Magnification about the picture's centre, at least 1, to hide borders.
    pub zoom: f64,
}

impl Default for WarpSettings {
    fn default() -> Self {
        Self {
            interpolation: Interpolation::Cubic,
            border: BorderMode::Replicate,
            reference_row: 0.5,
            strength: 1.0,
            zoom: 1.0,
        }
    }
}

/// The position of a plane's pixels in the frame: frame pixel = scale · plane pixel + offset, per axis,
/// pixel centres at integers.
///
/// Chroma of 4:2:0 has scale 2, and offset 0 if sited on the luma pixel, ½ if sited between two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Frame pixels from one plane pixel to the next, in x and y.
    pub scale: [f64; 2],
    /// Frame pixel of plane pixel (0, 0).
    pub offset: [f64; 2],
}

impl Placement {
    /// A plane of the frame's own size.
    pub const FULL: Self = Self { scale: [1.0, 1.0], offset: [0.0, 0.0] };

    /// Whether scales are positive and all numbers finite.
    fn is_valid(&self) -> bool {
        let numbers = self.scale.iter().chain(&self.offset);
        numbers.into_iter().all(|number| number.is_finite()) && self.scale.iter().all(|&scale| scale > 0.0)
    }
}

/// Why a plane cannot be rectified.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum WarpError {
    /// Source and destination differ in size, channels or sample format.
    #[error("source and destination planes differ in size, channels or sample format")]
    Mismatch,
    /// The placement is invalid: a scale that is not positive or a number that is not finite.
    #[error("a plane's scale must be positive and its offset finite")]
    Placement,
}

/// Rectifies the planes of successive frames; reuses its buffers.
///
/// With the feature `rayon`, rows are distributed over the thread pool in which [`prepare`](Self::prepare)
/// and [`PreparedFrame::warp`] are called.
#[derive(Debug)]
pub struct Warper {
    level: CpuLevel,
    settings: WarpSettings,
    identity: bool,
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
    used: Vec<(Placement, usize, Arc<PlaneMap>)>,
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
        let is_still = motion.is_still() || settings.strength <= 0.0;
        self.identity = is_still && settings.zoom <= 1.0;
        let planes = self.planes.get_mut().unwrap_or_else(PoisonError::into_inner);
        planes.spare.extend(planes.used.drain(..).map(|(_, _, map)| map));
        if !self.identity {
            self.map.solve(motion, settings);
        }
    }

    /// Fills `dst` with the rectified `src`; see [`PreparedFrame::warp`].
    fn warp(
        &self,
        src: &Plane<'_>,
        dst: &mut PlaneMut<'_>,
        placement: Placement,
        fill: [u16; 4],
    ) -> Result<(), WarpError> {
        let key = |layout: &PlaneLayout| (layout.width, layout.height, layout.channels, layout.format);
        if key(src.layout()) != key(dst.layout()) {
            return Err(WarpError::Mismatch);
        }
        if !placement.is_valid() {
            return Err(WarpError::Placement);
        }
        if src.layout().width == 0 || src.layout().height == 0 {
            return Ok(());
        }
        if self.identity {
            rows::copy(src, dst);
            return Ok(());
        }
        let map = self.plane_map(placement, src.layout().width);
        let task = rows::PlaneTask {
            level: self.level,
            interpolation: self.settings.interpolation,
            border: self.settings.border,
            fill,
            across: &map.across,
            down: &map.down,
            source: *src,
        };
        task.run(dst);
        Ok(())
    }

    /// The knots of planes of this placement and width, computed on first use.
    fn plane_map(&self, placement: Placement, width: usize) -> Arc<PlaneMap> {
        let mut planes = self.planes.lock().unwrap_or_else(PoisonError::into_inner);
        let cached = planes.used.iter().find(|(at, columns, _)| *at == placement && *columns == width);
        if let Some((_, _, map)) = cached {
            return map.clone();
        }
        let mut map = planes.spare.pop().unwrap_or_default();
        Arc::make_mut(&mut map).fill(&self.map, &placement, width);
        planes.used.push((placement, width, map.clone()));
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
    /// Fills `dst` with the rectified `src`, one of the frame's planes.
    ///
    /// `fill` holds one sample value per channel (before the format's shift) for
    /// [`BorderMode::Constant`]. The steps of the two planes may differ; samples that belong to other
    /// views of the same bytes are not written.
    ///
    /// # Errors
    /// If the planes differ in size, channels or sample format, or the placement is invalid; see
    /// [`WarpError`].
    pub fn warp(
        &self,
        src: &Plane<'_>,
        dst: &mut PlaneMut<'_>,
        placement: Placement,
        fill: [u16; 4],
    ) -> Result<(), WarpError> {
        self.warper.warp(src, dst, placement, fill)
    }
}

impl PlaneMap {
    fn fill(&mut self, map: &InverseMap, placement: &Placement, width: usize) {
        let last = width as isize - 1;
        self.across.fill(&map.across, placement, 0, 0, last);
        let down = &map.down;
        let column = |x: f64| ((x - placement.offset[0]) / placement.scale[0]) as isize;
        let from = column(down.x.first).clamp(-2 * last - 2, 0);
        let to = column(down.x.at(down.x.count)).clamp(last, 3 * last + 3);
        self.down.fill(down, placement, 1, from, to);
    }
}
