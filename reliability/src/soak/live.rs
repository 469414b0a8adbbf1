// SPDX-License-Identifier: MIT OR Apache-2.0

//! Live sources that do not say at what rate their frames come, or say it wrong.

use super::effort::Effort;
use super::playback::PATIENCE;
use super::playback::Player;
use crate::outcome::Outcome;
use gst::prelude::*;

/// Frames that a sink may drop before the rate has been learnt.
const TOLERATED: u64 = 3;

const PICTURE: &str = "videotestsrc is-live=true pattern=smpte75 horizontal-speed=3";

/// Live sources.
pub fn sources(effort: Effort) -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    let frames = effort.pick(60, 180);
    let raw = |delivered: u32, told: u32| {
        format!(
            "{PICTURE} num-buffers={frames} ! video/x-raw,format=I420,width=320,height=240,framerate={delivered}/1 \
             ! capssetter caps=video/x-raw,framerate={told}/1"
        )
    };
    // As a stream from the network: the sender in a bin of its own.
    let rtp = format!(
        "{PICTURE} num-buffers={frames} ! video/x-raw,width=320,height=240,framerate=30/1 \
         ! vp8enc deadline=1 cpu-used=8 ! rtpvp8pay ! rtpjitterbuffer latency=20 ! rtpvp8depay ! vp8dec"
    );
    let sources = [
        ("no rate, 30 delivered", raw(30, 0)),
        ("30 told, 15 delivered", raw(15, 30)),
        ("VP8 over RTP", rtp),
    ];
    for (what, source) in &sources {
        for lookahead in [4, 8] {
            outcome.tried += 1;
            judge(&mut outcome, what, source, lookahead)?;
        }
    }
    for lookahead in [4, 8] {
        outcome.tried += 1;
        loopback(&mut outcome, frames, lookahead)?;
    }
    Ok(outcome)
}

fn receiver(source: &str, lookahead: u32) -> anyhow::Result<Player> {
    Player::new(&format!(
        "{source} ! videoconvert ! rsrectify name=filter lookahead={lookahead} \
         ! fakesink name=sink sync=true qos=true max-lateness=20000000"
    ))
}

fn judge(outcome: &mut Outcome, what: &str, source: &str, lookahead: u32) -> anyhow::Result<()> {
    let player = receiver(source, lookahead)?;
    handle_latency(&player);
    player.play(PATIENCE);
    report(outcome, &player, &format!("{what}, lookahead {lookahead}"));
    Ok(())
}

/// Does what `GstBin` leaves to applications.
fn handle_latency(player: &Player) {
    let pipeline = player.pipeline.downgrade();
    let Some(bus) = player.pipeline.bus() else { return };
    bus.set_sync_handler(move |_, message| {
        if message.type_() == gst::MessageType::Latency
            && let Some(pipeline) = pipeline.upgrade()
        {
            pipeline.call_async(|pipeline| {
                let _ = pipeline.recalculate_latency();
            });
        }
        gst::BusSyncReply::Pass
    });
}

fn report(outcome: &mut Outcome, player: &Player, what: &str) {
    let Some(sink) = player.pipeline.by_name("sink") else { return };
    let stats = sink.property::<gst::Structure>("stats");
    let count = |name: &str| stats.get::<u64>(name).unwrap_or(0);
    let (rendered, dropped) = (count("rendered"), count("dropped"));
    outcome.frames += rendered + dropped;
    let late = player
        .pipeline
        .by_name("filter")
        .and_then(|filter| filter.property::<gst::Structure>("stats").get::<u64>("late").ok());
    outcome.notes.push(format!(
        "{what}: {dropped} of {} dropped, {} left unrectified",
        rendered + dropped,
        late.unwrap_or(0)
    ));
    if dropped > TOLERATED || rendered == 0 {
        outcome.lost += dropped;
        outcome.fault(format!("{what}: {dropped} of {} dropped", rendered + dropped));
    }
}

/// VP8 over UDP to this machine itself.
fn loopback(outcome: &mut Outcome, frames: u32, lookahead: u32) -> anyhow::Result<()> {
    let caps = "application/x-rtp,media=video,clock-rate=90000,encoding-name=VP8,payload=96";
    let source = format!(
        "udpsrc address=127.0.0.1 port=0 name=receiver caps={caps} ! rtpjitterbuffer latency=20 ! rtpvp8depay ! vp8dec"
    );
    let player = receiver(&source, lookahead)?;
    handle_latency(&player);
    player.pipeline.set_state(gst::State::Ready)?;
    let port = player.pipeline.by_name("receiver").map(|source| source.property::<i32>("port"));
    let sender = Player::new(&format!(
        "{PICTURE} num-buffers={frames} ! video/x-raw,width=320,height=240,framerate=30/1 \
         ! vp8enc deadline=1 cpu-used=8 ! rtpvp8pay ! udpsink name=sink host=127.0.0.1 port={} sync=false",
        port.unwrap_or(0)
    ))?;
    player.pipeline.set_state(gst::State::Playing)?;
    sender.play(PATIENCE);
    std::thread::sleep(std::time::Duration::from_millis(500));
    player.pipeline.send_event(gst::event::Eos::new());
    player.wait_for_end(PATIENCE);
    report(outcome, &player, &format!("VP8 over UDP, lookahead {lookahead}"));
    Ok(())
}
