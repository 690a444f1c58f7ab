//! How often `vitreo diff` names a planted defect: a table by kind, and every one that it did not name.

use clap::Parser;
use std::collections::BTreeMap;
use std::process::ExitCode;
use validation::defects::{Outcome, Verdict, run};

/// Plants defects in recordings and prints what the comparison says of them. Exit code 1 where fewer than 95
/// of 100 are named, or one is named wrongly with confidence.
#[derive(Parser)]
struct Args {
    /// First seed.
    #[arg(long, default_value_t = 0)]
    from: u64,
    /// How many.
    #[arg(long, default_value_t = 100)]
    count: u64,
    /// Print every pair.
    #[arg(long)]
    each: bool,
}

fn main() -> anyhow::Result<ExitCode> {
    let args = Args::parse();
    let bar = outputs::progress::files_bar(args.count, "pairs");
    let mut outcomes: Vec<Outcome> = Vec::new();
    for seed in args.from..args.from + args.count {
        outcomes.push(run(seed)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let mut kinds: BTreeMap<String, [u32; 4]> = BTreeMap::new();
    for outcome in &outcomes {
        let text = format!("{:?}", outcome.defect);
        let kind = text.split([' ', '{']).next().unwrap_or_default();
        let place = if text.contains("in_rig: true") { " (rig)" } else { "" };
        kinds.entry(format!("{kind}{place}")).or_default()[outcome.verdict as usize] += 1;
        if args.each || outcome.verdict != Verdict::Right {
            println!("seed {} {:?}: {:?}", outcome.seed, outcome.verdict, outcome.defect);
            outcome.found.iter().for_each(|finding| println!("    {}", finding.text()));
        }
    }
    println!("| defect | named | among several | not found | wrong |\n|---|---|---|---|---|");
    for (kind, [right, among, missed, wrong]) in &kinds {
        println!("| {kind} | {right} | {among} | {missed} | {wrong} |");
    }
    let count = |verdict| outcomes.iter().filter(|o| o.verdict == verdict).count();
    let (right, wrong) = (count(Verdict::Right), count(Verdict::Wrong));
    println!("{right} of {} named, {wrong} wrong with confidence", outcomes.len());
    let good = wrong == 0 && right * 100 >= outcomes.len() * 95;
    Ok(if good { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
