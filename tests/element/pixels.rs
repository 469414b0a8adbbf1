// SPDX-License-Identifier: MIT OR Apache-2.0

//! What comes out of the element is what a global shutter would have seen: rendered frames against
//! the truth, in every format and readout direction.

use crate::common::*;
use gst::prelude::*;
use gst_check::Harness;
use render::scene::procedural::bake_all;
use render::scene::{FirstEdge, Frame, Scene, SceneKind};
use render::sequence::{Sequence, Settings, named};
use std::sync::{Arc, LazyLock};

const WIDTH: usize = 320;
const HEIGHT: usize = 240;
const FRAMES: usize = 10;
/// Frames that are judged: the recursion has settled, and both neighbours exist.
const JUDGED: std::ops::Range<usize> = 2..FRAMES - 1;
/// Pixels at each edge that are not judged: what is shown there was not seen.
const MARGIN: usize = 32;

/// The frames of a sequence as the camera gives them, and as a global shutter sees them.
struct Shots {
    readout_ns: u64,
    rolling: Vec<Frame>,
    global: Vec<Frame>,
}

/// The global shutter opens when `share` of the readout has elapsed.
fn shots(first: FirstEdge, share: f64, scene: Arc<Scene>) -> Shots {
    let settings = Settings {
        width: WIDTH,
        height: HEIGHT,
        frames: FRAMES,
        first,
        readout_ratio: 0.8,
        ..named("rot2_B40").unwrap()
    };
    let sequence = Sequence::in_scene(settings, scene);
    let instant = |k| sequence.start(k) + share * sequence.settings.readout_time();
    let global = |k| sequence.renderer(0).global(instant(k)).sense(0.0, 0);
    Shots {
        readout_ns: (sequence.settings.readout_time() * 1e9).round() as u64,
        rolling: sequence.frames().unwrap().collect(),
        global: (0..FRAMES).map(global).collect(),
    }
}

static SCENE: LazyLock<Arc<Scene>> = LazyLock::new(|| Arc::new(SceneKind::Room.covered(1, bake_all(1))));
static TOP_FIRST: LazyLock<Shots> = LazyLock::new(|| shots(FirstEdge::Top, 0.5, SCENE.clone()));

/// The frames after a way through `format`, with `filter` in the middle: red, green, blue.
fn through(format: &str, filter: &str, frames: &[Frame]) -> Vec<Vec<u8>> {
    through_to("RGB", format, filter, frames)
}

/// The same in the format `shown`.
fn through_to(shown: &str, format: &str, filter: &str, frames: &[Frame]) -> Vec<Vec<u8>> {
    init();
    let rgb = caps("RGB", WIDTH as u32, HEIGHT as u32, gst::Fraction::new(30, 1));
    let mut h = Harness::new_parse(&format!(
        "videoconvert dither=none ! capsfilter caps=video/x-raw,format={format} ! {filter} ! videoconvert dither=none \
         ! capsfilter caps=video/x-raw,format={shown}"
    ));
    h.set_src_caps(rgb);
    for (number, frame) in frames.iter().enumerate() {
        let mut buffer = gst::Buffer::from_mut_slice(frame.rgb.clone());
        buffer.get_mut().unwrap().set_pts(time(number));
        h.push(buffer).unwrap();
    }
    h.push_event(gst::event::Eos::new());
    let out = arrived(&mut h);
    assert_eq!(out.len(), frames.len(), "{format}");
    out.iter().map(|buffer| buffer.map_readable().unwrap().to_vec()).collect()
}

/// Peak signal-to-noise ratio of two films within the margins, in dB.
fn psnr(a: &[Vec<u8>], b: &[Vec<u8>]) -> f64 {
    let (mut squares, mut count) = (0.0, 0.0);
    for (a, b) in a[JUDGED].iter().zip(&b[JUDGED]) {
        for y in MARGIN..HEIGHT - MARGIN {
            let row = 3 * (y * WIDTH + MARGIN)..3 * ((y + 1) * WIDTH - MARGIN);
            for (a, b) in a[row.clone()].iter().zip(&b[row]) {
                squares += (f64::from(*a) - f64::from(*b)).powi(2);
                count += 1.0;
            }
        }
    }
    10.0 * (255.0f64.powi(2) * count / squares.max(1e-9)).log10()
}

/// PSNR to the truth before and after the element; the rectified frames.
fn judged(format: &str, shots: &Shots, options: &str) -> (f64, f64, Vec<Vec<u8>>) {
    let filter = format!("rsrectify readout-time={} {options}", shots.readout_ns);
    let truth = through(format, "identity", &shots.global);
    let rectified = through(format, &filter, &shots.rolling);
    (psnr(&through(format, "identity", &shots.rolling), &truth), psnr(&rectified, &truth), rectified)
}

/// All formats that the element takes.
fn formats() -> Vec<String> {
    init();
    let element = gst::ElementFactory::make("rsrectify").build().unwrap();
    let template = element.static_pad("sink").unwrap().pad_template_caps();
    let formats = template.structure(0).unwrap().get::<gst::List>("format").unwrap();
    formats.iter().map(|format| format.get::<String>().unwrap()).collect()
}

#[test]
fn every_format_shows_what_a_global_shutter_would_have_seen() {
    // What varies here is the way of the pixels: the quicker estimator will do.
    let known = "estimator=sequential readout-direction=top-to-bottom";
    let (_, _, usual) = judged("I420", &TOP_FIRST, known);
    for format in formats() {
        let (before, after, rectified) = judged(&format, &TOP_FIRST, known);
        let likeness = psnr(&rectified, &usual);
        assert!(after > before + 6.0, "{format}: {before:.1} dB before, {after:.1} dB after");
        assert!(format.starts_with("GRAY") || likeness > 30.0, "{format}: {likeness:.1} dB to I420");
    }
}

#[test]
fn every_readout_direction_is_undone() {
    let edges = [
        (FirstEdge::Bottom, "bottom-to-top"),
        (FirstEdge::Left, "left-to-right"),
        (FirstEdge::Right, "right-to-left"),
    ];
    for (edge, direction) in edges {
        let shots = shots(edge, 0.5, SCENE.clone());
        let (before, after, _) = judged("NV12", &shots, &format!("readout-direction={direction}"));
        assert!(after > before + 6.0, "{direction}: {before:.1} dB before, {after:.1} dB after");
    }
}

#[test]
fn the_reference_row_is_the_instant_shown() {
    for (edge, direction) in [(FirstEdge::Top, "top-to-bottom"), (FirstEdge::Bottom, "bottom-to-top")] {
        for share in [0.0, 1.0] {
            let shots = shots(edge, share, SCENE.clone());
            let options = |row: f64| format!("readout-direction={direction} reference-row={row}");
            let (before, after, _) = judged("NV12", &shots, &options(share));
            let (_, other, _) = judged("NV12", &shots, &options(1.0 - share));
            let figures = format!("{direction} {share}: {before:.1} dB → {after:.1} dB, not {other:.1} dB");
            assert!(after > before + 6.0 && after > other + 6.0, "{figures}");
        }
    }
}

#[test]
fn the_border_colour_is_that_colour_in_every_format() {
    // No component is at its end, none like another: none can be left out or taken for another.
    let colour = [40, 200, 90, 128];
    let filter = format!(
        "rsrectify readout-time={} readout-direction=top-to-bottom estimator=sequential border-mode=constant \
         border-color=0x8028c85a",
        TOP_FIRST.readout_ns
    );
    for format in formats().iter().filter(|format| !format.starts_with("GRAY")) {
        let info = gst_video::VideoFormatInfo::from_format(gst_video::VideoFormat::from_string(format));
        let colour = if info.n_components() == 4 { colour } else { [40, 200, 90, 255] };
        let is_it = |pixel: &&[u8]| pixel.iter().zip(colour).all(|(&a, b)| a.abs_diff(b) < 8);
        let pixels = |frame: &Vec<u8>| frame.chunks_exact(4).filter(is_it).count();
        let most = |filter: &str| {
            let frames = through_to("RGBA", format, filter, &TOP_FIRST.rolling);
            frames[JUDGED].iter().map(pixels).max().unwrap()
        };
        let (before, shown) = (most("identity"), most(&filter));
        assert!(before < 100 && shown > 1000, "{format}: {before} pixels before, {shown} after");
    }
}

#[test]
fn every_interpolation_serves() {
    for interpolation in ["nearest", "linear", "cubic", "lanczos"] {
        let (before, after, _) = judged("NV12", &TOP_FIRST, &format!("interpolation={interpolation}"));
        assert!(after > before + 4.0, "{interpolation}: {before:.1} dB before, {after:.1} dB after");
    }
}

#[test]
fn a_film_played_backwards_is_rectified_as_well() {
    let backwards = Shots {
        readout_ns: TOP_FIRST.readout_ns,
        rolling: TOP_FIRST.rolling.iter().rev().cloned().collect(),
        global: TOP_FIRST.global.iter().rev().cloned().collect(),
    };
    let truth = through("NV12", "identity", &backwards.global);
    let before = psnr(&through("NV12", "identity", &backwards.rolling), &truth);
    let mut h = harness(4, &caps("RGB", WIDTH as u32, HEIGHT as u32, gst::Fraction::new(30, 1)));
    h.element().unwrap().set_property("readout-time", backwards.readout_ns);
    let mut segment = gst::FormattedSegment::<gst::ClockTime>::new();
    segment.set_rate(-1.0);
    segment.set_stop(time(FRAMES));
    h.push_event(gst::event::Segment::new(&segment));
    for (number, frame) in backwards.rolling.iter().enumerate() {
        let mut buffer = gst::Buffer::from_mut_slice(frame.rgb.clone());
        buffer.get_mut().unwrap().set_pts(time(FRAMES - 1 - number));
        h.push(buffer).unwrap();
    }
    h.push_event(gst::event::Eos::new());
    let out: Vec<_> = arrived(&mut h).iter().map(|buffer| buffer.map_readable().unwrap().to_vec()).collect();
    let after = psnr(&out, &backwards.global.iter().map(|frame| frame.rgb.clone()).collect::<Vec<_>>());
    assert!(after > before + 6.0, "{before:.1} dB before, {after:.1} dB after");
}

/// The planes of the sequence's frames as they lie in memory, chroma planes merged for NV12.
fn planes(frame: &Frame, format: &str) -> Vec<u8> {
    let planes = frame.planes();
    let chroma = match format {
        "I420" => [planes.u, planes.v].concat(),
        _ => planes.u.into_iter().zip(planes.v).flat_map(|(u, v)| [u, v]).collect(),
    };
    [planes.y, chroma].concat()
}

#[test]
fn chroma_planes_and_chroma_pairs_are_warped_alike() {
    let out = ["I420", "NV12"].map(|format| {
        let mut h = harness(4, &caps(format, WIDTH as u32, HEIGHT as u32, gst::Fraction::new(30, 1)));
        h.element().unwrap().set_property("readout-time", TOP_FIRST.readout_ns);
        for (number, frame) in TOP_FIRST.rolling.iter().enumerate() {
            let mut buffer = gst::Buffer::from_mut_slice(planes(frame, format));
            buffer.get_mut().unwrap().set_pts(time(number));
            h.push(buffer).unwrap();
        }
        h.push_event(gst::event::Eos::new());
        arrived(&mut h).iter().map(|buffer| buffer.map_readable().unwrap().to_vec()).collect::<Vec<_>>()
    });
    let luma = WIDTH * HEIGHT;
    for (planar, paired) in out[0].iter().zip(&out[1]) {
        assert!(planar[..luma] == paired[..luma]);
        let (u, v) = planar[luma..].split_at(luma / 4);
        let pairs = u.iter().zip(v).flat_map(|(u, v)| [*u, *v]);
        assert!(pairs.eq(paired[luma..].iter().copied()));
    }
}
