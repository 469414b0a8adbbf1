//! Dense optical flow: the motion of every pixel from one frame to another.
//!
//! After D. Sun, S. Roth, M. J. Black, *Secrets of Optical Flow Estimation and Their Principles*, CVPR
//! 2010, from which the paper of the method takes its correspondences. This is their *Classic* recipe
//! with a Charbonnier penalty: texture decomposition, a pyramid, on each level several warps with
//! cubic interpolation, and a 5 × 5 median of the flow after each. Unlike theirs, the energy is
//! convex from the start (no graduated non-convexity), the weights of a step in u and v are shared, the
//! sizes of the levels go by halves, each level has its own texture and the median is not weighted.
//!
//! A flow of 640 × 480 pixels takes about 0.7 s of one core (optimised for speed, without AVX): half of
//! it for 2 × 5 · 3 · 10 half-sweeps of the solver on the full level, a tenth for the median. It holds
//! some 25 numbers a pixel at a time, 30 MB.
//!
//! | module | what it holds |
//! |---|---|
//! | [`image`] | pictures of one channel: halving, interpolation, derivatives |
//! | [`texture`] | a picture less its large structure |
//! | [`board`] | a picture in the order of a chessboard, for the solver |
//! | [`solver`] | the robust energy around one warp, minimised |
//! | `estimate` | coarse to fine |
//! | [`median`] | the median filter |
//! | [`points`] | correspondences out of the flow |

pub mod board;
mod estimate;
pub mod image;
pub mod median;
pub mod points;
pub mod solver;
pub mod texture;

use image::Image;

/// Pixels that the shorter side of the coarsest level has at least.
const COARSEST: usize = 12;

/// A frame made ready for flow.
pub struct Prepared {
    /// The frame, in grey levels 0 to 255.
    pub luma: Image,
    /// The texture of the frame at full size, half, a quarter …. Each level has a texture of its own:
    /// halving that of the full size would leave the coarse levels, where large motions are found,
    /// without contrast.
    levels: Vec<Image>,
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
    /// The flow from one frame to another of the same size.
    ///
    /// # Panics
    /// Where the sizes differ.
    pub fn between(first: &Prepared, second: &Prepared) -> Self {
        let size = |frame: &Prepared| (frame.luma.width, frame.luma.height);
        assert_eq!(size(first), size(second), "flow between frames of different sizes");
        estimate::estimate(first, second)
    }

    /// The displacement at a point between pixels.
    pub fn at(&self, x: f32, y: f32) -> [f32; 2] {
        [self.u.linear(x, y), self.v.linear(x, y)]
    }

    fn zero(width: usize, height: usize) -> Self {
        let zeros = Image::from_fn(width, height, |_, _| 0.0);
        Self { u: zeros.clone(), v: zeros }
    }

    /// The flow as seen on a level of the pyramid of `width` × `height` pixels: this one's own or the next
    /// finer.
    fn on_level(self, width: usize, height: usize) -> Self {
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

#[cfg(test)]
mod tests;
