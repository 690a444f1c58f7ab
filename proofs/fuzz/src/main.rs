//! `fuzz`: hostile inputs for every reader and every message (`make fuzz`, `docs/fuzzing.md`).

use anyhow::{Context, Result, bail};
use clap::{Parser, Subcommand};
use fuzz::campaign::{self, TELLS};
use fuzz::corpus;
use fuzz::coverage::Coverage;
use fuzz::engine::{Engine, Limits, Outcome};
use fuzz::targets::{self, Target};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Hostile inputs for every reader and every message of vitreo.
#[derive(Debug, Parser)]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Try targets, each in a process of its own, and print a table.
    Run {
        /// Which ones: names, or kinds (wire, text, recording, scene); all of them without any.
        targets: Vec<String>,
        /// Where crashes, slow and new inputs are put.
        #[arg(long, value_name = "FOLDER", default_value = "out/fuzz")]
        out: PathBuf,
        #[command(flatten)]
        bounds: Bounds,
    },
    /// Try one target in this process.
    #[command(hide = true)]
    One {
        name: String,
        #[arg(long, value_name = "FOLDER")]
        out: PathBuf,
        #[command(flatten)]
        bounds: Bounds,
    },
    /// Say which targets there are.
    List,
    /// Run a target on files, as a crash that was found.
    Replay {
        /// Its name.
        name: String,
        /// Inputs.
        files: Vec<PathBuf>,
    },
    /// Keep of the new inputs of a campaign the smallest that reach every branch that all reach.
    Keep {
        /// Where the campaign put them.
        #[arg(long, value_name = "FOLDER", default_value = "out/fuzz")]
        out: PathBuf,
        /// Most bytes that are kept of a target.
        #[arg(long, default_value_t = 32 << 10)]
        bytes: usize,
    },
}

#[derive(Debug, clap::Args)]
struct Bounds {
    /// Time for each target, s [default: 60, or none where inputs are counted].
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// Inputs for each target.
    #[arg(long, value_name = "N")]
    inputs: Option<u64>,
    /// As many inputs as a whole campaign tries: 10⁸ a message, 10⁷ a text, 10⁶ the others.
    #[arg(long, conflicts_with = "inputs")]
    whole: bool,
    /// The same seed makes the same inputs, where time does not end them.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

impl Bounds {
    fn limits(&self, target: &Target) -> Limits {
        let inputs = if self.whole { Some(target.kind.asked()) } else { self.inputs };
        let seconds = self.seconds.or(inputs.is_none().then_some(60.0));
        Limits { time: seconds.map(|s| Duration::from_secs_f64(s.clamp(0.0, 1e7))), inputs }
    }
}

fn chosen(names: &[String]) -> Result<Vec<Target>> {
    let all = targets::all();
    for name in names {
        if !all.iter().any(|t| t.name == name || t.kind.name() == name) {
            bail!("{name}: no such target or kind; `fuzz list` lists them");
        }
    }
    let wanted = |t: &Target| names.is_empty() || names.iter().any(|n| n == t.name || n == t.kind.name());
    Ok(all.into_iter().filter(wanted).collect())
}

fn named(name: &str) -> Result<Target> {
    targets::named(name).with_context(|| format!("{name}: no such target; `fuzz list` lists them"))
}

fn one(target: Target, bounds: &Bounds, out: &Path) {
    fuzz::watch::bound_memory();
    let tell = |o: &Outcome| {
        println!("{TELLS}{}", o.to_line());
        let _ = std::io::stdout().flush();
    };
    let outcome = Engine::new(target, out).run(bounds.seed, bounds.limits(&target), tell);
    tell(&outcome);
}

/// The smallest inputs first: what one of them reaches, a larger one need not be kept for.
fn keep(target: Target, out: &Path, most: usize) -> Result<()> {
    let mut coverage = Coverage::default();
    let mut reaches_more = |input: &[u8]| {
        coverage.look_at_all();
        coverage.begin();
        (target.run)(input);
        coverage.end()
    };
    (target.seeds)().iter().for_each(|seed| _ = reaches_more(seed));
    let new = corpus::files_in(&out.join(target.name).join("new")).into_iter().map(|(_, bytes)| bytes);
    let mut all: Vec<Vec<u8>> = corpus::kept(&target).into_iter().chain(new).collect();
    all.sort_by(|a, b| (a.len(), a).cmp(&(b.len(), b)));
    let (mut kept, mut bytes) = (Vec::new(), 0);
    for input in all {
        if bytes + input.len() <= most && reaches_more(&input) {
            bytes += input.len();
            kept.push(input);
        }
    }
    corpus::keep(&target, &kept)?;
    let files = kept.len();
    println!("{}: {files} inputs, {bytes} bytes", target.name);
    Ok(())
}

fn main() -> Result<()> {
    match Args::parse().command {
        Command::Run { targets, out, bounds } => {
            if !Coverage::is_there() {
                eprintln!(
                    "no counters in this build: inputs are varied blindly (make fuzz builds with them)"
                );
            }
            let out = std::path::absolute(out)?;
            campaign::run(&chosen(&targets)?, bounds.seed, |t| bounds.limits(t), &out)
        }
        Command::One { name, out, bounds } => {
            one(named(&name)?, &bounds, &out);
            Ok(())
        }
        Command::List => {
            targets::all().iter().for_each(|t| println!("{:16} {}", t.name, t.kind.name()));
            Ok(())
        }
        Command::Replay { name, files } => {
            let target = named(&name)?;
            for file in files {
                (target.run)(&std::fs::read(&file).with_context(|| file.display().to_string())?);
                println!("{}: good", file.display());
            }
            Ok(())
        }
        Command::Keep { out, bytes } => targets::all().into_iter().try_for_each(|t| keep(t, &out, bytes)),
    }
}
