//! An hour of everything, at full speed: every scenario of blob streams through the tracker, every scene and
//! module through cameras, tracker and simulation. `make hour`; figures per minute in `docs/reliability.md`.

mod scenes;
mod streams;

use clap::Parser;
use indicatif::ProgressBar;
use std::process::ExitCode;

/// Runs every scenario, scene and module for an hour of its own time, and compares the end with the
/// beginning. Exits with 1 where something was not finite, grew, or became slower.
#[derive(Parser)]
struct Args {
    /// Length of each, minutes.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(2..))]
    minutes: u64,
    /// Only those whose name contains this.
    #[arg(long)]
    only: Option<String>,
    /// Print every minute.
    #[arg(long)]
    each: bool,
    /// Seed of everything random.
    #[arg(long, default_value_t = 11)]
    seed: u64,
}

impl Args {
    fn wants(&self, name: &str) -> bool {
        self.only.as_ref().is_none_or(|part| name.contains(part.as_str()))
    }

    /// Minutes that are printed: the first two, and the last.
    fn shows(&self, minute: u64) -> bool {
        self.each || minute <= 2 || minute == self.minutes
    }

    fn bar(&self, name: &str) -> ProgressBar {
        let style = indicatif::ProgressStyle::with_template("{msg:14} {bar:40} minute {pos}/{len} {eta}");
        ProgressBar::new(self.minutes).with_style(style.expect("a template")).with_message(name.to_owned())
    }
}

/// Ratio of the medians of the last and of the first minutes, a sixth of all each.
fn last_over_first(minutes: &[f64]) -> f64 {
    let share = (minutes.len() / 6).max(1);
    let median = |part: &[f64]| {
        let mut sorted = part.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    };
    median(&minutes[minutes.len() - share..]) / median(&minutes[..share])
}

fn main() -> ExitCode {
    let args = Args::parse();
    let mut problems = streams::run(&args);
    problems.extend(scenes::run(&args));
    for problem in &problems {
        eprintln!("hour: {problem}");
    }
    if problems.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
