// SPDX-License-Identifier: MIT OR Apache-2.0

//! Files that are not what they should be.

use super::effort::Effort;
use super::film::{self, MOVING};
use super::playback::PATIENCE;
use super::playback::{Arrival, End, Player};
use crate::outcome::Outcome;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;

/// How each kind of film is written and read. Not by `decodebin`, which may swallow a demuxer's error and then waits
/// for ever, whatever follows it.
const KINDS: [(&str, &str); 6] = [
    (
        "x264enc speed-preset=ultrafast key-int-max=10 ! mp4mux",
        "qtdemux ! h264parse ! avdec_h264 max-threads=1",
    ),
    (
        "x264enc speed-preset=ultrafast key-int-max=10 ! mpegtsmux",
        "tsdemux ! h264parse ! avdec_h264 max-threads=1",
    ),
    (
        "x264enc speed-preset=ultrafast key-int-max=10 ! matroskamux",
        "matroskademux ! h264parse ! avdec_h264 max-threads=1",
    ),
    ("vp8enc deadline=1 keyframe-max-dist=10 ! webmmux", "matroskademux ! vp8dec"),
    ("jpegenc ! avimux", "avidemux ! jpegdec"),
    ("avenc_mpeg4 gop-size=10 ! mp4mux", "qtdemux ! avdec_mpeg4 max-threads=1"),
];

/// Damaged films.
pub fn damaged(effort: Effort) -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    let folder = tempfile::tempdir()?;
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let kinds = if effort == Effort::Short { &KINDS[..2] } else { &KINDS[..] };
    let mut unlike = 0;
    for (encoder, decoder) in kinds {
        let whole = folder.path().join("whole");
        film::write(&whole, MOVING, encoder, (176, 144), 40)?;
        let whole = std::fs::read(&whole)?;
        for damage in 0..effort.pick(3, 60) {
            let mut bytes = whole.clone();
            let what = spoil(&mut bytes, damage, &mut rng);
            let path = folder.path().join("damaged");
            std::fs::write(&path, bytes)?;
            let source = format!("filesrc location={} ! {decoder}", path.display());
            unlike += u64::from(!same(&mut outcome, &source, &format!("{encoder}, {what}"))?);
        }
    }
    if unlike > 0 {
        outcome
            .notes
            .push(format!("{unlike} more were played differently even by `identity` twice, and not judged"));
    }
    Ok(outcome)
}

/// Damages a file; what was done.
fn spoil(bytes: &mut Vec<u8>, kind: usize, rng: &mut ChaCha8Rng) -> String {
    let length = bytes.len();
    match kind % 3 {
        0 => {
            let kept = rng.random_range(length / 10..length);
            bytes.truncate(kept);
            format!("cut off at {kept} of {length}")
        }
        1 => {
            let flips = 1 << rng.random_range(0..9);
            for _ in 0..flips {
                // The head is left, so that most of them are still seen as films.
                let at = rng.random_range(length / 20..length);
                bytes[at] ^= 1 << rng.random_range(0..8);
            }
            format!("{flips} bits flipped")
        }
        _ => {
            let start = rng.random_range(length / 20..length);
            let hole = rng.random_range(1..length / 4).min(length - start);
            bytes[start..start + hole].fill(0);
            format!("{hole} zeros from {start} on")
        }
    }
}

/// Streams whose caps change on the way.
pub fn other_sizes(effort: Effort) -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    let folder = tempfile::tempdir()?;
    let sizes = [(320, 240), (176, 144), (322, 242), (64, 48), (240, 320)];
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let parts: Vec<Vec<u8>> = sizes
        .iter()
        .map(|&size| -> anyhow::Result<_> {
            let path = folder.path().join("part");
            film::write(
                &path,
                MOVING,
                "x264enc speed-preset=ultrafast key-int-max=10 ! mpegtsmux",
                size,
                20,
            )?;
            Ok(std::fs::read(path)?)
        })
        .collect::<Result<_, _>>()?;
    for _ in 0..effort.pick(1, 20) {
        let joined: Vec<u8> =
            (0..4).flat_map(|_| parts[rng.random_range(0..parts.len())].iter().copied()).collect();
        let path = folder.path().join("joined.ts");
        std::fs::write(&path, joined)?;
        same(&mut outcome, &format!("filesrc location={} ! decodebin", path.display()), "joined films")?;
    }
    for _ in 0..effort.pick(1, 10) {
        jpegs(folder.path(), &mut rng)?;
        let pattern = folder.path().join("%02d.jpg");
        let source = format!(
            "multifilesrc location={} start-index=0 stop-index=19 caps=image/jpeg,framerate=30/1 ! jpegdec",
            pattern.display()
        );
        same(&mut outcome, &source, "JPEGs of many sizes")?;
    }
    for _ in 0..effort.pick(2, 20) {
        same(&mut outcome, &joined_sources(&mut rng), "joined sources")?;
    }
    Ok(outcome)
}

/// Twenty pictures, of one size for some and then of another.
fn jpegs(folder: &Path, rng: &mut ChaCha8Rng) -> anyhow::Result<()> {
    let mut size = (64, 48);
    for number in 0..20 {
        if rng.random_bool(0.4) {
            size = (rng.random_range(8..200), rng.random_range(8..200));
        }
        film::write(&folder.join(format!("{number:02}.jpg")), MOVING, "jpegenc", size, 1)?;
    }
    Ok(())
}

fn joined_sources(rng: &mut ChaCha8Rng) -> String {
    let formats = ["I420", "NV12", "RGB", "GRAY8", "YUY2", "I420_10LE"];
    let part = |rng: &mut ChaCha8Rng| {
        format!(
            "videotestsrc pattern=ball num-buffers={} ! video/x-raw,format={},width={},height={},framerate={}/1 ! c. ",
            rng.random_range(1..15),
            formats[rng.random_range(0..formats.len())],
            rng.random_range(1..200),
            rng.random_range(1..200),
            [25, 30, 50][rng.random_range(0..3)]
        )
    };
    let parts: String = (0..4).map(|_| part(rng)).collect();
    format!("{parts} concat name=c")
}

/// Plays a source through the element and through `identity`; whether `identity` itself plays it twice
/// in the same way, without which nothing is counted.
fn same(outcome: &mut Outcome, source: &str, what: &str) -> anyhow::Result<bool> {
    let play = |filter: &str| -> anyhow::Result<(End, Vec<Arrival>)> {
        // The element's caps are a subset of what decoders put out.
        let player =
            Player::new(&format!("{source} ! videoconvert ! {filter} ! fakesink name=sink sync=false"))?;
        Ok(player.play(PATIENCE))
    };
    let takes = "video/x-raw";
    let wanted = play(&format!("{takes} ! identity"))?;
    if wanted != play(&format!("{takes} ! identity"))? {
        return Ok(false);
    }
    outcome.tried += 1;
    let (end, mut got) = play("rsrectify")?;
    match end {
        End::Hung if wanted.0 != End::Hung => {
            outcome.hung += 1;
            outcome.fault(format!("{what}: no end"));
        }
        // Frames that are held when a stream breaks off without an end are stopped, not lost.
        End::Error
            if wanted.0 == End::Error && wanted.1.starts_with(&got) && wanted.1.len() <= got.len() + 4 =>
        {
            got.extend_from_slice(&wanted.1[got.len()..]);
        }
        _ if end != wanted.0 => outcome.fault(format!("{what}: ends with {end:?}, not {:?}", wanted.0)),
        _ => (),
    }
    outcome.compare(&wanted.1, &got, what);
    Ok(true)
}
