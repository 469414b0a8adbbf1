// SPDX-License-Identifier: MIT OR Apache-2.0

//! The attacks, from the command line.

use clap::{Args, Parser, Subcommand};
use reliability::child::{self, Amount};
use reliability::outcome::Outcome;
use reliability::soak::{self, Effort};
use reliability::{fuzz, page, saved};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Attacks the element and counts what becomes of the frames.
#[derive(Parser)]
struct Options {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Random sequences; one that goes wrong is told with its seed
    Fuzz {
        #[command(flatten)]
        amount: Sequences,
    },
    /// All other attacks, or one of them
    Soak {
        /// Its name
        attack: Option<String>,
        #[command(flatten)]
        effort: EffortArgs,
    },
    /// Everything at full length; writes docs/reliability.md
    Report {
        /// Time for random sequences
        #[arg(long, default_value_t = 3600)]
        seconds: u64,
        /// Seed of the first sequence
        #[arg(long, default_value_t = 0)]
        seed: u64,
        /// Only write the page, from the outcomes of the last runs at full length
        #[arg(long)]
        saved: bool,
        /// Where the page goes
        #[arg(long, default_value = "docs/reliability.md")]
        out: PathBuf,
    },
    /// One attack in this process; the others use it
    #[command(hide = true)]
    Child {
        attack: String,
        #[command(flatten)]
        effort: EffortArgs,
        #[command(flatten)]
        amount: Sequences,
    },
}

#[derive(Args)]
struct Sequences {
    /// How many
    #[arg(long, conflicts_with = "seconds")]
    sequences: Option<u64>,
    /// For how long
    #[arg(long, default_value_t = 60)]
    seconds: u64,
    /// Seed of the first one
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

impl Sequences {
    fn amount(&self) -> Amount {
        match self.sequences {
            Some(count) => Amount::Sequences(count),
            None => Amount::Time(Duration::from_secs(self.seconds)),
        }
    }
}

#[derive(Args)]
struct EffortArgs {
    /// In seconds, as for each change
    #[arg(long, conflicts_with = "long")]
    short: bool,
    /// At full length, the default
    #[arg(long)]
    long: bool,
}

impl EffortArgs {
    fn effort(&self) -> Effort {
        if self.short { Effort::Short } else { Effort::Long }
    }
}

fn main() -> anyhow::Result<()> {
    match Options::parse().command {
        Command::Fuzz { amount } => {
            let outcome = random_sequences(amount.seed, amount.amount())?;
            fail_unless(outcome.is_clean())
        }
        Command::Soak { attack, effort } => {
            let attacks: Vec<_> = match attack {
                Some(name) => vec![soak::find(&name)?],
                // What depends on time says little beside other work.
                None => soak::ATTACKS.iter().filter(|attack| !(effort.short && attack.times)).collect(),
            };
            let mut clean = true;
            for attack in attacks {
                clean &= run(attack, effort.effort())?.is_clean();
            }
            fail_unless(clean)
        }
        Command::Report { seconds, seed, saved, out } => {
            if !saved {
                random_sequences(seed, Amount::Time(Duration::from_secs(seconds)))?;
                soak::ATTACKS.iter().try_for_each(|attack| run(attack, Effort::Long).map(|_| ()))?;
            }
            let fuzzed = saved::last("fuzz")?;
            let outcomes: Vec<_> = soak::ATTACKS
                .iter()
                .map(|attack| saved::last(attack.name).map(|outcome| (attack, outcome)))
                .collect::<Result<_, _>>()?;
            std::fs::write(out, page::write(&fuzzed, &outcomes))?;
            fail_unless(fuzzed.is_clean() && outcomes.iter().all(|(_, outcome)| outcome.is_clean()))
        }
        Command::Child { attack, amount, .. } if attack == "fuzz" => sequences(amount.seed, amount.amount()),
        Command::Child { attack, effort, .. } => {
            fuzz::init()?;
            let mut outcome = (soak::find(&attack)?.run)(effort.effort())?;
            for complaint in fuzz::complaints() {
                outcome.fault(format!("GLib complains: {complaint}"));
            }
            println!("{}", serde_json::to_string(&outcome)?);
            Ok(())
        }
    }
}

/// Runs sequences and says what became of them; kept if they ran for some time.
fn random_sequences(seed: u64, amount: Amount) -> anyhow::Result<Outcome> {
    let outcome = child::fuzz(seed, amount, |text| eprintln!("{text}"))?;
    tell("fuzz", &outcome);
    if matches!(amount, Amount::Time(_)) {
        saved::keep("fuzz", &outcome)?;
    }
    Ok(outcome)
}

/// Runs an attack and says what became of it; kept if it ran at full length.
fn run(attack: &soak::Attack, effort: Effort) -> anyhow::Result<Outcome> {
    let outcome = child::attack(attack, effort)?;
    tell(attack.name, &outcome);
    if effort == Effort::Long {
        saved::keep(attack.name, &outcome)?;
    }
    Ok(outcome)
}

/// Runs sequences one after another and prints the verdict of each.
fn sequences(seed: u64, amount: Amount) -> anyhow::Result<()> {
    fuzz::watch(fuzz::PATIENCE);
    let start = Instant::now();
    for (done, seed) in (seed..).enumerate() {
        let enough = match amount {
            Amount::Sequences(count) => done as u64 == count,
            Amount::Time(time) => start.elapsed() >= time,
        };
        if enough {
            break;
        }
        let mut verdict = fuzz::run(seed)?;
        if verdict.faults.is_empty() {
            verdict.trace.clear();
        }
        println!("{}", serde_json::to_string(&verdict)?);
    }
    Ok(())
}

fn tell(name: &str, outcome: &Outcome) {
    let Outcome { tried, frames, lost, doubled, changed, crashed, hung, notes, faults } = outcome;
    println!(
        "{name}: {tried} tried, {frames} frames: {lost} lost, {doubled} doubled, {changed} changed, \
         {crashed} crashed, {hung} hung"
    );
    notes.iter().for_each(|note| println!("  {note}"));
    faults.iter().take(20).for_each(|fault| println!("  ! {fault}"));
    if faults.len() > 20 {
        println!("  ! and {} more", faults.len() - 20);
    }
}

fn fail_unless(clean: bool) -> anyhow::Result<()> {
    anyhow::ensure!(clean, "something is wrong");
    Ok(())
}
