//! How well the tracker does on streams that it was not tuned on: every scenario, many seeds.

use clap::Parser;
use protocol::rig::Rig;
use validation::streams::score::{Score, Tracked, rms};
use validation::streams::{Recipe, Scenario};

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
}

fn main() {
    let args = Args::parse();
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    for scenario in Scenario::ALL {
        let seeds = args.from..args.from + args.seeds;
        let scores: Vec<Score> = seeds.map(|seed| score(&rig, scenario, seed, args.seconds)).collect();
        let all: Vec<f64> = scores.iter().flat_map(|s| s.tips_um.iter().copied()).collect();
        let each: Vec<String> = scores.iter().map(|s| format!("{:.1}", rms(&s.tips_um))).collect();
        let cover: Vec<String> = scores.iter().map(|s| format!("{:.4}", s.coverage())).collect();
        let eyes: Vec<f64> = scores.iter().flat_map(|s| s.eye_mrad.iter().copied()).collect();
        println!(
            "{:8} {:.2} µm  eye {:.3} mrad  each {}  cover {} worst gap {}",
            scenario.name(),
            rms(&all),
            rms(&eyes),
            each.join(" "),
            cover.join(" "),
            scores.iter().map(|s| s.longest_gap).max().unwrap_or(0)
        );
    }
}

fn score(rig: &Rig, scenario: Scenario, seed: u64, seconds: f64) -> Score {
    let stream = Recipe { scenario, seed, seconds, knocks: vec![] }.draw(rig);
    Score::of(&Tracked::of(&stream).frames, &stream.motion, 0.5, seconds - 0.2)
}
