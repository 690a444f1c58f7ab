//! A long recording is made at full speed; then opening it, going to any place of it, and the memory that it
//! takes are measured and held to their limits. `make seek`; figures in `docs/recording.md`.

mod measure;
mod write;

use clap::Parser;
use std::path::PathBuf;
use std::process::{Command, ExitCode};

/// Records a scene or module at full speed, then measures in a fresh process how long it takes to open the
/// recording and to go to random places of it, and how much memory. Exits with 1 where a limit is passed.
#[derive(Parser)]
struct Args {
    /// Length of the recording, minutes.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..))]
    minutes: u64,
    /// Scene, or `module NAME` for a shipped module.
    #[arg(long, default_value = "peel")]
    scene: String,
    /// The recording; an existing one is measured as it is.
    #[arg(long, default_value = "out/seek.mcap")]
    file: PathBuf,
    /// Number of random places.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(50..))]
    places: u64,
    /// Seed of everything random.
    #[arg(long, default_value_t = 11)]
    seed: u64,
    /// Make the recording again where there is one.
    #[arg(long)]
    force: bool,
    /// Measure only.
    #[arg(long, hide = true)]
    measure: bool,
}

fn main() -> anyhow::Result<ExitCode> {
    let args = Args::parse();
    if args.measure {
        return measure::run(&args);
    }
    if args.force || !args.file.exists() {
        write::run(&args)?;
    }
    // What was needed to record does not count.
    let status =
        Command::new(std::env::current_exe()?).args(std::env::args_os().skip(1)).arg("--measure").status()?;
    Ok(if status.success() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
