//! How well the tracker does on streams that it was not tuned on: every scenario, many seeds.

use clap::Parser;
use rig::Rig;
use validation::streams::score::{Score, Tracked, rms};
use validation::streams::{Recipe, Scenario};

/// Tracks drawn streams of every scenario, and prints a table: root mean squares over all streams, in
/// brackets the least and the largest of a stream.
#[derive(Parser)]
struct Args {
    /// First seed.
    #[arg(long, default_value_t = 1)]
    from: u64,
    /// Seeds.
    #[arg(long, default_value_t = 8)]
    seeds: u64,
    /// Length of each stream, s.
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Print every stream.
    #[arg(long)]
    each: bool,
}

/// The first of a stream is not scored, s: the filters settle.
const SETTLED_S: f64 = 0.5;

fn main() {
    let args = Args::parse();
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    println!("| scenario | tip, µm | shown, µm | eye, mrad | coverage | longest gap, fields |");
    println!("|---|---|---|---|---|---|");
    for scenario in Scenario::ALL {
        let seeds = args.from..args.from + args.seeds;
        let scores: Vec<Score> = seeds.map(|seed| score(&rig, scenario, seed, args.seconds)).collect();
        println!("{}", row(scenario.name(), &scores));
        for (seed, own) in (args.from..).zip(scores.chunks(1)).filter(|_| args.each) {
            println!("{}", row(&format!("seed {seed}"), own));
        }
    }
}

fn score(rig: &Rig, scenario: Scenario, seed: u64, seconds: f64) -> Score {
    let stream = Recipe { scenario, seed, seconds, knocks: vec![] }.draw(rig);
    Score::of(&Tracked::of(&stream), &stream, SETTLED_S, seconds - 0.2)
}

fn row(name: &str, scores: &[Score]) -> String {
    let column = |of: fn(&Score) -> &Vec<f64>, digits: usize| {
        let all: Vec<f64> = scores.iter().flat_map(|s| of(s).iter().copied()).collect();
        let each = scores.iter().map(|s| rms(of(s)));
        let (low, high) = each.fold((f64::MAX, 0.0f64), |(low, high), e| (low.min(e), high.max(e)));
        format!("{:.digits$} ({low:.digits$}–{high:.digits$})", rms(&all))
    };
    let [measured, wanted] =
        [|s: &Score| s.measured, |s: &Score| s.wanted].map(|of| scores.iter().map(of).sum::<usize>());
    let least = scores.iter().map(Score::coverage).fold(1.0, f64::min);
    format!(
        "| {name} | {} | {} | {} | {:.4} ({least:.4}) | {} |",
        column(|s| &s.tips_um, 1),
        column(|s| &s.shown_um, 0),
        column(|s| &s.eye_mrad, 2),
        measured as f64 / wanted.max(1) as f64,
        scores.iter().map(|s| s.longest_gap).max().unwrap_or(0),
    )
}
