//! Streams through the tracker.

use super::{Args, last_over_first};
use rig::Rig;
use validation::streams::Scenario;
use validation::streams::lasting::{Lasting, Minute};

/// Largest ratio of the tracker's time in the end to that in the beginning.
const TIME_RATIO: f64 = 1.5;

/// Runs the scenarios, prints their table and returns what is wrong.
pub fn run(args: &Args) -> Vec<String> {
    let wanted: Vec<Scenario> = Scenario::ALL.into_iter().filter(|s| args.wants(s.name())).collect();
    if wanted.is_empty() {
        return Vec::new();
    }
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    println!("| stream | minute | frames | tip, µm | display error, µm | coverage | tracker, µs a frame |");
    println!("|---|---|---|---|---|---|---|");
    wanted.into_iter().flat_map(|scenario| one(args, &rig, scenario)).collect()
}

fn one(args: &Args, rig: &Rig, scenario: Scenario) -> Vec<String> {
    let mut lasting = Lasting::new(rig, scenario, args.seed);
    let bar = args.bar(scenario.name());
    let (mut second, mut times, mut problems) = (None, Vec::new(), Vec::new());
    for _ in 0..args.minutes {
        let minute = lasting.minute();
        let time_us = minute.took.as_secs_f64() * 1e6 / minute.frames.max(1) as f64;
        times.push(time_us);
        bar.inc(1);
        if args.shows(minute.number) {
            bar.suspend(|| print_row(scenario, &minute, time_us));
        }
        let early = second.as_ref().filter(|_| minute.number == args.minutes);
        let named = |defect| format!("{}, minute {}: {defect}", scenario.name(), minute.number);
        problems.extend(minute.defects(early).into_iter().map(named));
        if minute.number == 2 {
            second = Some(minute);
        }
    }
    bar.finish_and_clear();
    let ratio = last_over_first(&times);
    if ratio > TIME_RATIO {
        problems.push(format!("{}: the tracker takes {ratio:.2} times as long in the end", scenario.name()));
    }
    problems
}

fn print_row(scenario: Scenario, minute: &Minute, time_us: f64) {
    let [tips, shown] = minute.errors_um();
    println!(
        "| {} | {} | {} | {tips:.2} | {shown:.1} | {:.4} | {time_us:.0} |",
        scenario.name(),
        minute.number,
        minute.frames,
        minute.score.coverage()
    );
}
