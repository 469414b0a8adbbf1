// SPDX-License-Identifier: MIT OR Apache-2.0

//! Band-limited textures: a square picture and its halved copies (a mip pyramid).
//!
//! L. Williams, *Pyramidal parametrics*, SIGGRAPH 1983.

use super::noise::split;
use std::sync::Arc;

/// A colour: red, green, blue; 0 is black, 1 is white.
pub type Colour = [f32; 3];

/// The widest footprint, in multiples of the narrow side, that is sampled without blur.
const MAX_ANISOTROPY: f32 = 4.0;

/// A stored colour, 0 to 255; the fourth byte is unused. Lookups are bound by memory, so that
/// texels of four bytes serve better than of sixteen; the rounding is part of the scene.
type Texel = [u8; 4];

/// A square picture that repeats over the plane, with its halved copies.
#[derive(Clone, Debug)]
pub struct Texture {
    /// Shared by the scenes that have it.
    levels: Arc<[Level]>,
}

#[derive(Clone, Debug)]
struct Level {
    size: usize,
    texels: Vec<Texel>,
}

impl Texture {
    /// Builds the pyramid over `texels`, row by row, `size` × `size` of them.
    ///
    /// # Panics
    /// If `size` is not a power of two or does not fit the number of texels.
    pub fn new(size: usize, texels: Vec<Colour>) -> Self {
        assert!(size.is_power_of_two() && texels.len() == size * size, "a texture is square, side 2^n");
        let byte = |channel: f32| (255.0 * channel + 0.5) as u8;
        let texels = texels.into_iter().map(|[r, g, b]| [byte(r), byte(g), byte(b), 0]).collect();
        let mut levels = vec![Level { size, texels }];
        while let Some(level) = levels.last().filter(|level| level.size > 1) {
            let half = level.halved();
            levels.push(half);
        }
        Self { levels: levels.into() }
    }

    /// The same texture with its contrast, the differences from its mean colour, scaled by `share`.
    pub fn faded(&self, share: f32) -> Self {
        let colour = |texel: &Texel| [0, 1, 2].map(|channel| f32::from(texel[channel]) / 255.0);
        let [finest, .., coarsest] = &self.levels[..] else { return self.clone() };
        let mean = colour(&coarsest.texels[0]);
        let fade = |texel| add_scaled(mean.map(|channel| channel * (1.0 - share)), colour(texel), share);
        Self::new(finest.size, finest.texels.iter().map(fade).collect())
    }

    /// Texels along one side of the finest level.
    pub fn size(&self) -> usize {
        self.levels[0].size
    }

    /// The colour at (u, v), 1 being one repetition, seen through a footprint spanned by two
    /// vectors given in the same units.
    ///
    /// The narrow side of the footprint chooses the pyramid level; the long side is walked with as
    /// many lookups as it is longer, four at most.
    pub fn sample(&self, u: f32, v: f32, across: [f32; 2], along: [f32; 2]) -> Colour {
        let length = |side: [f32; 2]| (side[0] * side[0] + side[1] * side[1]).sqrt();
        let (length_a, length_b) = (length(across), length(along));
        let (major, long) = if length_a > length_b { (across, length_a) } else { (along, length_b) };
        let area = (across[0] * along[1] - across[1] * along[0]).abs();
        let narrow = (area / long.max(1e-12)).max(long / MAX_ANISOTROPY);
        let taps = (long / narrow.max(1e-12) + 0.5).clamp(1.0, MAX_ANISOTROPY) as usize as f32;
        let level = (narrow * self.size() as f32).max(1.0).log2();
        let mut sum = [0.0; 4];
        for tap in 0..taps as usize {
            let step = (tap as f32 + 0.5) / taps - 0.5;
            let texel = self.trilinear(u + step * major[0], v + step * major[1], level);
            sum = add_scaled(sum, texel, 1.0 / taps);
        }
        let [r, g, b, _] = sum;
        [r / 255.0, g / 255.0, b / 255.0]
    }

    fn trilinear(&self, u: f32, v: f32, level: f32) -> [f32; 4] {
        let coarsest = self.levels.len() - 1;
        let fine = (level as usize).min(coarsest);
        let share = (level - fine as f32).clamp(0.0, 1.0);
        let colour = self.levels[fine].bilinear(u, v);
        if share == 0.0 || fine == coarsest {
            return colour;
        }
        add_scaled(add_scaled([0.0; 4], colour, 1.0 - share), self.levels[fine + 1].bilinear(u, v), share)
    }
}

impl Level {
    fn halved(&self) -> Self {
        let size = self.size / 2;
        let texel = |index: usize| {
            let (x, y) = (2 * (index % size), 2 * (index / size));
            let at = |channel: usize, i: usize, j: usize| {
                u16::from(self.texels[(y + j) * self.size + x + i][channel])
            };
            let mean = |c: usize| (at(c, 0, 0) + at(c, 1, 0) + at(c, 0, 1) + at(c, 1, 1) + 2) / 4;
            std::array::from_fn(|channel| mean(channel) as u8)
        };
        Self { size, texels: (0..size * size).map(texel).collect() }
    }

    fn bilinear(&self, u: f32, v: f32) -> [f32; 4] {
        let (x0, fx) = split(u * self.size as f32 - 0.5);
        let (y0, fy) = split(v * self.size as f32 - 0.5);
        let wrap = |index: i32| index as usize & (self.size - 1);
        let (left, right) = (wrap(x0), wrap(x0 + 1));
        let (top, bottom) = (wrap(y0) * self.size, wrap(y0 + 1) * self.size);
        let texel = |index: usize| self.texels[index].map(f32::from);
        let sum = add_scaled([0.0; 4], texel(top + left), (1.0 - fx) * (1.0 - fy));
        let sum = add_scaled(sum, texel(top + right), fx * (1.0 - fy));
        let sum = add_scaled(sum, texel(bottom + left), (1.0 - fx) * fy);
        add_scaled(sum, texel(bottom + right), fx * fy)
    }
}

/// sum + weight · value, channel by channel.
pub fn add_scaled<const N: usize>(sum: [f32; N], value: [f32; N], weight: f32) -> [f32; N] {
    std::array::from_fn(|channel| sum[channel] + weight * value[channel])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checkers(size: usize) -> Texture {
        let grey = |i: usize| if (i % size + i / size).is_multiple_of(2) { 1.0 } else { 0.0 };
        Texture::new(size, (0..size * size).map(|i| [grey(i); 3]).collect())
    }

    #[test]
    fn texel_centres_are_exact_and_the_picture_repeats() {
        let texture = checkers(8);
        let point = [1e-6, 0.0];
        assert_eq!(texture.sample(0.5 / 8.0, 0.5 / 8.0, point, [0.0, 1e-6])[0], 1.0);
        assert_eq!(texture.sample(1.5 / 8.0 - 3.0, 0.5 / 8.0 + 2.0, point, [0.0, 1e-6])[0], 0.0);
    }

    #[test]
    fn a_faded_texture_keeps_its_mean() {
        let faded = checkers(8).faded(0.1);
        let texel = |u: f32| faded.sample(u, 0.5 / 8.0, [1e-6, 0.0], [0.0, 1e-6])[0];
        assert!((texel(0.5 / 8.0) - 0.55).abs() < 0.005 && (texel(1.5 / 8.0) - 0.45).abs() < 0.005);
    }

    #[test]
    fn a_wide_footprint_sees_the_mean() {
        let texture = checkers(8);
        for u in [0.1, 0.37, 0.9] {
            let colour = texture.sample(u, 0.2, [0.25, 0.0], [0.0, 0.25]);
            assert!((colour[1] - 0.5).abs() < 0.003);
        }
    }

    #[test]
    fn a_slanted_footprint_keeps_detail_across_its_length() {
        let size = 64;
        let stripes = |i: usize| [if (i / size / 4).is_multiple_of(2) { 1.0 } else { 0.0 }; 3];
        let texture = Texture::new(size, (0..size * size).map(stripes).collect());
        let along_stripes = texture.sample(0.5, 2.0 / 64.0, [4.0 / 64.0, 0.0], [0.0, 1.0 / 64.0]);
        assert!(along_stripes[0] > 0.99);
    }
}
