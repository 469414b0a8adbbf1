// SPDX-License-Identifier: MIT OR Apache-2.0

//! Before and after in one picture: where the pictures stand, and which is which.

use crate::drawing::Renderer;
use anyhow::{Context, Result};
use gst::prelude::*;
use gst_video::{
    VideoColorimetry, VideoFormat, VideoInfo, VideoMeta, VideoOverlayComposition, VideoOverlayFormatFlags,
    VideoOverlayRectangle, VideoTransferFunction,
};
use resvg::tiny_skia::Pixmap;
use std::sync::{Mutex, PoisonError};

/// Puts the pictures side by side, and draws over them.
pub const SIDE_BY_SIDE: &str = "compositor name=side background=black ! overlaycomposition name=labels";
/// Labels of the two pictures.
const LABELS: [&str; 2] = ["before", "after"];
/// Size of the letters, as a share of the shorter side of each picture, and the least in pixels that can be read.
const LETTERS: f64 = 0.045;
const LEAST_LETTERS: f64 = 10.0;
/// Width and height of a label, and its distance from the edges, in sizes of its letters.
const LABEL: [f64; 2] = [4.4, 1.6];
const MARGIN: f64 = 0.5;
/// Width of the line between the pictures, as a share of the size of the letters.
const LINE: f64 = 0.15;

/// Has an `overlaycomposition` draw the labels and the line between the pictures.
pub fn label(labels: &gst::Element) {
    // Of one size of the picture.
    let drawn: Mutex<Option<(VideoInfo, Option<VideoOverlayComposition>)>> = Mutex::default();
    labels.connect("draw", false, move |values| {
        let sample = values.get(1).and_then(|value| value.get::<gst::Sample>().ok());
        let info = sample.as_ref().and_then(|sample| VideoInfo::from_caps(sample.caps()?).ok())?;
        let mut drawn = drawn.lock().unwrap_or_else(PoisonError::into_inner);
        if drawn.as_ref().is_none_or(|(known, _)| *known != info) {
            let composition = draw(&info);
            if let Err(error) = &composition {
                log::warn!("the pictures are not labelled: {error:#}");
            }
            *drawn = Some((info, composition.ok()));
        }
        // No composition is none to draw.
        Some(drawn.as_ref().and_then(|(_, composition)| composition.clone()).to_value())
    });
}

/// What is drawn over two pictures of one size.
fn draw(info: &VideoInfo) -> Result<VideoOverlayComposition> {
    let [half, height] = [f64::from(info.width()) / 2.0, f64::from(info.height())];
    let letters = (LETTERS * half.min(height)).max(LEAST_LETTERS);
    let renderer = Renderer::new();
    let white = white(&info.colorimetry());
    let line = (LINE * letters).round().max(2.0);
    let middle = (half - line / 2.0).round();
    let mut rectangles =
        vec![rectangle(&renderer, &filled(white, [line, height]), [line, height], [middle, 0.0])?];
    let size = LABEL.map(|side| (side * letters).ceil());
    let margin = (MARGIN * letters).ceil();
    // In smaller pictures they would hide more than they tell.
    if size[0] + 2.0 * margin <= half && size[1] + 2.0 * margin <= height {
        for (text, left) in LABELS.iter().zip([0.0, half.floor()]) {
            let svg = text_on_dark(text, white, letters, size);
            rectangles.push(rectangle(&renderer, &svg, size, [left + margin, margin])?);
        }
    }
    Ok(VideoOverlayComposition::new(rectangles.iter())?)
}

/// The grey level that is seen as white: the brightest of the range for films, that of paper in HDR (ITU-R BT.2408).
fn white(colorimetry: &VideoColorimetry) -> u8 {
    let share = match colorimetry.transfer() {
        VideoTransferFunction::Smpte2084 => 0.58,
        VideoTransferFunction::AribStdB67 => 0.75,
        _ => 1.0,
    };
    (255.0 * share) as u8
}

fn svg(content: &str, [width, height]: [f64; 2]) -> String {
    format!(r#"<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}">{content}</svg>"#)
}

fn filled(white: u8, size: [f64; 2]) -> String {
    svg(&format!(r#"<rect width="100%" height="100%" fill="rgb({white},{white},{white})"/>"#), size)
}

fn text_on_dark(text: &str, white: u8, letters: f64, size: [f64; 2]) -> String {
    let [width, height] = size;
    let content = format!(
        r##"<rect width="{width}" height="{height}" rx="{:.1}" fill="#000" fill-opacity="0.6"/><text x="{:.1}" y="{:.1}" text-anchor="middle" font-family="sans-serif" font-size="{letters:.1}" fill="rgb({white},{white},{white})">{text}</text>"##,
        0.25 * letters,
        width / 2.0,
        height / 2.0 + 0.36 * letters,
    );
    svg(&content, size)
}

/// A drawing of a size, to be shown with its upper left corner at a pixel.
fn rectangle(renderer: &Renderer, svg: &str, size: [f64; 2], at: [f64; 2]) -> Result<VideoOverlayRectangle> {
    let [width, height] = size.map(|side| side as u32);
    let mut pixmap = Pixmap::new(width, height).context("a drawing without pixels")?;
    renderer.draw(svg, &mut pixmap.as_mut())?;
    // Overlays have the bytes of a word with alpha in its highest ones.
    let (format, order) = match cfg!(target_endian = "little") {
        true => (VideoFormat::Bgra, [2, 1, 0, 3]),
        false => (VideoFormat::Argb, [3, 0, 1, 2]),
    };
    let pixels = pixmap.data().as_chunks::<4>().0.iter();
    let bytes: Vec<u8> = pixels.flat_map(|pixel| order.map(|index: usize| pixel[index])).collect();
    let mut buffer = gst::Buffer::from_mut_slice(bytes);
    let writable = buffer.get_mut().context("a new buffer is shared")?;
    VideoMeta::add(writable, gst_video::VideoFrameFlags::empty(), format, width, height)?;
    let [x, y] = at.map(|place| place as i32);
    Ok(VideoOverlayRectangle::new_raw(
        &buffer,
        x,
        y,
        width,
        height,
        VideoOverlayFormatFlags::PREMULTIPLIED_ALPHA,
    ))
}
