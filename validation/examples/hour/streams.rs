//! Streams through the tracker.

use super::{Args, last_over_first};
use protocol::rig::Rig;
use validation::streams::Scenario;
use validation::streams::lasting::{Lasting, Minute};

/// Largest ratio of the errors of the last minute to those of the second, and of the tracker's time.
const ERROR_RATIO: f64 = 1.1;
const TIME_RATIO: f64 = 1.5;
/// Largest loss of coverage between them.
const COVERAGE_LOSS: f64 = 0.001;

/// Runs the scenarios, prints their table and returns what is wrong.
pub fn run(args: &Args) -> Vec<String> {
    let wanted: Vec<Scenario> = Scenario::ALL.into_iter().filter(|s| args.wants(s.name())).collect();
    if wanted.is_empty() {
        return Vec::new();
    }
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    println!("| stream | minute | frames | tip, µm | shown, µm | coverage | tracker, µs a frame |");
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
        problems.extend(defects(scenario, &minute));
        if minute.number == args.minutes {
            problems.extend(second.iter().flat_map(|second| compare(scenario, second, &minute)));
        }
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

/// What is wrong with a minute alone.
fn defects(scenario: Scenario, minute: &Minute) -> Vec<String> {
    let at = format!("{}, minute {}", scenario.name(), minute.number);
    let mut found = Vec::new();
    if minute.restarts > 0 {
        found.push(format!("{at}: {} filters or predictors were not finite", minute.restarts));
    }
    if minute.frames + 2 < minute.exposures {
        found.push(format!("{at}: {} frames of {} exposures", minute.frames, minute.exposures));
    }
    found
}

/// What is worse in the last minute than in the second.
fn compare(scenario: Scenario, second: &Minute, last: &Minute) -> Vec<String> {
    let name = scenario.name();
    let errors = last.errors_um().into_iter().zip(second.errors_um()).zip(["tips", "shown tips"]);
    let worse = errors.filter(|((last, second), _)| *last > ERROR_RATIO * second);
    let mut found: Vec<String> = worse
        .map(|((last, second), what)| format!("{name}: {what} of {last:.1} µm, {second:.1} in minute 2"))
        .collect();
    let lost = second.score.coverage() - last.score.coverage();
    if lost > COVERAGE_LOSS {
        found.push(format!("{name}: coverage fell by {lost:.4}"));
    }
    found
}
