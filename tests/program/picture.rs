// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify fix`: what the pictures of a clip stand for, how they are stored and scanned, stays what it was.

use crate::shared::{Folder, buffers, fix, size};
use std::path::{Path, PathBuf};

fn text(frame: &gst::Sample, field: &str) -> Option<String> {
    frame.caps()?.structure(0)?.get(field).ok()
}

/// The first frame of an MP4 file, of the encoded stream alone: what the file around it states is gone.
fn bare_frame(folder: &Folder, file: &Path, codec: &str) -> gst::Sample {
    let parts = format!("qtdemux ! {codec}parse ! video/x-{codec},stream-format=byte-stream,alignment=au");
    let units = buffers(file, &parts);
    let bytes = |unit: &gst::Sample| unit.buffer().unwrap().map_readable().unwrap().to_vec();
    let stream = folder.file("stream");
    std::fs::write(&stream, units.iter().flat_map(bytes).collect::<Vec<_>>()).unwrap();
    let frames = buffers(&stream, &format!("{codec}parse ! avdec_{codec}"));
    frames.into_iter().next().unwrap()
}

/// Frames of a format; `fields` more of their caps.
fn frames_of(format: &str, fields: &str) -> String {
    format!(
        "videotestsrc num-buffers=4 pattern=colors ! video/x-raw,format={format},width=128,height=96,framerate=25/1 \
         ! capssetter caps=video/x-raw{fields}"
    )
}

#[test]
fn the_stream_states_the_range_that_the_file_forgets() {
    let folder = Folder::new("range");
    // GStreamer's demuxer takes the box for limited range, the stream says full.
    let frames = frames_of("I420", ",colorimetry=(string)1:4:5:11");
    let input = folder.clip("in.mp4", "mp4mux", &format!("{frames} ! x264enc ! mux."));
    for (codec, media) in [("h264", "h264"), ("hevc", "h265")] {
        let output = folder.file("out.mp4");
        assert_eq!(fix(&input, &output, &["--codec", codec]), "");
        let frame = bare_frame(&folder, &output, media);
        assert_eq!(text(&frame, "colorimetry").unwrap(), "1:4:5:11", "{codec}");
    }
    for codec in ["av1", "ffv1"] {
        let output = folder.file("out.mkv");
        assert_eq!(fix(&input, &output, &["--codec", codec]), "");
        let stated = buffers(&output, "matroskademux ! identity").into_iter().next().unwrap();
        assert_eq!(text(&stated, "colorimetry").unwrap(), "1:4:5:11", "{codec}");
    }
}

#[test]
fn samples_of_full_range_are_not_converted() {
    let folder = Folder::new("full");
    let frames = frames_of("Y42B", ",colorimetry=(string)1:4:5:1");
    let input = folder.clip("in.mp4", "mp4mux", &format!("{frames} ! x264enc ! mux."));
    let output = folder.file("out.mkv");
    fix(&input, &output, &["--codec", "ffv1", "--strength", "0"]);
    let pixels = |path: &Path, decoder: &str| {
        let bytes = |frame: &gst::Sample| frame.buffer().unwrap().map_readable().unwrap().to_vec();
        buffers(path, decoder).iter().map(bytes).collect::<Vec<_>>()
    };
    // Neither of the two converts anything.
    let before = pixels(&input, "qtdemux ! h264parse ! avdec_h264 ! video/x-raw,format=Y42B");
    let after = pixels(&output, "matroskademux ! avdec_ffv1 ! video/x-raw,format=Y42B");
    assert_eq!(before.len(), 4);
    assert!(before == after);
}

#[test]
fn prores_gets_the_range_that_it_has() {
    let folder = Folder::new("narrow");
    let frames = frames_of("I420", ",colorimetry=(string)1:4:5:1").replace("pattern=colors", "pattern=white");
    // White of limited range, as the test source draws it, is a light grey in full range.
    let input = folder.clip("in.mp4", "mp4mux", &format!("{frames} ! x264enc ! mux."));
    let output = folder.file("out.mov");
    let said = fix(&input, &output, &["--codec", "prores", "--strength", "0"]);
    assert!(said.contains("limited range") && said.lines().count() == 1, "{said}");
    let luma = |frames: &[gst::Sample], bytes: usize| {
        let plane = frames[0].buffer().unwrap().map_readable().unwrap();
        plane[..bytes].iter().rev().fold(0, |value, byte| value << 8 | i32::from(*byte))
    };
    let before = luma(&buffers(&input, "qtdemux ! h264parse ! avdec_h264"), 1);
    let after = luma(&buffers(&output, "qtdemux ! avdec_prores"), 2);
    assert!(before > 230, "{before}");
    // In 10 bits 64 is black and 940 is white; within one step of the clip's 8 bits. Not converted it would be 940.
    assert!((after - (64 + before * 876 / 255)).abs() <= 4, "{before} {after}");
}

#[test]
fn chroma_and_bits_are_kept() {
    let folder = Folder::new("chroma");
    for (format, codecs) in [
        ("Y42B", &["h264", "hevc", "av1", "ffv1"][..]),
        ("Y444", &["h264", "hevc", "av1", "ffv1"]),
        ("I422_10LE", &["h264", "hevc", "prores", "ffv1"]),
        ("Y444_10LE", &["h264", "hevc", "prores", "ffv1"]),
        ("I422_12LE", &["hevc", "ffv1"]),
    ] {
        let input =
            folder.clip("in.mkv", "matroskamux", &format!("{} ! avenc_ffv1 ! mux.", frames_of(format, "")));
        for codec in codecs {
            let output = folder.file("out.mkv");
            assert_eq!(fix(&input, &output, &["--codec", codec]), "", "{format} {codec}");
            let frame = buffers(&output, "decodebin").into_iter().next().unwrap();
            assert_eq!(text(&frame, "format").unwrap(), format, "{codec}");
        }
    }
}

#[test]
fn what_a_codec_cannot_hold_is_named() {
    let folder = Folder::new("losses");
    let output = folder.file("out.mkv");
    for (format, codec, named) in [
        ("I422_12LE", "h264", "the H.264 encoder takes 10 bits, the clip has 12"),
        ("I420_10LE", "av1", "the AV1 encoder takes 8 bits, the clip has 10"),
        ("Y444_12LE", "prores", "the ProRes encoder takes 10 bits, the clip has 12"),
        ("A420", "h264", "H.264 has no transparency"),
    ] {
        let input =
            folder.clip("in.mkv", "matroskamux", &format!("{} ! avenc_ffv1 ! mux.", frames_of(format, "")));
        let said = fix(&input, &output, &["--codec", codec]);
        assert!(said.contains(named) && said.lines().count() == 1, "{format} {codec}: {said}");
    }
}

#[test]
fn odd_sizes_stay_odd() {
    let folder = Folder::new("odd");
    let frames = frames_of("I420", "").replace("width=128,height=96", "width=121,height=81");
    let input = folder.clip("in.mkv", "matroskamux", &format!("{frames} ! avenc_ffv1 ! mux."));
    for codec in ["h264", "hevc", "av1", "ffv1"] {
        let output = folder.file("out.mkv");
        let said = fix(&input, &output, &["--codec", codec]);
        assert_eq!(said.contains("121 x 81"), ["h264", "hevc"].contains(&codec), "{codec}: {said}");
        let frames = buffers(&output, "decodebin");
        assert_eq!((frames.len(), size(&frames[0])), (4, (121, 81)), "{codec}");
    }
}

#[test]
fn fields_stay_fields() {
    let folder = Folder::new("fields");
    for order in ["top-field-first", "bottom-field-first"] {
        let fields = format!(",interlace-mode=interleaved,field-order={order}");
        let input =
            folder.clip("in.mkv", "matroskamux", &format!("{} ! x264enc ! mux.", frames_of("I420", &fields)));
        let output = folder.file("out.mp4");
        fix(&input, &output, &[]);
        let frame = bare_frame(&folder, &output, "h264");
        let found = ["interlace-mode", "field-order"].map(|field| text(&frame, field).unwrap_or_default());
        assert_eq!(found, ["interleaved", order]);
    }
}

#[test]
fn the_light_of_hdr_is_kept() {
    const DISPLAY: &str = "34000:16000:13250:34500:7500:3000:15635:16450:10000000:50";
    let folder = Folder::new("hdr");
    let options = "hdr10=1:repeat-headers=1:max-cll=1000,200:\
                   master-display=G(13250,34500)B(7500,3000)R(34000,16000)WP(15635,16450)L(10000000,50)";
    let frames = frames_of("I420_10LE", ",colorimetry=(string)bt2100-pq");
    let encoder = format!("x265enc option-string=\"{options}\"");
    let input = folder.clip("in.mp4", "mp4mux", &format!("{frames} ! {encoder} ! h265parse ! mux."));
    let output = folder.file("out.mp4");
    assert_eq!(fix(&input, &output, &["--codec", "hevc"]), "");
    let frame = bare_frame(&folder, &output, "h265");
    let found =
        ["colorimetry", "mastering-display-info", "content-light-level"].map(|field| text(&frame, field));
    assert_eq!(found.map(Option::unwrap_or_default), ["bt2100-pq", DISPLAY, "1000:200"]);
    // A codec whose own stream holds none has it in the file.
    let output = folder.file("out.mkv");
    assert_eq!(fix(&input, &output, &["--codec", "ffv1"]), "");
    let stated = buffers(&output, "matroskademux ! identity").into_iter().next().unwrap();
    assert_eq!(text(&stated, "content-light-level").unwrap(), "1000:200");
}

/// A real file; `None` where there are none.
fn real(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("RSRECTIFY_DATA");
    if folder.is_none() {
        eprintln!("skipped: RSRECTIFY_DATA does not name the folder with zoo/{name}");
    }
    Some(PathBuf::from(folder?).join("zoo").join(name))
}

#[test]
fn cameras_colours_are_kept() {
    let folder = Folder::new("cameras");
    for (name, expected) in [
        ("gopro-max-hero.mp4", Some("1:3:5:1")),
        ("bt601-full.mp4", Some("1:4:16:4")),
        ("iphone-meta60.mov", Some("1:4:5:11")),
        ("h264.avi", None),
    ] {
        let Some(input) = real(name) else { return };
        let output = folder.file("out.mp4");
        fix(&input, &output, &["--audio", "none", "--estimator", "sequential", "--effort", "fast"]);
        let frame = bare_frame(&folder, &output, "h264");
        assert_eq!(text(&frame, "colorimetry").as_deref(), expected, "{name}");
    }
}

#[test]
fn frames_of_films_without_their_times_are_shown_evenly() {
    let folder = Folder::new("times");
    let Some(input) = real("h264.avi") else { return };
    let output = folder.file("out.mkv");
    fix(&input, &output, &["--audio", "none"]);
    let frames = buffers(&output, "matroskademux ! h264parse ! avdec_h264");
    let milliseconds = |frame: &gst::Sample| frame.buffer().unwrap().pts().unwrap().mseconds();
    let times: Vec<_> = frames.iter().map(milliseconds).collect();
    assert_eq!(times.len(), 58);
    // 30 frames/s, from the fourth slot on: the decoder waits two packets, and the second slot is empty.
    for (number, time) in times.iter().enumerate() {
        assert!(time.abs_diff(100 + number as u64 * 100 / 3) <= 1, "{number}: {time}");
    }
}
