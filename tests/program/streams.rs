// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify fix`: what is encoded, and what is kept beside the video.

use crate::shared::{CLIP, Folder, TONE, buffers, fix, rsrectify};
use gst::prelude::*;
use std::path::Path;

/// Plays a clip from its demuxer on: the types of its streams, sorted, and all tables of contents.
fn contents(path: &Path) -> (Vec<String>, Vec<gst::Toc>) {
    let pipeline = crate::common::film::launch("filesrc name=in ! parsebin name=parse");
    pipeline.by_name("in").unwrap().set_property("location", path);
    let pads = std::sync::Arc::new(std::sync::Mutex::new(Vec::new()));
    let (seen, sinks) = (pads.clone(), pipeline.clone());
    pipeline.by_name("parse").unwrap().connect_pad_added(move |_, pad| {
        // Subtitles are sparse: nothing must wait for their first line.
        let sink = gst::ElementFactory::make("fakesink").property("async", false).build().unwrap();
        sinks.add(&sink).unwrap();
        sink.sync_state_with_parent().unwrap();
        pad.link(&sink.static_pad("sink").unwrap()).unwrap();
        seen.lock().unwrap().push(pad.clone());
    });
    pipeline.set_state(gst::State::Playing).unwrap();
    let mut tables = Vec::new();
    for message in pipeline.bus().unwrap().iter_timed(gst::ClockTime::from_seconds(20)) {
        match message.view() {
            gst::MessageView::Toc(toc) => tables.push(toc.toc().0),
            gst::MessageView::Eos(_) => break,
            gst::MessageView::Error(error) => panic!("{error:?}"),
            _ => {}
        }
    }
    // Parsers know the type from the first frames on.
    let name = |pad: &gst::Pad| pad.current_caps().unwrap().structure(0).unwrap().name().to_string();
    let mut types: Vec<_> = pads.lock().unwrap().iter().map(name).collect();
    pipeline.set_state(gst::State::Null).unwrap();
    types.sort();
    (types, tables)
}

#[test]
fn each_codec_goes_into_its_container() {
    let folder = Folder::new("codecs");
    let short = CLIP.replace("num-buffers=30", "num-buffers=5");
    let input = folder.clip("in.mp4", "mp4mux", &short);
    for (codec, file, kind) in [
        ("h264", "out.mkv", "video/x-h264"),
        ("hevc", "out.mp4", "video/x-h265"),
        ("av1", "out.mp4", "video/x-av1"),
        ("prores", "out.mov", "video/x-prores"),
        ("ffv1", "out.mkv", "video/x-ffv"),
    ] {
        let output = folder.file(file);
        fix(&input, &output, &["--codec", codec]);
        assert_eq!(contents(&output).0, [kind], "{codec}");
        assert_eq!(buffers(&output, "decodebin ! videoconvert").len(), 5, "{codec}");
    }
}

#[test]
fn a_lossless_codec_keeps_what_is_not_rectified() {
    let folder = Folder::new("lossless");
    let (input, output) = (folder.clip("in.mp4", "mp4mux", CLIP), folder.file("out.mkv"));
    fix(&input, &output, &["--codec", "ffv1", "--strength", "0"]);
    let pixels = |path: &Path| {
        let frames = buffers(path, "decodebin ! videoconvert ! video/x-raw,format=I420");
        let bytes = |frame: &gst::Sample| frame.buffer().unwrap().map_readable().unwrap().to_vec();
        frames.iter().map(bytes).collect::<Vec<_>>()
    };
    let (before, after) = (pixels(&input), pixels(&output));
    assert_eq!(before.len(), 30);
    assert!(before == after);
}

#[test]
fn all_audio_and_subtitles_are_kept() {
    let folder = Folder::new("streams");
    let subtitles = folder.file("sub.srt");
    let text =
        "1\n00:00:00,100 --> 00:00:00,400\nfish & chips\n\n2\n00:00:00,500 --> 00:00:00,900\nthe end\n";
    std::fs::write(&subtitles, text).unwrap();
    let streams = format!(
        "{CLIP} {TONE} ! avenc_aac ! mux. {TONE} ! opusenc ! mux. \
         filesrc location={} ! subparse ! text/x-raw,format=utf8 ! queue ! mux.",
        subtitles.display()
    )
    .replace("44100", "48000");
    let input = folder.clip("in.mp4", "mp4mux", &streams);
    for file in ["out.mp4", "out.mov", "out.mkv"] {
        let output = folder.file(file);
        assert_eq!(fix(&input, &output, &[]), "", "{file}");
        let types = contents(&output).0;
        assert_eq!(types, ["audio/mpeg", "audio/x-opus", "text/x-raw", "video/x-h264"], "{file}");
        let demuxer = if file.ends_with("mkv") { "matroskademux" } else { "qtdemux" };
        let lines = buffers(
            &output,
            &format!("{demuxer} name=d d.video_0 ! queue ! fakesink async=false d.subtitle_0 ! queue"),
        );
        let line = |sample: &gst::Sample| {
            let bytes = sample.buffer().unwrap().map_readable().unwrap().to_vec();
            String::from_utf8(bytes).unwrap().trim_end_matches('\0').to_owned()
        };
        let lines: Vec<_> = lines.iter().map(line).filter(|line| !line.is_empty()).collect();
        // The demuxer of Matroska gives out markup.
        let first = if file.ends_with("mkv") { "fish &amp; chips" } else { "fish & chips" };
        assert_eq!(lines, [first, "the end"], "{file}");
    }
}

#[test]
fn audio_is_copied_where_the_container_holds_it() {
    let folder = Folder::new("audio");
    let short = CLIP.replace("num-buffers=30", "num-buffers=20").replace("! mux.", "! h264parse ! mux.");
    let tone = TONE.replace("44100", "48000").replace("num-buffers=40", "num-buffers=30");
    for (encoder, [mp4, mov, mkv]) in [
        ("avenc_ac3", ["x-ac3", "x-ac3", "x-ac3"]),
        ("avenc_eac3", ["mpeg", "mpeg", "x-eac3"]),
        ("vorbisenc", ["mpeg", "mpeg", "x-vorbis"]),
        ("flacenc", ["mpeg", "mpeg", "x-flac"]),
        ("avenc_wmav2", ["mpeg", "mpeg", "x-wma"]),
        ("identity", ["mpeg", "x-raw", "x-raw"]),
    ] {
        let streams = format!("{short} {tone} ! audioconvert ! {encoder} ! queue ! mux.");
        let input = folder.clip("in.mkv", "matroskamux", &streams);
        for (file, kind) in [("out.mp4", mp4), ("out.mov", mov), ("out.mkv", mkv)] {
            let output = folder.file(file);
            let said = fix(&input, &output, &[]);
            let is_encoded = kind == "mpeg";
            assert_eq!(said.contains("is encoded to AAC"), is_encoded, "{encoder}, {file}: {said}");
            assert_eq!(said.lines().count(), usize::from(is_encoded), "{encoder}, {file}: {said}");
            assert_eq!(contents(&output).0, [&format!("audio/{kind}"), "video/x-h264"], "{encoder}, {file}");
        }
    }
}

#[test]
fn video_beside_the_first_is_copied() {
    let folder = Folder::new("videos");
    let small = CLIP.replace("width=320,height=240", "width=160,height=120");
    let input = folder.clip(
        "in.mkv",
        "matroskamux",
        &format!("{CLIP} {small}").replace("! mux.", "! h264parse ! mux."),
    );
    for file in ["out.mkv", "out.mp4"] {
        let output = folder.file(file);
        assert_eq!(fix(&input, &output, &[]), "", "{file}");
        assert_eq!(contents(&output).0, ["video/x-h264"; 2], "{file}");
        let demuxer = if file.ends_with("mkv") { "matroskademux" } else { "qtdemux" };
        let second = |path: &Path, demuxer: &str| {
            let read = format!("{demuxer} name=d d.video_0 ! queue ! fakesink async=false d.video_1 ! queue");
            let bytes = |frame: &gst::Sample| frame.buffer().unwrap().size();
            buffers(path, &read).iter().map(bytes).collect::<Vec<_>>()
        };
        assert_eq!(second(&output, demuxer), second(&input, "matroskademux"), "{file}");
    }
}

#[test]
fn what_the_container_cannot_hold_is_named() {
    let folder = Folder::new("lost");
    let ass = format!("{CLIP} {TONE} ! flacenc ! mux.")
        .replace("x264enc speed-preset=ultrafast", "x264enc ! h264parse");
    let input = folder.clip("in.mkv", "matroskamux", &ass);
    fix(&input, &folder.file("out.mkv"), &[]);
    assert_eq!(contents(&folder.file("out.mkv")).0, ["audio/x-flac", "video/x-h264"]);
    let ten = CLIP.replace("I420", "I420_10LE");
    let input = folder.clip("ten.mp4", "mp4mux", &ten);
    let said = fix(&input, &folder.file("out.mp4"), &["--codec", "av1"]);
    assert!(said.contains("8 bits, the clip has 10"), "{said}");
}

#[test]
fn uncompressed_audio_and_timecode_stay_in_a_film() {
    let folder = Folder::new("film");
    let stamped =
        CLIP.replace("! x264enc", "! timecodestamper set=always set-internal-timecode=01:02:03:04 ! x264enc");
    let input = folder.clip("in.mov", "qtmux", &format!("{stamped} {TONE},format=S16LE ! mux."));
    let output = folder.file("out.mov");
    assert_eq!(fix(&input, &output, &[]), "");
    let film = std::fs::read(&output).unwrap();
    assert!(film.windows(4).any(|name| name == b"sowt"));
    // A second pass reads the timecode that the first one wrote.
    let again = folder.file("again.mkv");
    let said = fix(&output, &again, &[]);
    assert!(said.contains("01:02:03:04") && said.contains("MKV"), "{said}");
}

#[test]
fn chapters_and_colour_stay() {
    let folder = Folder::new("chapters");
    let bt2020 = CLIP.replace("format=I420", "format=I420_10LE,colorimetry=bt2020-10");
    let input = folder.prepared_clip("in.mkv", "matroskamux", &bt2020, |pipeline| {
        let mut edition = gst::TocEntry::new(gst::TocEntryType::Edition, "edition");
        for (index, title) in ["first", "second"].into_iter().enumerate() {
            let mut chapter = gst::TocEntry::new(gst::TocEntryType::Chapter, title);
            let chapter_mut = chapter.get_mut().unwrap();
            chapter_mut.set_start_stop_times(500_000_000 * index as i64, 500_000_000 * (index + 1) as i64);
            let mut tags = gst::TagList::new();
            tags.get_mut().unwrap().add::<gst::tags::Title>(&title, gst::TagMergeMode::Append);
            chapter_mut.set_tags(tags);
            edition.get_mut().unwrap().append_sub_entry(chapter);
        }
        let mut toc = gst::Toc::new(gst::TocScope::Global);
        toc.get_mut().unwrap().append_entry(edition);
        let muxer = pipeline.by_name("mux").unwrap().dynamic_cast::<gst::TocSetter>().unwrap();
        muxer.set_toc(Some(&toc));
    });
    let output = folder.file("out.mkv");
    assert_eq!(fix(&input, &output, &[]), "");
    assert!(fix(&input, &folder.file("out.mp4"), &[]).contains("chapters are left out"));
    let titles = |path: &Path| {
        let tables = contents(path).1;
        let chapters = tables.last().map(|toc| toc.entries()).unwrap_or_default();
        let chapters: Vec<_> = chapters.iter().flat_map(|edition| edition.sub_entries()).collect();
        let title = |entry: &gst::TocEntry| Some(entry.tags()?.get::<gst::tags::Title>()?.get().to_owned());
        chapters.iter().filter_map(title).collect::<Vec<_>>()
    };
    assert_eq!(titles(&input), ["first", "second"]);
    assert_eq!(titles(&output), ["first", "second"]);
    // A part that is the whole.
    let joined = folder.file("joined.mkv");
    let result = rsrectify("join").args([&input, &output]).arg("--output").arg(&joined).output().unwrap();
    assert!(result.status.success(), "{}", String::from_utf8_lossy(&result.stderr));
    assert_eq!(titles(&joined), ["first", "second"]);
    let frames = buffers(&output, "decodebin");
    let colours: String = frames[0].caps().unwrap().structure(0).unwrap().get("colorimetry").unwrap();
    assert_eq!(colours, "bt2020-10");
}
