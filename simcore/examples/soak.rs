//! Random tool programmes over random scenes, every step checked, every programme run twice:
//! `make soak`, or `cargo run --release -p simcore --example soak -- --help`.

use clap::Parser;
use indicatif::{ProgressBar, ProgressStyle};
use simcore::soak::run;
use std::sync::atomic::{AtomicU64, Ordering};

/// Random tool programmes over random scenes.
#[derive(Parser)]
struct Args {
    /// Programmes.
    #[arg(long, default_value_t = 1000)]
    programmes: u64,
    /// Simulated time of each, s.
    #[arg(long, default_value_t = 60.0)]
    seconds: f64,
    /// Seed of the first programme; the others follow.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Programmes at the same time; all cores by default.
    #[arg(long)]
    threads: Option<usize>,
}

fn main() -> std::process::ExitCode {
    let args = Args::parse();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let style =
        ProgressStyle::with_template("{bar:40} {pos}/{len} {elapsed} + {eta} {msg}").expect("a template");
    let bar = ProgressBar::new(args.programmes).with_style(style);
    let (next, failed, steps, events) =
        (AtomicU64::new(0), AtomicU64::new(0), AtomicU64::new(0), AtomicU64::new(0));
    println!("seeds {} to {}", args.seed, args.seed + args.programmes.saturating_sub(1));
    std::thread::scope(|scope| {
        for _ in 0..args.threads.unwrap_or(cores).max(1) {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= args.programmes {
                        break;
                    }
                    match run(args.seed + number, args.seconds) {
                        Ok(outcome) => {
                            steps.fetch_add(outcome.steps, Ordering::Relaxed);
                            events.fetch_add(outcome.events, Ordering::Relaxed);
                        }
                        Err(failure) => {
                            failed.fetch_add(1, Ordering::Relaxed);
                            bar.suspend(|| println!("{failure}"));
                        }
                    }
                    bar.inc(1);
                }
            });
        }
    });
    bar.finish_and_clear();
    let failed = failed.into_inner();
    let (steps, events) = (steps.into_inner(), events.into_inner());
    println!(
        "{} programmes, {steps} steps (each done twice), {events} events, {failed} failed",
        args.programmes
    );
    std::process::ExitCode::from(u8::from(failed > 0))
}
