// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the pads take, and video formats → views of image planes.
//!
//! Views are not written down format by format: GStreamer describes each format by its components,
//! and components that lie side by side in each pixel make one view. A new format of 8, 10, 12 or
//! 16 bits a sample, in bytes or in little-endian words, is one line in [`FORMATS`].

use gst::glib;
use gst_video::prelude::*;
use gst_video::{
    VideoCapsBuilder, VideoFormat, VideoFrameRef, VideoInfo, VideoMeta, VideoOverlayCompositionMeta,
};
use rsrectify::plane::{Luma, Plane, PlaneLayout, PlaneMut, SampleFormat};
use rsrectify::warp::{Fill, SampleGrid};

/// The formats that can be rectified, the most usual first.
pub const FORMATS: [VideoFormat; 64] = [
    VideoFormat::I420,
    VideoFormat::Nv12,
    VideoFormat::Yv12,
    VideoFormat::Nv21,
    VideoFormat::Y42b,
    VideoFormat::Nv16,
    VideoFormat::Y444,
    VideoFormat::Yuy2,
    VideoFormat::Uyvy,
    VideoFormat::I42010le,
    VideoFormat::P01010le,
    VideoFormat::I42210le,
    VideoFormat::Y44410le,
    VideoFormat::I42012le,
    VideoFormat::P012Le,
    VideoFormat::I42212le,
    VideoFormat::Y44412le,
    VideoFormat::P016Le,
    VideoFormat::Y44416le,
    VideoFormat::Ayuv,
    VideoFormat::Bgrx,
    VideoFormat::Bgra,
    VideoFormat::Rgbx,
    VideoFormat::Rgba,
    VideoFormat::Xrgb,
    VideoFormat::Argb,
    VideoFormat::Xbgr,
    VideoFormat::Abgr,
    VideoFormat::Bgr,
    VideoFormat::Rgb,
    VideoFormat::Gray8,
    VideoFormat::Gray16Le,
    VideoFormat::Vuya,
    VideoFormat::Nv61,
    VideoFormat::Nv24,
    VideoFormat::Yvyu,
    VideoFormat::Vyuy,
    VideoFormat::V308,
    VideoFormat::Iyu2,
    VideoFormat::Y41b,
    VideoFormat::Yuv9,
    VideoFormat::Yvu9,
    VideoFormat::Gbr,
    VideoFormat::Rgbp,
    VideoFormat::Bgrp,
    // Alpha in a plane of its own.
    VideoFormat::A420,
    VideoFormat::Gbra,
    VideoFormat::A42010le,
    VideoFormat::A42210le,
    VideoFormat::A44410le,
    VideoFormat::Gbra10le,
    VideoFormat::Gbra12le,
    // Packed words and planes of red, green and blue of more than 8 bits.
    VideoFormat::Y210,
    VideoFormat::Y212Le,
    VideoFormat::V216,
    VideoFormat::Y412Le,
    VideoFormat::Gbr10le,
    VideoFormat::Gbr12le,
    VideoFormat::Ayuv64,
    VideoFormat::Argb64,
    VideoFormat::Argb64Le,
    VideoFormat::Rgba64Le,
    VideoFormat::Bgra64Le,
    VideoFormat::Abgr64Le,
];

/// Longest side of a frame in pixels. No camera comes near it; caps that claim more are a mistake
/// which would be paid for in memory.
const LONGEST_SIDE: i32 = 32_768;

/// Most components that a pixel can have.
const COMPONENTS: usize = 4;

/// Weights of red, green and blue in the luma that is analysed (BT.601; any sensible weights do).
const LUMA_WEIGHTS: [f32; 3] = [0.299, 0.587, 0.114];

/// The component of a pixel that stands for its luma where there is none.
const GREEN: usize = 1;

/// What the pads take: frames in system memory.
///
/// Overlays that travel beside the picture are kept. Fields in buffers of their own pass through,
/// as other interlaced video does.
pub fn template_caps() -> gst::Caps {
    // ARGB64 and AYUV64 are words in the order of the machine.
    let is_read = |format: &VideoFormat| {
        cfg!(target_endian = "little") || !matches!(format, VideoFormat::Argb64 | VideoFormat::Ayuv64)
    };
    let sides = 1..=LONGEST_SIDE;
    let frames = VideoCapsBuilder::new().format_list(FORMATS.into_iter().filter(is_read));
    let frames = frames.width_range(sides.clone()).height_range(sides).build();
    let with = |features: &[&glib::GStr]| {
        let mut caps = frames.clone();
        caps.make_mut().set_features_simple(Some(gst::CapsFeatures::new(features.iter().copied())));
        caps
    };
    let mut fields = with(&[gst_video::CAPS_FEATURE_FORMAT_INTERLACED]);
    fields.make_mut().set("interlace-mode", "alternate");
    let overlays = with(&[
        gst::CAPS_FEATURE_MEMORY_SYSTEM_MEMORY,
        gst_video::CAPS_FEATURE_META_GST_VIDEO_OVERLAY_COMPOSITION,
    ]);
    let mut caps = frames;
    caps.merge(overlays);
    caps.merge(fields);
    caps
}

/// Lets `decide` settle an allocation query and keeps what the query has on overlays: GStreamer's base
/// class takes out what it does not know to be kept, and upstream would draw overlays into the frames.
pub fn keep_overlay_support<E>(
    query: &mut gst::query::Allocation,
    decide: impl FnOnce(&mut gst::query::Allocation) -> Result<(), E>,
) -> Result<(), E> {
    let index = query.find_allocation_meta::<VideoOverlayCompositionMeta>();
    let meta = index.and_then(|index| query.allocation_metas().nth(index as usize));
    let parameters = meta.map(|(_, parameters)| parameters.map(ToOwned::to_owned));
    decide(query)?;
    if let Some(parameters) = parameters
        && query.find_allocation_meta::<VideoOverlayCompositionMeta>().is_none()
    {
        query.add_allocation_meta::<VideoOverlayCompositionMeta>(parameters.as_deref());
    }
    Ok(())
}

/// Samples of the frame that are warped together: a plane, or some components of a packed one.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// The buffer's plane.
    pub plane: u32,
    /// Bytes from the plane's start to the first sample.
    pub offset: usize,
    /// The samples; the stride is that of the buffer at hand.
    layout: PlaneLayout,
    /// Where the samples lie in the frame.
    pub grid: SampleGrid,
    /// The component in each channel; `None` for padding.
    components: [Option<usize>; COMPONENTS],
}

/// How a stream's frames are cut into views.
#[derive(Clone, Debug)]
pub struct FrameViews {
    info: VideoInfo,
    views: Vec<View>,
    luma: View,
    luma_weights: [f32; COMPONENTS],
}

impl FrameViews {
    /// The views of frames described by `info`.
    pub fn new(info: &VideoInfo) -> Option<Self> {
        let views: Vec<View> = (0..info.n_planes()).flat_map(|plane| plane_views(info, plane)).collect();
        let brightest = if info.is_rgb() { GREEN } else { 0 };
        let luma = views.iter().find(|view| view.components.contains(&Some(brightest)))?.clone();
        let has_all_colours = info.is_rgb() && (0..3).all(|c| luma.components.contains(&Some(c)));
        let luma_weights = luma.components.map(|component| match component {
            Some(c) if has_all_colours => LUMA_WEIGHTS.get(c).copied().unwrap_or(0.0),
            Some(c) if c == brightest => 1.0,
            _ => 0.0,
        });
        Some(Self { info: info.clone(), views, luma, luma_weights })
    }

    /// What the frames look like.
    pub fn info(&self) -> &VideoInfo {
        &self.info
    }

    /// The views that together make the whole frame.
    pub fn all(&self) -> &[View] {
        &self.views
    }

    /// Rows of a plane.
    pub fn plane_height(&self, plane: u32) -> Option<usize> {
        self.views.iter().find(|view| view.plane == plane).map(|view| view.layout.height)
    }

    /// Bytes from the beginning of a row of a plane to the end of its last sample, and of those the ones at the beginning
    /// that are all samples of pixels.
    pub fn row_bytes(&self, plane: u32) -> Option<(usize, usize)> {
        let views = || self.views.iter().filter(|view| view.plane == plane);
        let ends = views().map(|view| {
            let row = PlaneLayout { height: 1, ..view.layout };
            row.required_bytes().map_or(0, |bytes| view.offset + bytes)
        });
        let (least, most) = (ends.clone().min()?, ends.max()?);
        let samples = |view: &View| view.layout.width * view.layout.channels * view.layout.format.bytes();
        Some((most, if views().map(samples).sum::<usize>() == most { most } else { least }))
    }

    /// The luma of a mapped frame; green where red, green and blue lie in planes of their own.
    pub fn luma<'a>(&self, frame: &'a VideoFrameRef<&gst::BufferRef>) -> Option<Luma<'a>> {
        Luma::weighted(self.luma.plane(frame)?, self.luma_weights).ok()
    }

    /// Whether a mapped frame holds all samples.
    pub fn is_whole(&self, frame: &VideoFrameRef<&gst::BufferRef>) -> bool {
        self.views.iter().all(|view| view.layout_in(frame).is_some())
    }

    /// An 0xAARRGGBB colour as samples of the views, by the stream's colour matrix and range.
    pub fn fill(&self, argb: u32) -> Fill {
        let components = self.components(argb);
        let mut fill = Fill::default();
        for (samples, view) in fill.0.iter_mut().zip(&self.views) {
            *samples = view.fill(&components);
        }
        fill
    }

    /// The colour as one sample value a component.
    fn components(&self, argb: u32) -> [u16; COMPONENTS] {
        let [a, r, g, b] = argb.to_be_bytes().map(|byte| f64::from(byte) / 255.0);
        let colorimetry = self.info.colorimetry();
        let range = match colorimetry.range() {
            gst_video::VideoColorRange::Range0_255 => gst_video::VideoColorRange::Range0_255,
            _ if self.info.is_rgb() => gst_video::VideoColorRange::Range0_255,
            _ => gst_video::VideoColorRange::Range16_235,
        };
        let components = if self.info.is_rgb() {
            [r, g, b, a]
        } else {
            let (kr, kb) = colorimetry.matrix().kr_kb().unwrap_or((0.299, 0.114));
            let y = kr * r + (1.0 - kr - kb) * g + kb * b;
            [y, 0.5 * (b - y) / (1.0 - kb), 0.5 * (r - y) / (1.0 - kr), a]
        };
        let (offsets, scales) = self.info.format_info().range_offsets(range);
        std::array::from_fn(|c| {
            let value = f64::from(offsets[c]) + f64::from(scales[c]) * components[c];
            value.round().clamp(0.0, f64::from(self.luma.layout.format.max_value())) as u16
        })
    }
}

impl View {
    /// The view's samples in a mapped frame; `None` where the buffer does not hold them.
    pub fn plane<'a>(&self, frame: &'a VideoFrameRef<&gst::BufferRef>) -> Option<Plane<'a>> {
        let layout = self.layout_in(frame)?;
        Plane::new(frame.plane_data(self.plane).ok()?.get(self.offset..)?, layout).ok()
    }

    /// The view's samples in a frame mapped for writing; `None` where the buffer does not hold them.
    pub fn plane_mut<'a>(&self, frame: &'a mut VideoFrameRef<&mut gst::BufferRef>) -> Option<PlaneMut<'a>> {
        let layout = self.layout_in(frame)?;
        PlaneMut::new(frame.plane_data_mut(self.plane).ok()?.get_mut(self.offset..)?, layout).ok()
    }

    /// The value in each channel of a view, from one value a component; padding is opaque white.
    fn fill(&self, components: &[u16; COMPONENTS]) -> [u16; COMPONENTS] {
        self.components.map(|component| component.map_or(self.layout.format.max_value(), |c| components[c]))
    }

    /// The samples with the stride of this frame.
    ///
    /// A `GstVideoMeta` is somebody's claim: its strides and offsets are held against the buffer's
    /// size before a slice is made of them.
    fn layout_in<F: VideoFrameExt>(&self, frame: &F) -> Option<PlaneLayout> {
        let plane = self.plane as usize;
        let stride = usize::try_from(*frame.plane_stride().get(plane)?).ok()?;
        let layout = PlaneLayout { stride, ..self.layout };
        let start = *frame.plane_offset().get(plane)?;
        let end = start.checked_add(self.offset)?.checked_add(layout.required_bytes()?)?;
        holds(frame.buffer(), start..end).then_some(layout)
    }
}

/// Whether these bytes of a mapped frame can be read.
///
/// Where a meta tells the planes' places, GStreamer maps of each the one memory that it begins in.
fn holds(buffer: &gst::BufferRef, bytes: std::ops::Range<usize>) -> bool {
    if bytes.is_empty() || bytes.end > buffer.size() {
        return bytes.is_empty();
    }
    buffer.n_memory() < 2
        || buffer.meta::<VideoMeta>().is_none()
        || buffer.find_memory(bytes).is_some_and(|(memories, _)| memories.len() == 1)
}

/// The views of one plane of a buffer.
fn plane_views(info: &VideoInfo, plane: u32) -> Vec<View> {
    let components: Vec<u8> =
        (0..info.n_components() as u8).filter(|&c| info.comp_plane(c) == plane).collect();
    let Some((&first, rest)) = components.split_first() else { return Vec::new() };
    let pixel = |c: u8| (info.comp_pstride(c), subsampling(info, c));
    if rest.iter().all(|&c| pixel(c) == pixel(first)) {
        vec![view(info, plane, &components, 0, None)]
    } else {
        // Luma and chroma of different width share the plane (YUY2, UYVY): a view for each.
        let single = |c: &u8| view(info, plane, &[*c], offset(info, *c), Some(1));
        components.iter().map(single).collect()
    }
}

/// A view of `components`, which are alike, from byte `offset` of each row on. It takes every
/// sample of a pixel, padding too, where `channels` does not say how many.
fn view(info: &VideoInfo, plane: u32, components: &[u8], offset: usize, channels: Option<usize>) -> View {
    let first = components[0];
    let format = sample_format(info, first);
    let step = info.comp_pstride(first) as usize / format.bytes();
    let layout = PlaneLayout {
        width: info.comp_width(first) as usize,
        height: info.comp_height(first) as usize,
        stride: 0,
        step,
        channels: channels.unwrap_or(step),
        format,
    };
    let at = |channel: usize| {
        let byte = offset + channel * format.bytes();
        components.iter().find(|&&c| self::offset(info, c) == byte).map(|&c| usize::from(c))
    };
    View { plane, offset, layout, grid: grid(info, first), components: std::array::from_fn(at) }
}

/// Byte of a component's first sample in its plane.
///
/// GStreamer's own description (1.22) lacks the offsets of some packed words, swaps the chroma of
/// VYUY, and counts words instead of bytes in P010 and its kin.
fn offset(info: &VideoInfo, component: u8) -> usize {
    let known = match info.format() {
        VideoFormat::Y210 | VideoFormat::Y212Le => [0, 2, 6, 0],
        VideoFormat::Y412Le => [2, 0, 4, 6],
        VideoFormat::Vyuy => [1, 2, 0, 0],
        _ => {
            let (offset, bytes) =
                (info.comp_poffset(component) as usize, sample_format(info, component).bytes());
            return if offset % bytes == 0 { offset } else { offset * bytes };
        }
    };
    known.get(usize::from(component)).copied().unwrap_or(0)
}

fn sample_format(info: &VideoInfo, component: u8) -> SampleFormat {
    let shift = info.format_info().shift().get(usize::from(component)).copied().unwrap_or(0);
    match (info.comp_depth(component), shift) {
        // Described as if its bits were the low ones of the word.
        (10, _) if info.format() == VideoFormat::Y210 => SampleFormat::U10_HIGH,
        (10, 0) => SampleFormat::U10,
        (10, _) => SampleFormat::U10_HIGH,
        (12, 0) => SampleFormat::U12,
        (12, _) => SampleFormat::U12_HIGH,
        (16, _) => SampleFormat::U16,
        _ => SampleFormat::U8,
    }
}

/// log2 of the frame pixels to one sample, in x and y.
fn subsampling(info: &VideoInfo, component: u8) -> [u32; 2] {
    let format = info.format_info();
    [format.w_sub(), format.h_sub()].map(|sub| sub.get(usize::from(component)).copied().unwrap_or(0))
}

/// Where a component's samples lie. Chroma that says nothing of its siting has MPEG-2's: on the
/// luma column, between two luma rows.
fn grid(info: &VideoInfo, component: u8) -> SampleGrid {
    use gst_video::VideoChromaSite;
    let site = match info.chroma_site() {
        site if site.is_empty() => VideoChromaSite::MPEG2,
        site => site,
    };
    let cosited = [site.contains(VideoChromaSite::H_COSITED), site.contains(VideoChromaSite::V_COSITED)];
    let scale = subsampling(info, component).map(|sub| f64::from(1 << sub));
    let offset = std::array::from_fn(|axis| if cosited[axis] { 0.0 } else { (scale[axis] - 1.0) / 2.0 });
    SampleGrid { scale, offset }
}

#[cfg(test)]
#[path = "formats_tests.rs"]
mod tests;
