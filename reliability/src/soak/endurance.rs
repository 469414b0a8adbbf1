// SPDX-License-Identifier: MIT OR Apache-2.0

//! Long films, many starts, many elements.

use super::effort::Effort;
use super::playback::PATIENCE;
use super::playback::{End, Player};
use super::process::Usage;
use crate::outcome::Outcome;
use gst::prelude::*;
use std::time::{Duration, Instant};

fn times(frames: u64) -> Vec<Option<gst::ClockTime>> {
    (0..frames).map(|number| Some(gst::ClockTime::from_nseconds(number * 1_000_000_000 / 30))).collect()
}

fn description(frames: u64, filter: &str) -> String {
    format!(
        "videotestsrc pattern=smpte75 horizontal-speed=3 num-buffers={frames} \
         ! video/x-raw,format=I420,width=160,height=120,framerate=30/1 ! {filter} \
         ! fakesink name=sink sync=false"
    )
}

/// A long film; after a fifth of it nothing may grow.
pub fn long_film(effort: Effort) -> anyhow::Result<Outcome> {
    let mut outcome = Outcome { tried: 1, ..Outcome::default() };
    let frames = effort.pick(500, 10_000);
    let player = Player::new(&description(frames, "rsrectify post-messages=true"))?;
    // Messages that nobody takes would pile up.
    if let Some(bus) = player.pipeline.bus() {
        bus.set_sync_handler(|_, _| gst::BusSyncReply::Drop);
    }
    player.pipeline.set_state(gst::State::Playing)?;
    player.wait_for_frames(frames as usize / 5, 10 * PATIENCE);
    let early = Usage::now()?;
    player.wait_for_frames(frames as usize - 10, 60 * PATIENCE);
    let late = Usage::now()?;
    outcome.hung += u64::from(player.wait_for_end(PATIENCE) == End::Hung);
    let got: Vec<_> = player.arrivals().iter().map(|arrival| arrival.pts).collect();
    outcome.compare(&times(frames), &got, "a long film");
    level(&mut outcome, &early, &late);
    Ok(outcome)
}

/// What an allocator may keep of freed memory, in kilobytes.
const SLACK: u64 = 16_000;

fn level(outcome: &mut Outcome, early: &Usage, late: &Usage) {
    if let Some(growth) = early.growth(late, SLACK) {
        outcome.fault(growth);
    }
    let grown = late.memory.saturating_sub(early.memory).div_ceil(1000);
    outcome.notes.push(format!("memory grew by {grown} MB at most, threads and file descriptors by none"));
}

/// Stops in mid-stream and starts again, with elements kept and with new ones.
pub fn restarts(effort: Effort) -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    let starts = effort.pick(30, 200);
    let warm = starts / 4;
    let kept = Player::new(&description(1_000_000, "rsrectify threads=2"))?;
    let mut early = None;
    for start in 0..starts {
        outcome.tried += 2;
        let fresh = Player::new(&description(1_000_000, "rsrectify threads=3 lookahead=8"))?;
        for player in [&kept, &fresh] {
            let before = player.arrivals().len();
            player.pipeline.set_state(gst::State::Playing)?;
            if !player.wait_for_frames(before + 3 + start % 7, PATIENCE) {
                outcome.hung += 1;
            }
            if let Some(error) = player.error() {
                outcome.fault(error);
            }
            player.pipeline.set_state(gst::State::Null)?;
            let all = player.arrivals();
            let got: Vec<_> = all[before..].iter().map(|arrival| arrival.pts).collect();
            outcome.compare(&times(got.len() as u64), &got, &format!("start {start}"));
        }
        drop(fresh);
        if start == warm {
            early = Some(Usage::now()?);
        }
    }
    if let Some(early) = early {
        level(&mut outcome, &early, &late_usage(&early)?);
    }
    Ok(outcome)
}

/// What is in use in the end. Threads that have been told to end, and what they hold of memory, take their time on a busy
/// machine; what is leaked stays.
fn late_usage(early: &Usage) -> anyhow::Result<Usage> {
    let begin = Instant::now();
    loop {
        let late = Usage::now()?;
        if early.growth(&late, SLACK).is_none() || begin.elapsed() > PATIENCE {
            return Ok(late);
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Many elements at a time.
pub fn many_elements(effort: Effort) -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    let (count, frames) = effort.pick((16, 10), (64, 60));
    let players: Vec<_> = (0..count)
        .map(|number| Player::new(&description(frames, &format!("rsrectify lookahead={}", number % 9))))
        .collect::<Result<_, _>>()?;
    for player in &players {
        player.pipeline.set_state(gst::State::Playing)?;
    }
    for player in &players {
        outcome.tried += 1;
        outcome.hung += u64::from(player.wait_for_end(10 * PATIENCE) == End::Hung);
        let got: Vec<_> = player.arrivals().iter().map(|arrival| arrival.pts).collect();
        outcome.compare(&times(frames), &got, "one of many");
    }
    Ok(outcome)
}
