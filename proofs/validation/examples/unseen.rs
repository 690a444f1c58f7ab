//! How well the tracker does on streams that it was not tuned on: every scenario, many seeds.

use clap::Parser;
use rig::Rig;
use rig::sensor::Shutter;
use std::path::{Path, PathBuf};
use tracker::tuning::Tuning;
use validation::streams::bound;
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
    /// The first of a stream is not scored, s: the filters settle.
    #[arg(long, default_value_t = 0.5)]
    settle: f64,
    /// Folders with a stream of another generator (rig.json, blobs.jsonl, truth.csv) instead of drawn ones. Their bound
    /// is that of a tracker which knows the noise and spectrum that are estimated from their truth.
    #[arg(long = "stream", value_name = "FOLDER")]
    streams: Vec<PathBuf>,
}

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
    if !args.streams.is_empty() {
        return args.streams.iter().for_each(|folder| println!("{}", of_folder(folder, &args)));
    }
    for scenario in Scenario::ALL.into_iter().filter(|s| s.name().contains(&args.only)) {
        let seeds = args.from..args.from + args.seeds;
        let rows: Vec<Row> = seeds.map(|seed| of_stream(&rig, scenario, seed, &args)).collect();
        println!("{}", row(scenario.name(), &rows));
        for (seed, own) in (args.from..).zip(rows.chunks(1)).filter(|_| args.each) {
            println!("{}", row(&format!("seed {seed}"), own));
        }
    }
}

fn of_folder(folder: &Path, args: &Args) -> String {
    let stream = Stream::read(folder).unwrap_or_else(|problem| panic!("{problem:#}"));
    let ([column, line], falls) = stream.noise_px();
    let of = if falls { " for an area of 1 px, falling with its root" } else { "" };
    eprintln!("{}: noise {column:.3} px across, {line:.3} px along the lines{of}", folder.display());
    let name = folder.file_name().map_or("stream".into(), |name| name.to_string_lossy());
    row(&name, &[tracked(&stream, args)])
}

fn of_stream(rig: &Rig, scenario: Scenario, seed: u64, args: &Args) -> Row {
    tracked(&Recipe { scenario, seed, seconds: args.seconds, knocks: vec![] }.draw(rig), args)
}

fn tracked(stream: &Stream, args: &Args) -> Row {
    let tracked = Tracked::tuned(stream, &tuning(args));
    let scored = [args.settle, args.seconds - 0.2];
    let score = Score::of(&tracked, stream, scored[0], scored[1]);
    let bounds_um = if args.no_bound { vec![] } else { bound::of_measured_um(stream, &tracked, scored) };
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
