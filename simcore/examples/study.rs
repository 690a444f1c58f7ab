//! Scripted surgeons at the training modules, without cameras:
//! `cargo run --release -p simcore --example study -- [--seeds N] [--module NAME]... [--level N] [--verbose]`
//! prints the tables of `docs/study.md`; it fails where the order of the surgeons or a bound is broken.

use modules::module::{Module, names};
use modules::score::Score;
use modules::score::table::{CATEGORIES, METRICS, PENALTIES};
use modules::surgeon::{SURGEONS, Surgeon};
use simcore::rehearsal::Rehearsal;
use simcore::world::{World, no_clock};

/// Least mean of the expert, and what the careless one's must stay below, points.
const EXPERT_FROM: f64 = 85.0;
const CARELESS_BELOW: f64 = 50.0;

struct Options {
    seeds: u64,
    level: u32,
    modules: Vec<String>,
    verbose: bool,
}

fn options() -> Result<Options, Box<dyn std::error::Error>> {
    let mut options = Options { seeds: 20, level: 1, modules: Vec::new(), verbose: false };
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().ok_or(format!("{arg} needs a value"));
        match arg.as_str() {
            "--seeds" => options.seeds = value()?.parse()?,
            "--level" => options.level = value()?.parse()?,
            "--module" => options.modules.push(value()?),
            "--verbose" => options.verbose = true,
            other => return Err(format!("unknown argument {other}").into()),
        }
    }
    if options.modules.is_empty() {
        options.modules = names().map(str::to_owned).collect();
    }
    Ok(options)
}

/// One attempt: until it ends, or the surgeon's script does.
fn attempt(
    module: &Module,
    level: u32,
    surgeon: &Surgeon,
    seed: u64,
) -> Result<Score, Box<dyn std::error::Error>> {
    let scene = module.compose(level, surgeon, seed)?;
    let rehearsal = Rehearsal::shipped(&scene).with_tremor(seed);
    let mut world = World::new(&scene)?;
    for field in 0..rehearsal.fields() {
        rehearsal.play(&mut world, field, &mut no_clock);
        if world.task().is_some_and(|(_, state)| modules::score::recording::is_over(state)) {
            break;
        }
    }
    Ok(world.score().ok_or("a module has a task")?)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn deviation(values: &[f64]) -> f64 {
    let m = mean(values);
    let squares: f64 = values.iter().map(|v| (v - m) * (v - m)).sum();
    (squares / (values.len() as f64 - 1.0).max(1.0)).sqrt()
}

/// Cohen's d: difference of the means in pooled deviations.
fn effect(better: &[f64], worse: &[f64]) -> f64 {
    let pooled = (0.5 * (deviation(better).powi(2) + deviation(worse).powi(2))).sqrt();
    (mean(better) - mean(worse)) / pooled.max(1e-9)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let options = options()?;
    let mut broken = Vec::new();
    println!(
        "| module | expert | average | novice | careless | d expert–average | d average–novice | d novice–careless |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let mut details = String::new();
    for name in &options.modules {
        let module = Module::load(name)?;
        let mut totals: Vec<Vec<f64>> = Vec::new();
        for surgeon in &SURGEONS {
            let scores: Result<Vec<Score>, _> =
                (1..=options.seeds).map(|seed| attempt(&module, options.level, surgeon, seed)).collect();
            let scores = scores?;
            totals.push(scores.iter().map(|s| s.total).collect());
            details.push_str(&detail(name, surgeon, &scores, options.verbose));
        }
        let cells: Vec<String> =
            totals.iter().map(|t| format!("{:.1} ± {:.1}", mean(t), deviation(t))).collect();
        let d: Vec<String> = totals.windows(2).map(|w| format!("{:.1}", effect(&w[0], &w[1]))).collect();
        println!("| {} | {} | {} |", module.name, cells.join(" | "), d.join(" | "));
        let ordered = totals.windows(2).all(|w| mean(&w[0]) > mean(&w[1]));
        if !ordered || mean(&totals[0]) < EXPERT_FROM || mean(&totals[3]) >= CARELESS_BELOW {
            broken.push(module.name.clone());
        }
    }
    print!("\n{details}");
    if broken.is_empty() {
        Ok(())
    } else {
        Err(format!("order or bounds broken in {}", broken.join(", ")).into())
    }
}

/// A line of means by category, and on demand every metric.
fn detail(module: &str, surgeon: &Surgeon, scores: &[Score], verbose: bool) -> String {
    use std::fmt::Write;
    let of = |f: &dyn Fn(&Score) -> f64| mean(&scores.iter().map(f).collect::<Vec<_>>());
    let categories: Vec<String> =
        (0..CATEGORIES).map(|c| format!("{:6.1}", of(&|s| s.categories[c]))).collect();
    let finished = scores.iter().filter(|s| s.finished).count();
    let mut out = format!(
        "{module:<13} {:<9} categories {}  finished {finished} of {}\n",
        surgeon.name,
        categories.join(" "),
        scores.len()
    );
    if verbose {
        for (i, metric) in METRICS.iter().enumerate() {
            let value = of(&|s| s.metrics[i].value.unwrap_or(0.0));
            // Writing into a string cannot fail.
            let _ = writeln!(
                out,
                "    {:<32} {value:9.3} {:<20} {:6.2}",
                metric.name,
                metric.unit,
                of(&|s| s.metrics[i].points)
            );
        }
        for (i, penalty) in PENALTIES.iter().enumerate() {
            let _ = writeln!(out, "    {:<32} {:9.2} times", penalty.name, of(&|s| f64::from(s.injuries[i])));
        }
    }
    out
}
