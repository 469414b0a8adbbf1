// SPDX-License-Identifier: MIT OR Apache-2.0

//! Rendered pictures, the sensor that turns them into bytes, and the colour spaces of video.

use super::texture::Colour;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// A rendered picture: colours 0 to 1 (more where it is overexposed), row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The colours.
    pub colours: Vec<Colour>,
}

/// A frame as a camera gives it: 8-bit red, green, blue, interleaved, row by row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The bytes: 3 a pixel.
    pub rgb: Vec<u8>,
}

impl Picture {
    /// A picture of `width` × `height` colours.
    pub fn new(width: usize, height: usize, colours: Vec<Colour>) -> Self {
        debug_assert_eq!(colours.len(), width * height);
        Self { width, height, colours }
    }

    /// Rows become columns.
    pub fn transposed(&self) -> Self {
        let (width, height) = (self.height, self.width);
        let colours = (0..width * height)
            .map(|index| self.colours[(index % width) * self.width + index / width])
            .collect();
        Self { width, height, colours }
    }

    /// The brightness of each pixel in grey levels, 0 to 255, not rounded.
    pub fn grey(&self) -> Vec<f32> {
        self.colours.iter().map(|colour| 255.0 * brightness(*colour)).collect()
    }

    /// What a sensor makes of it: Gaussian noise of `sigma` grey levels in each channel, rounded.
    /// The noise is determined by the seed.
    pub fn sense(&self, sigma: f32, seed: u64) -> Frame {
        let mut rgb = vec![0; 3 * self.colours.len()];
        let rows = rgb.par_chunks_mut(3 * self.width).zip(self.colours.par_chunks(self.width));
        rows.enumerate().for_each(|(row, (bytes, colours))| {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            random.set_stream(row as u64);
            for (byte, value) in bytes.iter_mut().zip(colours.as_flattened()) {
                let noise: f32 = if sigma > 0.0 { StandardNormal.sample(&mut random) } else { 0.0 };
                *byte = (255.0 * value + sigma * noise).round() as u8;
            }
        });
        Frame { width: self.width, height: self.height, rgb }
    }
}

/// BT.709 luma weights.
fn brightness([r, g, b]: Colour) -> f32 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

/// A frame as planes of luma and halved chroma (BT.709, limited range, chroma sited at the left).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Planes {
    /// Luma, one byte a pixel.
    pub y: Vec<u8>,
    /// Blue difference, one byte for 2 × 2 pixels.
    pub u: Vec<u8>,
    /// Red difference, one byte for 2 × 2 pixels.
    pub v: Vec<u8>,
}

impl Frame {
    /// The colour of a pixel, 0 to 1.
    fn colour(&self, x: usize, y: usize) -> Colour {
        let start = 3 * (y * self.width + x);
        [0, 1, 2].map(|channel| f32::from(self.rgb[start + channel]) / 255.0)
    }

    /// The frame as a picture.
    pub fn picture(&self) -> Picture {
        let colours = self.rgb.chunks_exact(3);
        let colours = colours.map(|rgb| [0, 1, 2].map(|channel| f32::from(rgb[channel]) / 255.0));
        Picture::new(self.width, self.height, colours.collect())
    }

    /// The mean with another frame of the same size, which has the weight `share`.
    pub fn blended(&self, other: &Self, share: f64) -> Self {
        let mean = |(a, b): (&u8, &u8)| (f64::from(*a) * (1.0 - share) + f64::from(*b) * share).round() as u8;
        Self { rgb: self.rgb.iter().zip(&other.rgb).map(mean).collect(), ..*self }
    }

    /// The luma that video carries: 16 to 235.
    pub fn luma(&self) -> Vec<u8> {
        let luma = |rgb: &[u8]| {
            let colour = [0, 1, 2].map(|channel| f32::from(rgb[channel]) / 255.0);
            (16.0 + 219.0 * brightness(colour)).round() as u8
        };
        self.rgb.chunks_exact(3).map(luma).collect()
    }

    /// The planes of 4:2:0 video.
    pub fn planes(&self) -> Planes {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let chroma = |index: usize| {
            let (x, y) = (2 * (index % width), 2 * (index / width));
            // Sited on the left column: 1-2-1 across, the mean of two rows down.
            let taps = [(x.saturating_sub(1), 0.125), (x, 0.25), ((x + 1).min(self.width - 1), 0.125)];
            let mut mean = [0.0f32; 3];
            for row in [y, (y + 1).min(self.height - 1)] {
                for (column, weight) in taps {
                    let colour = self.colour(column, row);
                    mean = [0, 1, 2].map(|channel| mean[channel] + weight * colour[channel]);
                }
            }
            let luma = brightness(mean);
            let byte = |difference: f32, span: f32| (128.0 + 224.0 * difference / span).round() as u8;
            (byte(mean[2] - luma, 1.8556), byte(mean[0] - luma, 1.5748))
        };
        let (u, v) = (0..width * height).map(chroma).unzip();
        Planes { y: self.luma(), u, v }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(colour: Colour) -> Picture {
        Picture::new(64, 48, vec![colour; 64 * 48])
    }

    #[test]
    fn noise_has_its_strength_and_depends_on_the_seed() {
        let frame = flat([0.5; 3]).sense(4.0, 1);
        let errors = frame.rgb.iter().map(|byte| (f64::from(*byte) - 127.5).powi(2));
        let sigma = (errors.sum::<f64>() / frame.rgb.len() as f64).sqrt();
        assert!((sigma - 4.0).abs() < 0.15, "{sigma}");
        assert_eq!(frame, flat([0.5; 3]).sense(4.0, 1));
        assert_ne!(frame, flat([0.5; 3]).sense(4.0, 2));
    }

    #[test]
    fn primaries_have_their_bt709_codes() {
        let codes = |colour| {
            let planes = flat(colour).sense(0.0, 0).planes();
            (planes.y[70], planes.u[40], planes.v[40])
        };
        assert_eq!(codes([1.0; 3]), (235, 128, 128));
        assert_eq!(codes([0.0; 3]), (16, 128, 128));
        assert_eq!(codes([1.0, 0.0, 0.0]), (63, 102, 240));
        assert_eq!(codes([0.0, 1.0, 0.0]), (173, 42, 26));
        assert_eq!(codes([0.0, 0.0, 1.0]), (32, 240, 118));
    }

    #[test]
    fn transposing_swaps_rows_and_columns() {
        let picture = Picture::new(3, 2, (0..6).map(|i| [i as f32; 3]).collect());
        let turned = picture.transposed();
        assert_eq!((turned.width, turned.height), (2, 3));
        assert_eq!(turned.colours[1], [3.0; 3]);
        assert_eq!(turned.transposed(), picture);
    }
}
