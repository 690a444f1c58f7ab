//! How well the tracker does on streams that it was not tuned on: every scenario, many seeds.

use clap::Parser;
use protocol::limits::INSTRUMENTS;
use rig::Rig;
use rig::sensor::Shutter;
use tracker::tuning::Tuning;
use validation::streams::bound::TipBound;
use validation::streams::score::{Score, Tracked, rms};
use validation::streams::{Recipe, Scenario, Stream, rig_at, rig_of_rates};

/// Tracks drawn streams of every scenario, and prints a table: root mean squares over all streams, in
/// brackets the least and the largest of a stream. The bound is the posterior Cramér–Rao bound of the tips
/// (validation::streams::bound), the ratio that of the tips' error to it.
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
    /// Rate of the cameras, Hz.
    #[arg(long, default_value_t = 50.0)]
    hz: f64,
    /// Rates of the cameras, Hz, in the order of the rig, instead of one for all.
    #[arg(long, value_delimiter = ',', conflicts_with = "hz")]
    rates: Vec<f64>,
    /// Cameras with a rolling shutter.
    #[arg(long)]
    rolling: bool,
    /// Only scenarios whose name contains this.
    #[arg(long, default_value = "")]
    only: String,
    /// Other constants of the tracker (vitreo settings lists them).
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Leave the bound out: it takes a second and more a stream.
    #[arg(long)]
    no_bound: bool,
}

/// The first of a stream is not scored, s: the filters settle.
const SETTLED_S: f64 = 0.5;
/// Instants of a stream at which the bound is computed, evenly spread.
const INSTANTS: usize = 40;

/// Of a stream.
struct Row {
    score: Score,
    /// Bounds of the tips, µm.
    bounds_um: Vec<f64>,
}

fn main() {
    let args = Args::parse();
    let shutter = if args.rolling { Shutter::Rolling } else { Shutter::Global };
    let shipped = Rig { shutter, ..Rig::load_or_shipped(None).expect("the shipped rig") };
    let rig = match args.rates.as_slice() {
        [] => rig_at(&shipped, args.hz),
        rates => rig_of_rates(&shipped, rates),
    };
    println!(
        "| scenario | tip, µm | bound, µm | ratio | display error, µm | eye, mrad | coverage | longest gap, fields |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for scenario in Scenario::ALL.into_iter().filter(|s| s.name().contains(&args.only)) {
        let seeds = args.from..args.from + args.seeds;
        let rows: Vec<Row> = seeds.map(|seed| of_stream(&rig, scenario, seed, &args)).collect();
        println!("{}", row(scenario.name(), &rows));
        for (seed, own) in (args.from..).zip(rows.chunks(1)).filter(|_| args.each) {
            println!("{}", row(&format!("seed {seed}"), own));
        }
    }
}

fn of_stream(rig: &Rig, scenario: Scenario, seed: u64, args: &Args) -> Row {
    let stream = Recipe { scenario, seed, seconds: args.seconds, knocks: vec![] }.draw(rig);
    let tracked = Tracked::tuned(&stream, &tuning(args));
    let score = Score::of(&tracked, &stream, SETTLED_S, args.seconds - 0.2);
    let bounds_um = if args.no_bound { vec![] } else { bounds_um(&stream, &tracked, args.seconds - 0.2) };
    Row { score, bounds_um }
}

fn tuning(args: &Args) -> Tuning {
    let mut tuning = Tuning::default();
    for pair in &args.set {
        let (key, value) = pair.split_once('=').expect("--set KEY=VALUE");
        let value = value.parse().expect("a number behind =");
        tuning.set(key, value).unwrap_or_else(|problem| panic!("--set {pair}: {problem}"));
    }
    tuning
}

/// Bounds at some of the instants at which a tip in the eye is measured.
fn bounds_um(stream: &Stream, tracked: &Tracked, until_s: f64) -> Vec<f64> {
    let mut bounds = Vec::new();
    for instrument in 0..INSTRUMENTS {
        let mut bound = TipBound::new(stream, instrument);
        let scored = tracked.measured_s(stream, instrument, SETTLED_S, until_s);
        bounds.extend(
            scored.iter().step_by((scored.len() / INSTANTS).max(1)).filter_map(|t_s| bound.at_um(*t_s)),
        );
    }
    bounds
}

fn row(name: &str, rows: &[Row]) -> String {
    let scores: Vec<&Score> = rows.iter().map(|r| &r.score).collect();
    let bounds: Vec<f64> = rows.iter().flat_map(|r| r.bounds_um.iter().copied()).collect();
    let tips: Vec<f64> = scores.iter().flat_map(|s| s.tips_um.iter().copied()).collect();
    let bound = match bounds.is_empty() {
        true => "– | –".into(),
        false => format!("{:.1} | {:.2}", rms(&bounds), rms(&tips) / rms(&bounds)),
    };
    let column = |of: fn(&Score) -> &Vec<f64>, digits: usize| {
        let all: Vec<f64> = scores.iter().flat_map(|s| of(s).iter().copied()).collect();
        let each = scores.iter().map(|s| rms(of(s)));
        let (low, high) = each.fold((f64::MAX, 0.0f64), |(low, high), e| (low.min(e), high.max(e)));
        format!("{:.digits$} ({low:.digits$}–{high:.digits$})", rms(&all))
    };
    let [measured, wanted] =
        [|s: &Score| s.measured, |s: &Score| s.wanted].map(|of| scores.iter().map(|s| of(s)).sum::<usize>());
    let least = scores.iter().map(|s| s.coverage()).fold(1.0, f64::min);
    format!(
        "| {name} | {} | {bound} | {} | {} | {:.4} ({least:.4}) | {} |",
        column(|s| &s.tips_um, 1),
        column(|s| &s.shown_um, 0),
        column(|s| &s.eye_mrad, 2),
        measured as f64 / wanted.max(1) as f64,
        scores.iter().map(|s| s.longest_gap).max().unwrap_or(0),
    )
}
