// SPDX-License-Identifier: MIT OR Apache-2.0

//! Attacks run in processes of their own, so that one that dies or hangs is counted like any other.

use crate::fuzz::{HUNG, Verdict};
use crate::outcome::Outcome;
use crate::soak::{Attack, Effort};
use anyhow::Context;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// This program again, with other arguments.
fn again(args: &[String]) -> anyhow::Result<Command> {
    let mut command = Command::new(std::env::current_exe().context("who am I?")?);
    command.args(args).stdout(Stdio::piped()).stdin(Stdio::null());
    Ok(command)
}

/// Waits for a process, but not for ever.
fn wait(child: &mut Child, limit: Duration) -> anyhow::Result<Option<ExitStatus>> {
    let end = Instant::now() + limit;
    while Instant::now() < end {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    child.kill()?;
    child.wait()?;
    Ok(None)
}

/// Runs an attack.
pub fn attack(attack: &Attack, effort: Effort) -> anyhow::Result<Outcome> {
    let (flag, minutes) = match effort {
        Effort::Short => ("--short", 5),
        Effort::Long => ("--long", 60),
    };
    let mut command = again(&["child".into(), attack.name.into(), flag.into()])?;
    if let Some(tracers) = attack.tracers {
        command.env("GST_TRACERS", tracers);
    }
    let mut child = command.spawn()?;
    let mut output = child.stdout.take().context("no output")?;
    let reader = std::thread::spawn(move || {
        let mut text = String::new();
        output.read_to_string(&mut text).map(|_| text)
    });
    let status = wait(&mut child, Duration::from_secs(60 * minutes))?;
    let text = reader.join().map_err(|_| anyhow::anyhow!("cannot read"))??;
    let mut outcome = match text.lines().last().map(serde_json::from_str::<Outcome>) {
        Some(Ok(outcome)) => outcome,
        _ => Outcome { tried: 1, ..Outcome::default() },
    };
    match status {
        None => {
            outcome.hung += 1;
            outcome.fault("the process did not end");
        }
        Some(status) if !status.success() => {
            outcome.crashed += 1;
            outcome.fault(format!("the process ended with {status}"));
        }
        Some(_) => (),
    }
    Ok(outcome)
}

/// How many sequences to run.
#[derive(Clone, Copy, Debug)]
pub enum Amount {
    /// So many.
    Sequences(u64),
    /// As many as can be done in this time.
    Time(Duration),
}

/// Runs random sequences from a seed on; `tell` is given each that went wrong.
pub fn fuzz(seed: u64, amount: Amount, mut tell: impl FnMut(&str)) -> anyhow::Result<Outcome> {
    let start = Instant::now();
    let mut outcome = Outcome::default();
    let mut repeatable = 0u64;
    let mut next = seed;
    loop {
        let left = match amount {
            Amount::Sequences(count) => ["--sequences".into(), (seed + count - next).to_string()],
            Amount::Time(time) => {
                ["--seconds".into(), time.saturating_sub(start.elapsed()).as_secs().to_string()]
            }
        };
        if left[1] == "0" {
            break;
        }
        let args = [vec!["child".into(), "fuzz".into(), "--seed".into(), next.to_string()], left.to_vec()];
        let mut child = again(&args.concat())?.spawn()?;
        let output = child.stdout.take().context("no output")?;
        for line in BufReader::new(output).lines() {
            let verdict: Verdict = serde_json::from_str(&line?)?;
            next = verdict.seed + 1;
            repeatable += u64::from(verdict.repeatable);
            if !verdict.faults.is_empty() {
                tell(&describe(&verdict));
            }
            outcome.add(Outcome {
                tried: 1,
                frames: verdict.tally.frames,
                lost: verdict.tally.lost,
                doubled: verdict.tally.doubled,
                changed: verdict.tally.changed,
                faults: verdict
                    .faults
                    .iter()
                    .map(|fault| format!("seed {}: {fault}", verdict.seed))
                    .collect(),
                ..Outcome::default()
            });
        }
        let status = child.wait()?;
        if status.success() {
            continue;
        }
        // The sequence after the last one that was told of.
        outcome.tried += 1;
        let hung = status.code() == Some(HUNG);
        outcome.hung += u64::from(hung);
        outcome.crashed += u64::from(!hung);
        let what = format!("seed {next}: the process ended with {status}");
        tell(&what);
        outcome.fault(what);
        next += 1;
    }
    outcome.notes.push(format!("{repeatable} of them without disturbing threads"));
    Ok(outcome)
}

fn describe(verdict: &Verdict) -> String {
    let threads = if verdict.repeatable { "one thread" } else { "several threads" };
    format!(
        "sequence {} ({threads}) went wrong:\n  {}\nits last steps:\n{}",
        verdict.seed,
        verdict.faults.join("\n  "),
        verdict.trace
    )
}
