//! `cargo run --release -p validation --example causes`: defects planted in drawn streams, and what the
//! judge of causes names. Prints the table of `docs/calibration.md`.

use calibration::causes::{Verdict, judge};
use clap::Parser;
use validation::planted::{Defect, is_truth, plant};
use validation::streams::Scenario;

/// Length of a stream, s, and begin of the defects of blobs and cameras.
const SECONDS: f64 = 6.0;
const FROM_S: f64 = 2.5;

/// Plants every kind of defect in streams of the shipped rig, and prints how often the judge of causes names it.
#[derive(Parser)]
struct Args {
    /// Streams of each kind and scenario; their seeds are 1, 2, …
    #[arg(default_value_t = 4)]
    seeds: u64,
}

fn main() {
    let Args { seeds } = Args::parse();
    println!(
        "| defect | scenario | streams | named alone | among several | unknown | nothing | wrong | begin off by, s |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for defect in Defect::ALL {
        for scenario in [Scenario::Nominal, Scenario::Async] {
            line(defect, scenario, seeds);
        }
    }
}

fn line(defect: Defect, scenario: Scenario, seeds: u64) {
    let [mut alone, mut several, mut unknown, mut nothing, mut wrong] = [0; 5];
    let mut off_s: f64 = 0.0;
    for seed in 1..=seeds {
        let planted = plant(defect, scenario, seed, SECONDS, FROM_S);
        let judged = judge(&planted.rig, &planted.fields, |_, _| true);
        let among = |c| judged.explanations.iter().any(|e| is_truth(&e.cause, c));
        let right = planted.truth.as_ref().is_some_and(among);
        match (judged.verdict, judged.explanations.len()) {
            (Verdict::Explained, 1) if right => alone += 1,
            (Verdict::Explained, _) if right => several += 1,
            (Verdict::Explained, _) => wrong += 1,
            (Verdict::NothingWrong | Verdict::TooLittle | Verdict::Stopped, _) => nothing += 1,
            (Verdict::Unknown, _) => unknown += 1,
        }
        if right {
            off_s = off_s.max((judged.since_s - planted.since_s).abs());
        }
        let truth = planted.truth.map_or("nothing".into(), |c| c.to_string());
        eprintln!("{defect:?} {} seed {seed}: {truth}\n    {}", scenario.name(), judged.text());
    }
    println!(
        "| {defect:?} | {} | {seeds} | {alone} | {several} | {unknown} | {nothing} | {wrong} | {off_s:.1} |",
        scenario.name()
    );
}
