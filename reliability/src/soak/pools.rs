// SPDX-License-Identifier: MIT OR Apache-2.0

//! Upstreams with a fixed number of buffers, as cameras and hardware decoders have.

use super::effort::Effort;
use super::playback::Player;
use crate::outcome::Outcome;
use gst::prelude::*;
use std::time::{Duration, Instant};

const FRAMES: usize = 24;

/// Fixed pools of any small size.
pub fn fixed(effort: Effort) -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    let all: Vec<u32> = (1..=8).collect();
    let buffers = effort.pick(vec![1, 2, 4, 6], all);
    let lookaheads = effort.pick(vec![0, 4, 8], (0..=8).collect());
    for &buffers in &buffers {
        for &lookahead in &lookaheads {
            stream(&mut outcome, buffers, lookahead, effort.pick(3, 10))?;
        }
    }
    Ok(outcome)
}

fn stream(outcome: &mut Outcome, buffers: u32, lookahead: u32, patience: u64) -> anyhow::Result<()> {
    outcome.tried += 1;
    let what = format!("{buffers} buffers, lookahead {lookahead}");
    let player = Player::new(&format!(
        "appsrc name=source format=time ! rsrectify lookahead={lookahead} \
         ! fakesink name=sink sync=false enable-last-sample=false"
    ))?;
    let source =
        player.pipeline.by_name("source").and_then(|source| source.downcast::<gst_app::AppSrc>().ok());
    let source = source.ok_or_else(|| anyhow::anyhow!("no source"))?;
    let info = gst_video::VideoInfo::builder(gst_video::VideoFormat::I420, 160, 120).fps((30, 1)).build()?;
    let caps = info.to_caps()?;
    source.set_caps(Some(&caps));
    let pool = gst_video::VideoBufferPool::new();
    let mut config = pool.config();
    config.set_params(Some(&caps), info.size() as u32, buffers, buffers);
    pool.set_config(config)?;
    pool.set_active(true)?;
    player.pipeline.set_state(gst::State::Playing)?;
    let time = |number: usize| gst::ClockTime::from_nseconds(number as u64 * 1_000_000_000 / 30);
    for number in 0..FRAMES {
        let Some(mut buffer) = acquire(&pool, Duration::from_secs(patience)) else {
            outcome.hung += 1;
            outcome.fault(format!("{what}: no buffer for frame {number}"));
            break;
        };
        let inner = buffer.make_mut();
        inner.set_pts(time(number));
        if let Ok(mut map) = inner.map_writable() {
            map.iter_mut().enumerate().for_each(|(i, byte)| *byte = ((i + 5 * number) / 7 * 31) as u8);
        }
        source.push_buffer(buffer)?;
    }
    source.end_of_stream()?;
    player.wait_for_end(Duration::from_secs(patience));
    let got: Vec<_> = player.arrivals().iter().map(|arrival| arrival.pts).collect();
    let wanted: Vec<_> = (0..FRAMES).map(|number| Some(time(number))).collect();
    outcome.compare(&wanted, &got, &what);
    // Whoever waits for a buffer is let go.
    pool.set_flushing(true);
    drop(player);
    pool.set_active(false)?;
    Ok(())
}

/// A buffer of the pool as soon as one is free; none when the time is over.
fn acquire(pool: &gst_video::VideoBufferPool, patience: Duration) -> Option<gst::Buffer> {
    let end = Instant::now() + patience;
    let at_once = gst::BufferPoolAcquireParams::with_flags(gst::BufferPoolAcquireFlags::DONTWAIT);
    while Instant::now() < end {
        if let Ok(buffer) = pool.acquire_buffer(Some(&at_once)) {
            return Some(buffer);
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    None
}
