// SPDX-License-Identifier: MIT OR Apache-2.0

//! A frame and the pyramid of its texture.

use super::image::Image;
use super::texture;

/// Pixels that the shorter side of the coarsest level has at least.
const COARSEST: usize = 12;

/// A frame made ready for flow.
pub struct Prepared {
    /// The frame, in grey levels 0 to 255.
    pub luma: Image,
    /// The texture of the frame at full size, half, a quarter …. Each level has a texture of its own:
    /// halving that of the full size would leave the coarse levels, where large motions are found,
    /// without contrast.
    pub(super) levels: Vec<Image>,
}

impl Prepared {
    /// Makes a frame ready.
    pub fn new(luma: Image) -> Self {
        let mut greys = vec![luma.clone()];
        while let Some(half) =
            greys.last().map(Image::halved).filter(|half| half.width.min(half.height) >= COARSEST)
        {
            greys.push(half);
        }
        let levels = greys.iter().map(texture::of).collect();
        Self { luma, levels }
    }
}
