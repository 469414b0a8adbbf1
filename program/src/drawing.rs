// SPDX-License-Identifier: MIT OR Apache-2.0

//! SVG → pixels, the same on every machine: the font is in the program.

use anyhow::{Context, Result, anyhow};
use resvg::tiny_skia::{Pixmap, PixmapMut, Transform};
use resvg::usvg::{Options, Tree};
use std::sync::Arc;

/// DejaVu Sans: Latin, Greek and Cyrillic.
const FONT: &[u8] = include_bytes!("../fonts/DejaVuSans.ttf");
const FONT_FAMILY: &str = "DejaVu Sans";

/// A colour: red, green, blue.
pub type Colour = [u8; 3];

/// Colours that people with colour-blindness tell apart (M. Okabe and K. Ito, *Color universal design*, 2008).
pub const BLUE: Colour = [0, 114, 178];
pub const VERMILION: Colour = [213, 94, 0];
pub const GREEN: Colour = [0, 158, 115];
pub const PURPLE: Colour = [204, 121, 167];
pub const SKY_BLUE: Colour = [86, 180, 233];
pub const YELLOW: Colour = [240, 228, 66];

/// A colour as SVG has it.
pub fn hex([red, green, blue]: Colour) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

/// Renders SVG.
pub struct Renderer {
    options: Options<'static>,
}

impl Renderer {
    /// With the font that all text is set in.
    pub fn new() -> Self {
        let mut options = Options { font_family: FONT_FAMILY.to_owned(), ..Options::default() };
        let fonts = Arc::make_mut(&mut options.fontdb);
        fonts.load_font_data(FONT.to_vec());
        fonts.set_sans_serif_family(FONT_FAMILY);
        Self { options }
    }

    fn parse(&self, svg: &str) -> Result<Tree> {
        Tree::from_str(svg, &self.options).map_err(|error| anyhow!("the drawing is not SVG: {error}"))
    }

    /// Draws over a picture, pixel for pixel.
    pub fn draw(&self, svg: &str, picture: &mut PixmapMut<'_>) -> Result<()> {
        resvg::render(&self.parse(svg)?, Transform::identity(), picture);
        Ok(())
    }

    /// A PNG file with so many pixels to one of the SVG.
    pub fn png(&self, svg: &str, scale: f32) -> Result<Vec<u8>> {
        let tree = self.parse(svg)?;
        let size = tree.size().to_int_size().scale_by(scale).context("a picture without pixels")?;
        let mut picture = Pixmap::new(size.width(), size.height()).context("the picture is too large")?;
        resvg::render(&tree, Transform::from_scale(scale, scale), &mut picture.as_mut());
        picture.encode_png().context("the picture cannot be written as PNG")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_set_without_fonts_of_the_system() {
        let text = |text: &str| {
            let svg = format!(
                r#"<svg xmlns="http://www.w3.org/2000/svg" width="80" height="20"><text x="2" y="15" font-family="sans-serif" font-size="14">{text}</text></svg>"#
            );
            let mut picture = Pixmap::new(80, 20).unwrap();
            Renderer::new().draw(&svg, &mut picture.as_mut()).unwrap();
            picture.pixels().iter().map(|pixel| pixel.alpha()).collect::<Vec<_>>()
        };
        let dark = |pixels: Vec<u8>| pixels.into_iter().filter(|alpha| *alpha > 128).count();
        assert_eq!(dark(text("")), 0);
        assert!(dark(text("Wide text")) > 100);
        // What captions and names are made of looks like what is not in the font only if it is not.
        for sign in ["±", "×", "°", "−", "%", "é", "Ω", "Ж"] {
            assert_ne!(text(sign), text("漢"), "{sign}");
        }
        assert!(Renderer::new().png("no drawing", 1.0).is_err());
    }
}
