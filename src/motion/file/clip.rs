// SPDX-License-Identifier: MIT OR Apache-2.0

//! The clip whose motion a file holds.

/// The identity of the clip whose motion a file holds, and how it is shown.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Clip {
    /// Name of its file, without the folder.
    pub name: String,
    /// Size of its file in bytes.
    pub bytes: u64,
    /// Degrees, 0, 90, 180 or 270, by which players turn its frames clockwise to show them upright. The motions are those
    /// of the frames before.
    pub turned: u16,
    /// Whether players mirror its frames, too.
    pub mirrored: bool,
    /// Width over height of its pixels, as numerator and denominator, neither 0.
    pub pixel_aspect: [u32; 2],
    /// [Zoom](crate::warp::WarpSettings::zoom) to rectify its frames with, at least 1: the least that hides all borders, where that was
    /// looked for.
    pub zoom: f64,
}

impl Clip {
    /// A clip with the name and the size of its file, whose frames are shown as they are stored, with square pixels.
    #[must_use]
    pub fn new(name: impl Into<String>, bytes: u64) -> Self {
        Self { name: name.into(), bytes, turned: 0, mirrored: false, pixel_aspect: [1, 1], zoom: 1.0 }
    }

    /// Width over height of its pixels.
    pub(super) fn pixel_ratio(&self) -> f64 {
        let [width, height] = self.pixel_aspect.map(|side| f64::from(side.max(1)));
        width / height
    }
}

impl Default for Clip {
    /// An unnamed clip.
    fn default() -> Self {
        Self::new("", 0)
    }
}
