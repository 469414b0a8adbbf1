// SPDX-License-Identifier: MIT OR Apache-2.0

//! Sinks that understand bytes only, and sinks that are slow.

use super::effort::Effort;
use super::film::{self, MOVING};
use super::playback::PATIENCE;
use super::playback::{End, Player};
use crate::outcome::Outcome;
use anyhow::Context;
use gst::prelude::*;
use gst_video::{VideoFormat, VideoInfo};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::os::fd::AsRawFd;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Encoders and decoders, most of which pad their frames.
const CODECS: [(&str, &str); 4] = [
    ("x264enc speed-preset=ultrafast", "h264parse ! avdec_h264 max-threads=1"),
    ("avenc_mpeg4", "avdec_mpeg4 max-threads=1"),
    ("vp8enc deadline=1", "vp8dec"),
    ("jpegenc", "jpegdec"),
];
/// Frames of a stream.
const FRAMES: usize = 20;

/// A stream for raw sinks; whether the element is to leave it as it is.
struct Stream {
    source: String,
    info: VideoInfo,
    filter: &'static str,
    untouched: bool,
}

fn streams(effort: Effort, folder: &Path) -> anyhow::Result<Vec<Stream>> {
    let codecs = if effort == Effort::Short { &CODECS[..1] } else { &CODECS[..] };
    let sizes = effort.pick(vec![(322, 242)], vec![(322, 242), (334, 190), (176, 144), (50, 34)]);
    let mut streams = Vec::new();
    for (encoder, decoder) in codecs {
        for &size in &sizes {
            let info = VideoInfo::builder(VideoFormat::I420, size.0, size.1).build()?;
            for (pattern, filter, untouched) in [
                ("black", "rsrectify", true),
                (MOVING, "rsrectify strength=0", true),
                (MOVING, "rsrectify", false),
            ] {
                // Encoded once: some encoders take what lies behind a row for picture.
                let path = folder.join(format!("{}.mkv", streams.len()));
                film::write(&path, pattern, &format!("{encoder} ! matroskamux"), size, FRAMES)?;
                let source = format!(
                    "filesrc location={} ! matroskademux ! {decoder} ! video/x-raw,format=I420",
                    path.display()
                );
                streams.push(Stream { source, info: info.clone(), filter, untouched });
            }
        }
    }
    Ok(streams)
}

/// Clears the bytes between rows: they are no picture, and whatever was in memory.
fn clear_padding(bytes: &mut [u8], info: &VideoInfo) {
    for frame in bytes.chunks_mut(info.size()) {
        for plane in 0..info.n_planes() as usize {
            let (start, stride) = (info.offset()[plane], info.stride()[plane] as usize);
            let (width, height) =
                (info.comp_width(plane as u8) as usize, info.comp_height(plane as u8) as usize);
            for row in
                frame.get_mut(start..).into_iter().flat_map(|plane| plane.chunks_mut(stride).take(height))
            {
                row.iter_mut().skip(width).for_each(|byte| *byte = 0);
            }
        }
    }
}

/// Sinks that write what they get, byte for byte.
pub fn raw(effort: Effort) -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    let folder = tempfile::tempdir()?;
    for stream in streams(effort, folder.path())? {
        for sink in ["filesink", "fdsink", "appsink", "shmsink"] {
            let what = format!("{} ! {} ! {sink}", stream.source, stream.filter);
            let read = |filter: &str| -> anyhow::Result<Vec<u8>> {
                let mut bytes = bytes(&stream.source, filter, sink, folder.path())?;
                clear_padding(&mut bytes, &stream.info);
                Ok(bytes)
            };
            let wanted = read("identity")?;
            let got = read(stream.filter)?;
            outcome.tried += 1;
            outcome.frames += FRAMES as u64;
            if stream.untouched && wanted != got || wanted.len() != got.len() {
                outcome.changed += 1;
                outcome.fault(format!("{what}: {} bytes, not {}, or others", got.len(), wanted.len()));
            }
        }
    }
    Ok(outcome)
}

/// What a sink makes of a stream.
fn bytes(source: &str, filter: &str, sink: &str, folder: &Path) -> anyhow::Result<Vec<u8>> {
    let path = folder.join("bytes");
    let _ = std::fs::remove_file(&path);
    match sink {
        "filesink" => {
            play_out(&format!("{source} ! {filter} ! filesink name=sink location={}", path.display()))?;
            Ok(std::fs::read(path)?)
        }
        "fdsink" => {
            let file = std::fs::File::create(&path)?;
            play_out(&format!("{source} ! {filter} ! fdsink name=sink fd={}", file.as_raw_fd()))?;
            Ok(std::fs::read(path)?)
        }
        "appsink" => samples(source, filter),
        _ => shared(source, filter, &path),
    }
}

fn play_out(description: &str) -> anyhow::Result<()> {
    Player::new(description)?.write_out(PATIENCE).with_context(|| description.to_owned())
}

fn samples(source: &str, filter: &str) -> anyhow::Result<Vec<u8>> {
    let player = Player::new(&format!("{source} ! {filter} ! appsink name=sink sync=false"))?;
    let sink = player.pipeline.by_name("sink").and_then(|sink| sink.downcast::<gst_app::AppSink>().ok());
    let sink = sink.ok_or_else(|| anyhow::anyhow!("no sink"))?;
    player.pipeline.set_state(gst::State::Playing)?;
    let mut bytes = Vec::new();
    while let Ok(sample) = sink.pull_sample() {
        let map = sample.buffer().map(|buffer| buffer.map_readable()).transpose()?;
        bytes.extend_from_slice(map.as_ref().map_or(&[], |map| map.as_slice()));
    }
    Ok(bytes)
}

/// Through shared memory to a reader of its own.
fn shared(source: &str, filter: &str, path: &Path) -> anyhow::Result<Vec<u8>> {
    let socket = path.with_extension("socket");
    let _ = std::fs::remove_file(&socket);
    let writer = Player::new(&format!(
        "{source} ! {filter} ! shmsink name=sink sync=false wait-for-connection=true shm-size=50000000 \
         socket-path={}",
        socket.display()
    ))?;
    writer.pipeline.set_state(gst::State::Playing)?;
    let mut patience = 1000;
    while !socket.exists() && patience > 0 {
        std::thread::sleep(Duration::from_millis(5));
        patience -= 1;
    }
    let reader = Player::new(&format!(
        "shmsrc socket-path={} num-buffers={FRAMES} ! filesink name=sink sync=false location={}",
        socket.display(),
        path.display()
    ))?;
    reader.write_out(PATIENCE).context("shmsrc")?;
    drop(reader);
    Ok(std::fs::read(path)?)
}

/// Sinks that do not keep up, or do so irregularly.
pub fn slow(effort: Effort) -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    // Least and most time that the sink takes a frame, in microseconds, at 30 frames a second.
    let delays = [(0, 5_000), (0, 60_000), (3_000, 3_100), (40_000, 40_100), (70_000, 70_100), (0, 20_000)];
    let (count, frames) = effort.pick((2, 25), (delays.len(), 120));
    let (mut unrectified, mut all_dropped) = (0, 0);
    for (seed, &(least, most)) in delays[..count].iter().enumerate() {
        for lookahead in effort.pick(vec![4], vec![0, 1, 4, 8]) {
            outcome.tried += 1;
            let player = Player::new(&format!(
                "videotestsrc pattern=smpte75 horizontal-speed=3 num-buffers={frames} \
                 ! video/x-raw,format=I420,width=160,height=120,framerate=30/1 \
                 ! rsrectify name=filter lookahead={lookahead} \
                 ! fakesink name=sink sync=true qos=true max-lateness=20000000"
            ))?;
            delay(&player, seed as u64, least..most)?;
            let (end, got) = player.play(PATIENCE);
            let what = format!("{least} to {most} µs a frame, lookahead {lookahead}");
            if end == End::Hung {
                outcome.hung += 1;
            }
            let got: Vec<_> = got.iter().map(|arrival| arrival.pts).collect();
            let time = |number: u64| gst::ClockTime::from_nseconds(number * 1_000_000_000 / 30);
            let wanted: Vec<_> = (0..frames).map(|number| Some(time(number))).collect();
            outcome.compare(&wanted, &got, &what);
            let (left, dropped) =
                (statistic(&player, "filter", "late"), statistic(&player, "sink", "dropped"));
            if effort == Effort::Long && left > 0 && dropped == 0 {
                outcome.fault(format!("{what}: {left} frames not rectified, though the sink drops none"));
            }
            (unrectified, all_dropped) = (unrectified + left, all_dropped + dropped);
        }
    }
    if effort == Effort::Long {
        outcome.notes.push(format!(
            "the sinks dropped {all_dropped} frames that came too late, the element left {unrectified} as they came to keep up"
        ));
    }
    Ok(outcome)
}

/// Lets the sink take its time for each frame.
fn delay(player: &Player, seed: u64, micros: std::ops::Range<u64>) -> anyhow::Result<()> {
    let sink = player.pipeline.by_name("sink").and_then(|sink| sink.static_pad("sink"));
    let sink = sink.ok_or_else(|| anyhow::anyhow!("no sink"))?;
    let rng = Arc::new(Mutex::new(ChaCha8Rng::seed_from_u64(seed)));
    sink.add_probe(gst::PadProbeType::BUFFER, move |_, _| {
        if let Ok(mut rng) = rng.lock() {
            let time = rng.random_range(micros.clone());
            std::thread::sleep(Duration::from_micros(time));
        }
        gst::PadProbeReturn::Ok
    });
    Ok(())
}

/// A count from the `stats` of an element.
fn statistic(player: &Player, element: &str, name: &str) -> u64 {
    let stats = player.pipeline.by_name(element).map(|element| element.property::<gst::Structure>("stats"));
    stats.and_then(|stats| stats.get(name).ok()).unwrap_or(0)
}
