// SPDX-License-Identifier: MIT OR Apache-2.0

//! Seeks, rates, loops and pauses over a film of numbered frames.

use super::effort::Effort;
use super::film;
use super::playback::PATIENCE;
use super::playback::{Arrival, End, Player};
use crate::outcome::Outcome;
use gst::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use std::time::Duration;

const FRAMES: usize = 90;

fn player(film: &Path, filter: &str) -> anyhow::Result<Player> {
    Player::new(&format!(
        "filesrc location={} ! decodebin ! videoconvert ! video/x-raw,format=I420 ! {filter} \
         ! fakesink name=sink sync=false",
        film.display()
    ))
}

fn written(folder: &Path) -> anyhow::Result<std::path::PathBuf> {
    let film = folder.join("numbered.mp4");
    film::write_numbered(&film, FRAMES)?;
    Ok(film)
}

/// A seek, and how the film is then played.
#[derive(Clone, Copy, Debug)]
struct Seek {
    rate: f64,
    flags: gst::SeekFlags,
    start: u64,
    stop: Option<u64>,
}

impl Seek {
    fn event(&self) -> gst::Event {
        let stop = self.stop.map(gst::ClockTime::from_nseconds);
        let start = gst::ClockTime::from_nseconds(self.start);
        gst::event::Seek::new(self.rate, self.flags, gst::SeekType::Set, start, gst::SeekType::Set, stop)
    }
}

/// Accurate seeks to random times.
pub fn random(effort: Effort) -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    let folder = tempfile::tempdir()?;
    let film = written(folder.path())?;
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let filters: &[&str] =
        effort.pick(&["rsrectify"], &["rsrectify", "rsrectify lookahead=0", "rsrectify lookahead=12"]);
    for filter in filters {
        let seeks: Vec<(Seek, bool)> = (0..effort.pick(14, 60))
            .map(|_| {
                let start = rng.random_range(0..2_900_000_000);
                let stop = rng.random_bool(0.5).then(|| rng.random_range(start + 1..3_000_000_000));
                let flags = gst::SeekFlags::FLUSH | gst::SeekFlags::ACCURATE;
                (Seek { rate: 1.0, flags, start, stop }, rng.random())
            })
            .collect();
        let truth = after_seeks(&player(&film, "identity")?, &seeks)?;
        let got = after_seeks(&player(&film, filter)?, &seeks)?;
        for (index, (wanted, got)) in truth.iter().zip(&got).enumerate() {
            outcome.tried += 1;
            let what = format!("{filter}, seek {index} {:?}", seeks[index].0);
            outcome.hung += u64::from(got.0 == End::Hung);
            outcome.compare(&wanted.1, &got.1, &what);
        }
    }
    Ok(outcome)
}

/// What arrives after each of some seeks, made while paused or while playing.
fn after_seeks(player: &Player, seeks: &[(Seek, bool)]) -> anyhow::Result<Vec<(End, Vec<Arrival>)>> {
    player.go_to(gst::State::Paused, PATIENCE);
    let mut results = Vec::new();
    for (seek, playing) in seeks {
        // In mid-stream or not, the seek flushes.
        player.go_to(if *playing { gst::State::Playing } else { gst::State::Paused }, PATIENCE);
        let taken = player.pipeline.send_event(seek.event());
        anyhow::ensure!(taken, "no seek: {seek:?}");
        anyhow::ensure!(player.settled(PATIENCE), "no preroll after {seek:?}");
        player.pipeline.set_state(gst::State::Playing)?;
        results.push((player.wait_for_end(PATIENCE), player.arrivals()));
    }
    Ok(results)
}

/// Other ways to play a film.
pub fn playback(effort: Effort) -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    let folder = tempfile::tempdir()?;
    let film = written(folder.path())?;
    let accurate = gst::SeekFlags::FLUSH | gst::SeekFlags::ACCURATE;
    let second = 1_000_000_000;
    let ways = [
        Seek { rate: -1.0, flags: accurate, start: 0, stop: Some(3 * second) },
        Seek { rate: -1.0, flags: accurate, start: second / 2, stop: Some(2 * second) },
        Seek { rate: 2.0, flags: accurate, start: 0, stop: None },
        Seek { rate: 0.25, flags: accurate, start: second, stop: Some(2 * second) },
        Seek { rate: -3.0, flags: accurate, start: second, stop: Some(2 * second) },
        Seek { rate: 1.0, flags: accurate | gst::SeekFlags::SEGMENT, start: second, stop: Some(2 * second) },
        Seek { rate: 4.0, flags: accurate | gst::SeekFlags::TRICKMODE, start: 0, stop: None },
        Seek {
            rate: 1.0,
            flags: gst::SeekFlags::FLUSH | gst::SeekFlags::KEY_UNIT,
            start: second,
            stop: None,
        },
    ];
    let filters: &[&str] =
        effort.pick(&["rsrectify"], &["rsrectify", "rsrectify lookahead=0", "rsrectify lookahead=64"]);
    for filter in filters {
        for way in &ways[..effort.pick(2, ways.len())] {
            outcome.tried += 1;
            let seeks = [(*way, false)];
            let wanted = after_seeks(&player(&film, "identity")?, &seeks)?;
            let got = after_seeks(&player(&film, filter)?, &seeks)?;
            outcome.hung += u64::from(got[0].0 == End::Hung);
            outcome.compare(&wanted[0].1, &got[0].1, &format!("{filter}, {way:?}"));
        }
        outcome.tried += 2;
        looped(&mut outcome, &film, filter)?;
        paused(&mut outcome, &film, filter)?;
    }
    Ok(outcome)
}

/// A segment played three times without a flush between.
fn looped(outcome: &mut Outcome, film: &Path, filter: &str) -> anyhow::Result<()> {
    let play = |filter: &str| -> anyhow::Result<Vec<Arrival>> {
        let player = player(film, filter)?;
        let segment = gst::SeekFlags::ACCURATE | gst::SeekFlags::SEGMENT;
        let first = Seek {
            rate: 1.0,
            flags: segment | gst::SeekFlags::FLUSH,
            start: 500_000_000,
            stop: Some(1_000_000_000),
        };
        player.go_to(gst::State::Paused, PATIENCE);
        player.pipeline.send_event(first.event());
        anyhow::ensure!(player.settled(PATIENCE), "no preroll");
        player.pipeline.set_state(gst::State::Playing)?;
        for round in 1..=3 {
            player.wait_for_ends(round, PATIENCE);
            if round < 3 {
                player.pipeline.send_event(Seek { flags: segment, ..first }.event());
            }
        }
        Ok(player.arrivals())
    };
    outcome.compare(&play("identity")?, &play(filter)?, &format!("{filter}, looped"));
    Ok(())
}

/// A film that is paused and resumed at random.
fn paused(outcome: &mut Outcome, film: &Path, filter: &str) -> anyhow::Result<()> {
    let play = |filter: &str, pauses: usize| -> anyhow::Result<(End, Vec<Arrival>)> {
        let player = player(film, filter)?;
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        for _ in 0..pauses {
            player.pipeline.set_state(gst::State::Playing)?;
            std::thread::sleep(Duration::from_micros(rng.random_range(0..5000)));
            player.pipeline.set_state(gst::State::Paused)?;
            if rng.random() {
                player.settled(PATIENCE);
            }
        }
        Ok(player.play(PATIENCE))
    };
    let (wanted, got) = (play("identity", 0)?, play(filter, 30)?);
    outcome.hung += u64::from(got.0 == End::Hung);
    outcome.compare(&wanted.1, &got.1, &format!("{filter}, paused and resumed"));
    Ok(())
}
