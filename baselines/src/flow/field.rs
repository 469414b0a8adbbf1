// SPDX-License-Identifier: MIT OR Apache-2.0

//! The displacement of each pixel.

use super::image::Image;

/// The displacement of each pixel of a frame, in pixels: what is seen at x is seen at x + (u, v) in the
/// other frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Flow {
    /// To the right.
    pub u: Image,
    /// Downwards.
    pub v: Image,
}

impl Flow {
    /// The displacement at a point between pixels.
    pub fn at(&self, x: f32, y: f32) -> [f32; 2] {
        [self.u.linear(x, y), self.v.linear(x, y)]
    }

    pub(super) fn zero(width: usize, height: usize) -> Self {
        let zeros = Image::from_fn(width, height, |_, _| 0.0);
        Self { u: zeros.clone(), v: zeros }
    }

    /// The flow as seen on a level of the pyramid of `width` × `height` pixels: this one's own or the next
    /// finer.
    pub(super) fn on_level(self, width: usize, height: usize) -> Self {
        if width == self.u.width && height == self.u.height {
            return self;
        }
        // The pixel x of a level is centred at 2x + ½ of the next finer.
        let coarse = |fine: usize| (fine as f32 - 0.5) / 2.0;
        let doubled =
            |part: &Image| Image::from_fn(width, height, |x, y| 2.0 * part.linear(coarse(x), coarse(y)));
        Self { u: doubled(&self.u), v: doubled(&self.v) }
    }
}
