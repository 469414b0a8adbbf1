// SPDX-License-Identifier: MIT OR Apache-2.0

//! Films made by GStreamer's own encoders: of numbered frames, of moving pictures, in any container.

use super::numbered::{NUMBERED, feed};
use super::playback::Player;
use anyhow::Context;
use std::path::Path;
use std::time::Duration;

/// Writes a film of numbered frames, in groups of 15 pictures.
pub fn write_numbered(path: &Path, frames: usize) -> anyhow::Result<()> {
    let player = Player::new(&format!(
        "{NUMBERED} ! x264enc key-int-max=15 speed-preset=ultrafast ! mp4mux \
         ! filesink name=sink location={}",
        path.display()
    ))?;
    feed(&player.pipeline, frames)?;
    finish(&player, path)
}

/// A pattern of `videotestsrc` that moves.
pub const MOVING: &str = "smpte75 horizontal-speed=3";

/// Writes a pattern through an encoder and a muxer.
pub fn write(
    path: &Path,
    pattern: &str,
    encoder: &str,
    size: (u32, u32),
    frames: usize,
) -> anyhow::Result<()> {
    let (width, height) = size;
    let player = Player::new(&format!(
        "videotestsrc pattern={pattern} num-buffers={frames} \
         ! video/x-raw,format=I420,width={width},height={height},framerate=30/1 ! {encoder} \
         ! filesink name=sink location={}",
        path.display()
    ))?;
    finish(&player, path)
}

fn finish(player: &Player, path: &Path) -> anyhow::Result<()> {
    player.write_out(Duration::from_secs(60)).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::soak::playback::PATIENCE;

    #[test]
    fn numbers_survive_the_encoder() {
        gst::init().unwrap();
        let folder = tempfile::tempdir().unwrap();
        let film = folder.path().join("numbered.mp4");
        write_numbered(&film, 90).unwrap();
        let description = format!(
            "filesrc location={} ! decodebin ! videoconvert ! video/x-raw,format=I420 ! fakesink name=sink",
            film.display()
        );
        let (_, arrivals) = Player::new(&description).unwrap().play(PATIENCE);
        let numbers: Vec<_> = arrivals.iter().map(|arrival| arrival.number).collect();
        assert_eq!(numbers, (0..90).map(Some).collect::<Vec<_>>());
    }
}
