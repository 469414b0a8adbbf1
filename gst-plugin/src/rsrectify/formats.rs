//! Video formats → views of image planes.
//!
//! Nothing here is a table of formats: GStreamer describes each format by its components, and
//! components that lie side by side in each pixel make one view. A new format of 8, 10, 12 or 16
//! bits is one line in [`FORMATS`].

use gst_video::prelude::*;
use gst_video::{VideoFormat, VideoFrameRef, VideoInfo};
use rsrectify::plane::{Luma, Plane, PlaneLayout, PlaneMut, SampleFormat};
use rsrectify::warp::Placement;

/// The formats that can be rectified, the most usual first.
pub const FORMATS: [VideoFormat; 30] = [
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
    VideoFormat::I42212le,
    VideoFormat::Y44412le,
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
];

/// Longest side of a frame in pixels. No camera comes near it; caps that claim more are a mistake
/// which would be paid for in memory.
pub const LONGEST_SIDE: i32 = 32_768;

/// Most components that a pixel can have.
const COMPONENTS: usize = 4;

/// Weights of red, green and blue in the luma that is analysed (BT.601; any sensible weights do).
const LUMA_WEIGHTS: [f32; 3] = [0.299, 0.587, 0.114];

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
    pub placement: Placement,
    /// The component in each channel; `None` for padding.
    components: [Option<usize>; COMPONENTS],
}

/// How a stream's frames are cut into views.
#[derive(Clone, Debug)]
pub struct FrameLayout {
    info: VideoInfo,
    views: Vec<View>,
    luma: View,
    luma_weights: [f32; COMPONENTS],
}

impl FrameLayout {
    /// The layout of frames described by `info`.
    pub fn new(info: &VideoInfo) -> Option<Self> {
        let views: Vec<View> = (0..info.n_planes()).flat_map(|plane| plane_views(info, plane)).collect();
        let luma = views.iter().find(|view| view.components.contains(&Some(0)))?.clone();
        let luma_weights = luma.components.map(|component| match component {
            Some(c) if info.is_rgb() => LUMA_WEIGHTS.get(c).copied().unwrap_or(0.0),
            Some(0) => 1.0,
            _ => 0.0,
        });
        Some(Self { info: info.clone(), views, luma, luma_weights })
    }

    /// What the frames look like.
    pub fn info(&self) -> &VideoInfo {
        &self.info
    }

    /// The views that together make the whole frame.
    pub fn views(&self) -> &[View] {
        &self.views
    }

    /// The luma of a mapped frame.
    pub fn luma<'a>(&self, frame: &'a VideoFrameRef<&gst::BufferRef>) -> Option<Luma<'a>> {
        Some(Luma { plane: self.luma.plane(frame)?, weights: self.luma_weights })
    }

    /// An 0xAARRGGBB colour as one sample value a component, by the stream's colour matrix and range.
    pub fn fill(&self, argb: u32) -> [u16; COMPONENTS] {
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
    pub fn fill(&self, components: &[u16; COMPONENTS]) -> [u16; COMPONENTS] {
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
        let end = frame.plane_offset().get(plane)?.checked_add(self.offset)?;
        let end = end.checked_add(layout.required_bytes()?)?;
        (end <= frame.buffer().size()).then_some(layout)
    }
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
        let single = |c: &u8| view(info, plane, &[*c], info.comp_poffset(*c) as usize, Some(1));
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
        components.iter().find(|&&c| info.comp_poffset(c) as usize == byte).map(|&c| usize::from(c))
    };
    View { plane, offset, layout, placement: placement(info, first), components: std::array::from_fn(at) }
}

fn sample_format(info: &VideoInfo, component: u8) -> SampleFormat {
    let shift = info.format_info().shift().get(usize::from(component)).copied().unwrap_or(0);
    match (info.comp_depth(component), shift) {
        (10, 0) => SampleFormat::U10,
        (10, _) => SampleFormat::U10_HIGH,
        (12, _) => SampleFormat::U12,
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
fn placement(info: &VideoInfo, component: u8) -> Placement {
    use gst_video::VideoChromaSite;
    let site = match info.chroma_site() {
        site if site.is_empty() => VideoChromaSite::MPEG2,
        site => site,
    };
    let cosited = [site.contains(VideoChromaSite::H_COSITED), site.contains(VideoChromaSite::V_COSITED)];
    let scale = subsampling(info, component).map(|sub| f64::from(1 << sub));
    let offset = std::array::from_fn(|axis| if cosited[axis] { 0.0 } else { (scale[axis] - 1.0) / 2.0 });
    Placement { scale, offset }
}

#[cfg(test)]
#[path = "formats_tests.rs"]
mod tests;
