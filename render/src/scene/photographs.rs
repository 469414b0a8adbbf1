// SPDX-License-Identifier: MIT OR Apache-2.0

//! Textures made from a folder of photographs.

use super::texture::Texture;
use anyhow::{Context, Result, ensure};
use image::imageops::FilterType;
use std::path::{Path, PathBuf};

/// The most texels along a side, as in the finest of the procedural textures.
const MOST_TEXELS: u32 = 1024;

/// One texture for each picture (`.jpg`, `.jpeg`, `.png`) of a folder, in the order of their names:
/// the square in its middle, shrunk to the next power of two, 1024 at most.
///
/// # Errors
/// If the folder cannot be read or holds no picture, or if one of its pictures is damaged.
pub fn load(folder: &Path) -> Result<Vec<Texture>> {
    let pictures =
        pictures(folder).with_context(|| format!("cannot read the folder {}", folder.display()))?;
    ensure!(!pictures.is_empty(), "no picture (.jpg, .jpeg, .png) in {}", folder.display());
    pictures.iter().map(|file| texture(file)).collect()
}

fn pictures(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let entries = folder.read_dir()?.map(|entry| Ok(entry?.path()));
    let mut files = entries.collect::<std::io::Result<Vec<_>>>()?;
    let is_picture = |file: &PathBuf| {
        let extension = file.extension().map(|extension| extension.to_ascii_lowercase());
        extension.is_some_and(|extension| ["jpg", "jpeg", "png"].iter().any(|known| extension == *known))
    };
    files.retain(is_picture);
    files.sort();
    Ok(files)
}

fn texture(file: &Path) -> Result<Texture> {
    let picture = image::open(file).with_context(|| format!("cannot read the picture {}", file.display()))?;
    let (width, height) = (picture.width(), picture.height());
    let side = width.min(height);
    ensure!(side > 0, "the picture {} is empty", file.display());
    let size = (1 << side.ilog2()).min(MOST_TEXELS);
    let square = picture.crop_imm((width - side) / 2, (height - side) / 2, side, side);
    let texels = square.resize_exact(size, size, FilterType::Triangle).into_rgb32f();
    Ok(Texture::new(size as usize, texels.pixels().map(|texel| texel.0).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, RgbImage};

    #[test]
    fn a_picture_becomes_the_square_in_its_middle() {
        let folder = tempfile::tempdir().unwrap();
        // Red beside the middle square, which is green above and blue below.
        let picture = RgbImage::from_fn(70, 40, |x, y| match (x, y) {
            (15..55, 0..20) => Rgb([0, 255, 0]),
            (15..55, _) => Rgb([0, 0, 255]),
            _ => Rgb([255, 0, 0]),
        });
        picture.save(folder.path().join("b.PNG")).unwrap();
        RgbImage::from_pixel(8, 9, Rgb([51, 102, 153])).save(folder.path().join("a.png")).unwrap();
        std::fs::write(folder.path().join("readme.txt"), "not a picture").unwrap();
        let [even, halves] = &load(folder.path()).unwrap()[..] else { panic!("two textures") };
        assert_eq!((even.size(), halves.size()), (8, 32));
        let colour = |texture: &Texture, v| texture.sample(0.5, v, [1e-6, 0.0], [0.0, 1e-6]);
        assert_eq!(colour(even, 0.3), [0.2, 0.4, 0.6]);
        assert_eq!(colour(halves, 0.2), [0.0, 1.0, 0.0]);
        assert_eq!(colour(halves, 0.8), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn a_folder_without_pictures_is_named_in_the_error() {
        let folder = tempfile::tempdir().unwrap();
        let error = load(folder.path()).unwrap_err().to_string();
        assert!(error.contains(&folder.path().display().to_string()) && error.contains("no picture"));
        let error = load(&folder.path().join("missing")).unwrap_err().to_string();
        assert!(error.contains("missing"));
    }

    #[test]
    fn a_damaged_picture_is_named_in_the_error() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("broken.jpg"), "not a picture").unwrap();
        assert!(load(folder.path()).unwrap_err().to_string().contains("broken.jpg"));
    }
}
