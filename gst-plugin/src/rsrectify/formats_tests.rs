// SPDX-License-Identifier: MIT OR Apache-2.0

//! Views against what the format definitions say, written down by hand.

use super::*;

fn layout(format: VideoFormat, width: u32, height: u32) -> FrameViews {
    gst::init().unwrap();
    FrameViews::new(&VideoInfo::builder(format, width, height).build().unwrap()).unwrap()
}

/// (plane, offset, width, height, step, channels, bits, shift) of each view of a 5 × 3 frame.
type Shape = (u32, usize, usize, usize, usize, usize, u32, u32);

fn shapes(format: VideoFormat) -> Vec<Shape> {
    let shape = |view: &View| {
        let l = view.layout;
        (view.plane, view.offset, l.width, l.height, l.step, l.channels, l.format.bits(), l.format.shift())
    };
    layout(format, 5, 3).all().iter().map(shape).collect()
}

fn planar(chroma: (usize, usize), bits: u32) -> Vec<Shape> {
    let (w, h) = chroma;
    vec![(0, 0, 5, 3, 1, 1, bits, 0), (1, 0, w, h, 1, 1, bits, 0), (2, 0, w, h, 1, 1, bits, 0)]
}

#[test]
fn planar_formats() {
    for format in [VideoFormat::I420, VideoFormat::Yv12] {
        assert_eq!(shapes(format), planar((3, 2), 8), "{format:?}");
    }
    assert_eq!(shapes(VideoFormat::Y42b), planar((3, 3), 8));
    assert_eq!(shapes(VideoFormat::Y444), planar((5, 3), 8));
    assert_eq!(shapes(VideoFormat::I42010le), planar((3, 2), 10));
    assert_eq!(shapes(VideoFormat::I42210le), planar((3, 3), 10));
    assert_eq!(shapes(VideoFormat::Y44410le), planar((5, 3), 10));
    assert_eq!(shapes(VideoFormat::I42012le), planar((3, 2), 12));
    assert_eq!(shapes(VideoFormat::Y41b), planar((2, 3), 8));
    assert_eq!(shapes(VideoFormat::Yuv9), planar((2, 1), 8));
    assert_eq!(shapes(VideoFormat::Gbr12le), planar((5, 3), 12));
    assert_eq!(shapes(VideoFormat::Y44416le), planar((5, 3), 16));
    for (format, chroma, bits) in [
        (VideoFormat::A420, (3, 2), 8),
        (VideoFormat::A42210le, (3, 3), 10),
        (VideoFormat::Gbra12le, (5, 3), 12),
    ] {
        let alpha = (3, 0, 5, 3, 1, 1, bits, 0);
        assert_eq!(shapes(format), [planar(chroma, bits), vec![alpha]].concat(), "{format:?}");
    }
    assert_eq!(shapes(VideoFormat::Gray8), [(0, 0, 5, 3, 1, 1, 8, 0)]);
    assert_eq!(shapes(VideoFormat::Gray16Le), [(0, 0, 5, 3, 1, 1, 16, 0)]);
}

#[test]
fn semi_planar_formats() {
    for format in [VideoFormat::Nv12, VideoFormat::Nv21] {
        assert_eq!(shapes(format), [(0, 0, 5, 3, 1, 1, 8, 0), (1, 0, 3, 2, 2, 2, 8, 0)], "{format:?}");
    }
    assert_eq!(shapes(VideoFormat::Nv16), [(0, 0, 5, 3, 1, 1, 8, 0), (1, 0, 3, 3, 2, 2, 8, 0)]);
    assert_eq!(shapes(VideoFormat::Nv24), [(0, 0, 5, 3, 1, 1, 8, 0), (1, 0, 5, 3, 2, 2, 8, 0)]);
    for (format, bits, shift) in
        [(VideoFormat::P01010le, 10, 6), (VideoFormat::P012Le, 12, 4), (VideoFormat::P016Le, 16, 0)]
    {
        let wanted = [(0, 0, 5, 3, 1, 1, bits, shift), (1, 0, 3, 2, 2, 2, bits, shift)];
        assert_eq!(shapes(format), wanted, "{format:?}");
    }
}

#[test]
fn packed_formats() {
    assert_eq!(
        shapes(VideoFormat::Yuy2),
        [(0, 0, 5, 3, 2, 1, 8, 0), (0, 1, 3, 3, 4, 1, 8, 0), (0, 3, 3, 3, 4, 1, 8, 0)]
    );
    assert_eq!(
        shapes(VideoFormat::Uyvy),
        [(0, 1, 5, 3, 2, 1, 8, 0), (0, 0, 3, 3, 4, 1, 8, 0), (0, 2, 3, 3, 4, 1, 8, 0)]
    );
    for (format, luma, chroma) in [(VideoFormat::Yvyu, 0, [3, 1]), (VideoFormat::Vyuy, 1, [2, 0])] {
        let wanted =
            [(0, luma, 5, 3, 2, 1, 8, 0), (0, chroma[0], 3, 3, 4, 1, 8, 0), (0, chroma[1], 3, 3, 4, 1, 8, 0)];
        assert_eq!(shapes(format), wanted, "{format:?}");
    }
    for (format, bits, shift) in [(VideoFormat::Y210, 10, 6), (VideoFormat::Y212Le, 12, 4)] {
        let wanted = [
            (0, 0, 5, 3, 2, 1, bits, shift),
            (0, 2, 3, 3, 4, 1, bits, shift),
            (0, 6, 3, 3, 4, 1, bits, shift),
        ];
        assert_eq!(shapes(format), wanted, "{format:?}");
    }
    assert_eq!(shapes(VideoFormat::Y412Le), [(0, 0, 5, 3, 4, 4, 12, 4)]);
    assert_eq!(shapes(VideoFormat::Ayuv64), [(0, 0, 5, 3, 4, 4, 16, 0)]);
    assert_eq!(shapes(VideoFormat::Bgra64Le), [(0, 0, 5, 3, 4, 4, 16, 0)]);
    for format in [VideoFormat::Rgb, VideoFormat::Bgr] {
        assert_eq!(shapes(format), [(0, 0, 5, 3, 3, 3, 8, 0)], "{format:?}");
    }
    for format in
        [VideoFormat::Rgbx, VideoFormat::Xbgr, VideoFormat::Argb, VideoFormat::Ayuv, VideoFormat::Vuya]
    {
        assert_eq!(shapes(format), [(0, 0, 5, 3, 4, 4, 8, 0)], "{format:?}");
    }
}

#[test]
fn luma_is_weighed_by_the_position_of_its_channels() {
    let weights = |format| layout(format, 4, 4).luma_weights;
    let [r, g, b] = LUMA_WEIGHTS;
    assert_eq!(weights(VideoFormat::I420), [1.0, 0.0, 0.0, 0.0]);
    assert_eq!(weights(VideoFormat::Ayuv), [0.0, 1.0, 0.0, 0.0]);
    assert_eq!(weights(VideoFormat::Vuya), [0.0, 0.0, 1.0, 0.0]);
    assert_eq!(weights(VideoFormat::Rgb), [r, g, b, 0.0]);
    assert_eq!(weights(VideoFormat::Bgra), [b, g, r, 0.0]);
    assert_eq!(weights(VideoFormat::Xrgb), [0.0, r, g, b]);
    assert_eq!(weights(VideoFormat::Bgra64Le), [b, g, r, 0.0]);
    assert_eq!(weights(VideoFormat::Y412Le), [0.0, 1.0, 0.0, 0.0]);
    assert_eq!(layout(VideoFormat::Uyvy, 4, 4).luma.offset, 1);
    // Green alone, which lies in the first plane of GBR and in the second of RGBP.
    for (format, plane) in [(VideoFormat::Gbr, 0), (VideoFormat::Gbra10le, 0), (VideoFormat::Rgbp, 1)] {
        assert_eq!(weights(format), [1.0, 0.0, 0.0, 0.0]);
        assert_eq!(layout(format, 4, 4).luma.plane, plane);
    }
}

#[test]
fn chroma_lies_where_its_site_says() {
    use gst_video::VideoChromaSite as Site;
    gst::init().unwrap();
    let chroma = |format, site| {
        let info = VideoInfo::builder(format, 8, 8).chroma_site(site).build().unwrap();
        let grid = FrameViews::new(&info).unwrap().all()[1].grid;
        (grid.scale, grid.offset)
    };
    assert_eq!(chroma(VideoFormat::I420, Site::JPEG), ([2.0, 2.0], [0.5, 0.5]));
    assert_eq!(chroma(VideoFormat::I420, Site::MPEG2), ([2.0, 2.0], [0.0, 0.5]));
    assert_eq!(chroma(VideoFormat::Nv12, Site::COSITED), ([2.0, 2.0], [0.0, 0.0]));
    assert_eq!(chroma(VideoFormat::I420, Site::empty()), ([2.0, 2.0], [0.0, 0.5]));
    assert_eq!(chroma(VideoFormat::Yuy2, Site::MPEG2), ([2.0, 1.0], [0.0, 0.0]));
    assert_eq!(chroma(VideoFormat::Y444, Site::JPEG), ([1.0, 1.0], [0.0, 0.0]));
    let luma = layout(VideoFormat::I420, 8, 8).all()[0].grid;
    assert_eq!(luma, SampleGrid::FULL);
}

#[test]
fn border_colour_in_every_colour_space() {
    let fill = |format, colorimetry: &str, argb| {
        gst::init().unwrap();
        let colorimetry: gst_video::VideoColorimetry = colorimetry.parse().unwrap();
        let info = VideoInfo::builder(format, 8, 8).colorimetry(&colorimetry).build().unwrap();
        let layout = FrameViews::new(&info).unwrap();
        layout.fill(argb).0[..layout.all().len()].to_vec()
    };
    let first = |fills: Vec<[u16; 4]>| fills.iter().map(|fill| fill[0]).collect::<Vec<_>>();
    assert_eq!(first(fill(VideoFormat::I420, "bt601", 0xff00_0000)), [16, 128, 128]);
    assert_eq!(first(fill(VideoFormat::I420, "bt601", 0xffff_ffff)), [235, 128, 128]);
    // Red in BT.709: Y = 16 + 219·0.2126, Cb = 128 − 224·0.2126/1.8556, Cr = 128 + 112.
    assert_eq!(first(fill(VideoFormat::I420, "bt709", 0xffff_0000)), [63, 102, 240]);
    assert_eq!(first(fill(VideoFormat::I42010le, "bt709", 0xff00_0000)), [64, 512, 512]);
    assert_eq!(fill(VideoFormat::Argb, "sRGB", 0x8001_0203), [[0x80, 1, 2, 3]]);
    assert_eq!(fill(VideoFormat::Bgrx, "sRGB", 0x8001_0203), [[3, 2, 1, 255]]);
    assert_eq!(first(fill(VideoFormat::Gbra, "sRGB", 0x8001_0203)), [2, 3, 1, 0x80]);
    assert_eq!(fill(VideoFormat::Rgba64Le, "sRGB", 0x00ff_0033), [[65535, 0, 0x3333, 0]]);
    assert_eq!(first(fill(VideoFormat::A42010le, "bt601", 0x0000_0000)), [64, 512, 512, 0]);
    assert_eq!(fill(VideoFormat::P01010le, "bt709", 0xffff_0000)[1][..2], [409, 960]);
    assert_eq!(first(fill(VideoFormat::Vyuy, "bt709", 0xffff_0000)), [63, 102, 240]);
    // NV21 stores Cr before Cb.
    assert_eq!(fill(VideoFormat::Nv21, "bt709", 0xffff_0000)[1][..2], [240, 102]);
}
