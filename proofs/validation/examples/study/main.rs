//! How far apart surgeons come at the training modules, without pixels: markers straight into
//! blobs, then tracker, simulation, task and score as in a live run. `cargo run --release -p
//! validation --example study -- [--seeds N] [--level N] [--module NAME|FOLDER]… [--surgeon NAME]…
//! [--threads N] [--verbose] [--events SEED] [--page docs/study.md]` (`make study`).
//!
//! Part 1: five scripted surgeons at every module. Part 2: recorded hands of surgeons and of
//! novices in the place of the tremor. `--events` prints one attempt event by event. With `--page`
//! both become that page and the picture beside it. It fails where part 1 breaks a bound.

mod attempts;
mod hands;
mod numbers;
mod page;
mod picture;

use anyhow::{Context, Result, bail};
use attempts::Job;
use scene::module::names;
use std::path::PathBuf;
use surgeon::skill::{SKILLS, Skill};
use training::score::Score;

const USAGE: &str = "How far apart surgeons come at the training modules

Usage: study [OPTIONS]

  --seeds N         attempts of each surgeon at each module [20]
  --level N         level of the modules [1]
  --module NAME     a module, or a folder with one; again for more [all]
  --surgeon NAME    expert, average, novice, careless or idle; again for more [all]
  --threads N       attempts at the same time [all cores]
  --verbose         the metrics of every surgeon
  --events SEED     prints one attempt of the first module and surgeon event by event
  --page FILE       writes the page, with recorded hands, and the picture beside it";

/// Every attempt of the expert brings at least the first, every one of the careless one less than
/// the second, and every one of idle hands at most the third, points.
const EXPERT_FROM: f64 = 85.0;
const CARELESS_BELOW: f64 = 50.0;
const IDLE_UP_TO: f64 = 5.0;

struct Options {
    seeds: u64,
    level: u32,
    modules: Vec<String>,
    surgeons: Vec<Skill>,
    threads: usize,
    verbose: bool,
    events: Option<u64>,
    page: Option<PathBuf>,
}

fn options() -> Result<Options> {
    let threads = std::thread::available_parallelism()?.get();
    let mut options = Options {
        seeds: 20,
        level: 1,
        modules: Vec::new(),
        surgeons: Vec::new(),
        threads,
        verbose: false,
        events: None,
        page: None,
    };
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().with_context(|| format!("{arg} needs a value"));
        match arg.as_str() {
            "--seeds" => options.seeds = value()?.parse()?,
            "--level" => options.level = value()?.parse()?,
            "--module" => options.modules.push(value()?),
            "--surgeon" => {
                options.surgeons.push(surgeon::skill::named(&value()?)?);
            }
            "--threads" => options.threads = value()?.parse()?,
            "--verbose" => options.verbose = true,
            "--events" => options.events = Some(value()?.parse()?),
            "--page" => options.page = Some(value()?.into()),
            "--help" | "-h" => {
                println!("{USAGE}");
                std::process::exit(0)
            }
            other => bail!("unknown argument {other}\n\n{USAGE}"),
        }
    }
    if options.modules.is_empty() {
        options.modules = names().map(str::to_owned).collect();
    }
    if options.surgeons.is_empty() {
        options.surgeons = SKILLS.to_vec();
    }
    Ok(options)
}

/// What came of a module: scores by surgeon.
struct Outcome {
    module: String,
    scores: Vec<Vec<Score>>,
}

impl Outcome {
    fn totals(&self, surgeon: usize) -> Vec<f64> {
        self.scores[surgeon].iter().map(|s| s.total).collect()
    }

    /// Whether the order of the surgeons and their bounds hold.
    fn holds(&self, surgeons: &[Skill]) -> bool {
        let totals: Vec<Vec<f64>> = (0..self.scores.len()).map(|s| self.totals(s)).collect();
        let ordered = totals.windows(2).all(|w| numbers::mean(&w[0]) > numbers::mean(&w[1]));
        ordered && surgeons.iter().zip(&self.scores).all(|(who, s)| s.iter().all(|s| within(who, s)))
    }
}

/// Whether a score is what this surgeon must come to, if anything is demanded.
fn within(who: &Skill, score: &Score) -> bool {
    match who.name {
        "expert" => score.finished && score.total >= EXPERT_FROM,
        "careless" => score.total < CARELESS_BELOW,
        // Over means that the clock ran, so that the bound is put to the test.
        "idle" => score.total <= IDLE_UP_TO && score.took_s > 0.0,
        _ => true,
    }
}

fn main() -> Result<()> {
    let options = options()?;
    let modules = options.modules.iter().map(|m| surgeon::load(m)).collect::<Result<Vec<_>, _>>()?;
    if let Some(seed) = options.events {
        return attempts::print_events(&modules[0], options.level, &options.surgeons[0], seed);
    }
    let mut jobs = Vec::new();
    for module in 0..modules.len() {
        for &surgeon in &options.surgeons {
            let job = |seed| Job { module, level: options.level, surgeon, hand: None, seed };
            jobs.extend((1..=options.seeds).map(job));
        }
    }
    let mut scores = attempts::scores(&modules, &jobs, options.threads)?.into_iter();
    let outcomes: Vec<Outcome> = modules
        .iter()
        .map(|module| {
            let mut of_surgeon = |_: &Skill| scores.by_ref().take(options.seeds as usize).collect();
            Outcome {
                module: module.name.clone(),
                scores: options.surgeons.iter().map(&mut of_surgeon).collect(),
            }
        })
        .collect();
    let part1 = page::Part1 { outcomes: &outcomes, surgeons: &options.surgeons, seeds: options.seeds };
    print!("{}\n{}", part1.table(), part1.details(options.verbose));
    if let Some(file) = &options.page {
        let part2 = hands::study(options.threads)?;
        let picture = picture::StudyPlot { outcomes: &outcomes, surgeons: &options.surgeons };
        std::fs::write(file.with_extension("png"), plots::bytes(&picture, plots::Format::Png)?)?;
        std::fs::write(file, page::page(&part1, options.level, &part2))
            .with_context(|| format!("cannot write {}", file.display()))?;
    }
    let broken: Vec<&str> =
        outcomes.iter().filter(|o| !o.holds(&options.surgeons)).map(|o| o.module.as_str()).collect();
    if !broken.is_empty() {
        bail!("order or bounds broken in {}", broken.join(", "));
    }
    Ok(())
}
