// SPDX-License-Identifier: MIT OR Apache-2.0

//! The controller in pipelines whose times are simulated.

use super::*;

const MS: u64 = 1_000_000;
/// Frame interval.
const FRAME: u64 = 40 * MS;

/// What became of the frames of a simulated file pipeline.
#[derive(Debug, Default, PartialEq)]
struct Outcome {
    shown: usize,
    rectified: usize,
    /// Times that the work stopped or started again.
    switches: usize,
    /// Largest step of the correction from one frame to the next.
    pop: f64,
}

/// A source that is never late, our element, and a sink that drops what comes more than `tolerance` late.
/// `work(k)` is the time that frame k takes if it is worked on, a tenth of a millisecond otherwise.
fn simulate(frames: u64, tolerance: u64, work: impl Fn(u64) -> u64) -> Outcome {
    let mut load = Load::default();
    load.set_interval(FRAME);
    let (mut now, mut outcome, mut before) = (0i64, Outcome::default(), 1.0);
    for k in 0..frames {
        let due = (k * FRAME) as i64 + 20 * MS as i64;
        let share = match load.next(Some(k * FRAME)) {
            Effort::Full(share) => {
                load.count_work(work(k));
                now += work(k) as i64;
                share
            }
            Effort::None => {
                now += 100_000;
                0.0
            }
        };
        outcome.pop = f64::max(outcome.pop, (share - before).abs());
        outcome.switches += usize::from((share > 0.0) != (before > 0.0));
        before = share;
        let lateness = now - due;
        load.note(k * FRAME, lateness);
        if lateness <= tolerance as i64 {
            outcome.shown += 1;
            outcome.rectified += usize::from(share == 1.0);
            now = now.max(due);
        }
    }
    outcome
}

/// Frames shown of an element that drops late frames before working on them, by the rule of GStreamer's base
/// class: earliest = timestamp + 2 · lateness.
fn simulate_dropping(frames: u64, tolerance: u64, work: u64) -> usize {
    let (mut now, mut shown, mut earliest) = (0i64, 0, i64::MIN);
    for k in 0..frames {
        let running = (k * FRAME) as i64;
        if running <= earliest {
            continue;
        }
        now += work as i64;
        let lateness = now - running - 20 * MS as i64;
        earliest = running + if lateness > 0 { 2 * lateness } else { lateness };
        if lateness <= tolerance as i64 {
            shown += 1;
            now = now.max(running + 20 * MS as i64);
        }
    }
    shown
}

#[test]
fn nothing_is_skipped_while_the_work_fits() {
    for work in [1, 20, 39] {
        let outcome = simulate(300, 20 * MS, |_| work * MS);
        assert_eq!(outcome, Outcome { shown: 300, rectified: 300, ..Outcome::default() }, "{work} ms");
    }
}

#[test]
fn jitter_and_bursts_that_a_sink_tolerates_skip_nothing() {
    // 20 to 50 ms; every two seconds another program takes 100 ms.
    let outcome = simulate(2000, 1000 * MS, |k| {
        let random = k.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40;
        20 * MS + random % 30 * MS + if k % 50 == 20 { 100 * MS } else { 0 }
    });
    assert_eq!((outcome.shown, outcome.rectified), (2000, 2000), "{outcome:?}");
}

#[test]
fn a_steady_lateness_skips_nothing() {
    for late in [1, 3 * MS, 15 * MS] {
        let mut load = Load::default();
        load.set_interval(FRAME);
        for k in 0..300 {
            load.count_work(2 * MS);
            assert_eq!(load.next(Some(k * FRAME)), Effort::Full(1.0));
            assert_eq!(load.note(k * FRAME, late as i64 + (k as i64 * 7 % 5 - 2) * 100_000), Finding::Fine);
        }
    }
}

#[test]
fn under_overload_more_frames_are_shown_than_by_dropping() {
    for (work, tolerance) in [(44, 5), (50, 20), (60, 20), (80, 20), (120, 20), (400, 5)] {
        let ours = simulate(250, tolerance * MS, |_| work * MS);
        let dropping = simulate_dropping(250, tolerance * MS, work * MS);
        assert!(ours.shown >= dropping, "{work} ms: {ours:?}, {dropping} by dropping");
        assert_eq!(ours.switches, 1, "{work} ms: {ours:?}");
        assert!(ours.pop < 0.2, "{work} ms: {ours:?}");
    }
}

#[test]
fn the_work_comes_back_when_the_overload_is_over() {
    let outcome = simulate(1000, 20 * MS, |k| if (50..90).contains(&k) { 90 * MS } else { 10 * MS });
    assert_eq!(outcome.switches, 2, "{outcome:?}");
    assert!(outcome.rectified > 400 && outcome.pop < 0.2, "{outcome:?}");
}

#[test]
fn a_sink_that_falls_silent_is_not_late() {
    let mut load = Load::default();
    load.set_interval(FRAME);
    for k in 0..40 {
        load.next(Some(k * FRAME));
        load.note(k * FRAME, (k * 10 * MS) as i64);
    }
    assert_eq!(load.next(Some(40 * FRAME)), Effort::None);
    let back = (40..400).find(|&k| load.next(Some(k * FRAME)) != Effort::None).unwrap();
    assert!((60..75).contains(&back), "a second later, not {back}");
}

#[test]
fn overload_that_stays_is_tried_less_and_less_often() {
    // Frames are early by two intervals when nothing is done, as with a queue behind the element.
    let mut load = Load::default();
    load.set_interval(FRAME);
    let (mut lateness, mut tries, mut working) = (0i64, Vec::new(), true);
    for k in 0..6000 {
        let works = load.next(Some(k * FRAME)) != Effort::None;
        if works && !working {
            tries.push(k);
        }
        working = works;
        load.count_work(50 * MS);
        lateness = if works { lateness + 10 * MS as i64 + k as i64 % 3 } else { -2 * FRAME as i64 };
        load.note(k * FRAME, lateness);
    }
    let gaps: Vec<u64> = tries.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(gaps[..2].windows(2).all(|pair| pair[1] as f64 > 1.5 * pair[0] as f64), "{gaps:?}");
    assert!(gaps[3..].iter().all(|&gap| gap >= 200), "eight seconds: {gaps:?}");
}

#[test]
fn frames_that_come_steadily_late_because_of_the_work_ask_for_more_latency() {
    let mut load = Load::default();
    load.set_interval(FRAME);
    load.count_work(30 * MS);
    let findings: Vec<_> = (0..20).map(|k| load.note(k * FRAME, 12 * MS as i64)).collect();
    assert!(findings.contains(&Finding::Behind(12 * MS)));
    let mut load = Load::default();
    load.set_interval(FRAME);
    load.count_work(10 * MS);
    let findings: Vec<_> = (0..20).map(|k| load.note(k * FRAME, 300 * MS as i64)).collect();
    assert!(findings.contains(&Finding::Behind(10 * MS)), "no more than the work takes");
}

#[test]
fn a_flush_keeps_the_pause_but_not_its_clock() {
    let mut load = Load::default();
    load.set_interval(FRAME);
    for k in 0..40 {
        load.next(Some(1000 * FRAME + k * FRAME));
        load.note(1000 * FRAME + k * FRAME, (k * 10 * MS) as i64);
    }
    assert_eq!(load.next(Some(1040 * FRAME)), Effort::None);
    load.interrupt();
    let back = (0..400).find(|&k| load.next(Some(k * FRAME)) != Effort::None).unwrap();
    assert!((25..30).contains(&back), "a second of the new segment, not {back} frames");
}
