//! `make endure`: kills, stops and shortages, and what they cost, as the table of
//! `docs/reliability.md`.

mod shortages;

use indicatif::{ProgressBar, ProgressStyle};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use vitreo_tests::endure::{Blow, Campaign, Outcome, run};

const USAGE: &str = "endure [--kills N] [--stops N] [--keep FOLDER] [--gap S] [--no-shortages]";

/// What is asked for.
struct Options {
    kills: usize,
    stops: usize,
    /// Mean time between two kills, s.
    gap_s: f64,
    keep: Option<PathBuf>,
    shortages: bool,
}

impl Options {
    fn parse() -> anyhow::Result<Self> {
        let mut options = Options { kills: 1000, stops: 60, gap_s: 1.2, keep: None, shortages: true };
        let mut words = std::env::args().skip(1);
        while let Some(word) = words.next() {
            let mut value =
                || words.next().ok_or_else(|| anyhow::anyhow!("{word}: expected a value\n{USAGE}"));
            match word.as_str() {
                "--kills" => options.kills = value()?.parse()?,
                "--stops" => options.stops = value()?.parse()?,
                "--gap" => options.gap_s = value()?.parse()?,
                "--keep" => options.keep = Some(value()?.into()),
                "--no-shortages" => options.shortages = false,
                _ => anyhow::bail!("{word}: unknown\n{USAGE}"),
            }
        }
        Ok(options)
    }
}

fn main() -> anyhow::Result<ExitCode> {
    let options = Options::parse()?;
    let scratch = tempfile::tempdir()?;
    let folder = options.keep.as_deref().unwrap_or(scratch.path());
    std::fs::create_dir_all(folder)?;
    let mut good = true;
    if options.kills > 0 {
        good &= campaigns("kill -9", &kills(&options), folder);
    }
    if options.stops > 0 {
        good &= campaigns("SIGSTOP up to 5 s", &stops(&options), folder);
    }
    if options.shortages {
        good &= shortages::all(folder)?;
    }
    Ok(if good { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The kills, a run for each hundred.
fn kills(options: &Options) -> Vec<Campaign> {
    let gap_s = [0.25 * options.gap_s, 1.75 * options.gap_s];
    let of = |seed: usize| Campaign {
        blow: Blow::Kill,
        blows: (options.kills - 100 * seed).min(100),
        gap_s,
        seed: seed as u64,
        run: vec!["--headless".into()],
    };
    (0..options.kills.div_ceil(100)).map(of).collect()
}

fn stops(options: &Options) -> Vec<Campaign> {
    let (blow, run) = (Blow::Stop(5.0), vec!["--headless".into()]);
    vec![Campaign { blow, blows: options.stops, gap_s: [0.5, 2.0], seed: 1_000, run }]
}

/// Runs campaigns and prints their rows; true if all of them were survived.
fn campaigns(what: &'static str, all: &[Campaign], folder: &Path) -> bool {
    let bar = ProgressBar::new(all.iter().map(|c| c.blows as u64).sum());
    bar.set_style(
        ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {eta}").expect("a valid template"),
    );
    bar.set_message(what);
    let mut done = 0;
    let mut outcomes = Vec::new();
    for campaign in all {
        let outcome = run(campaign, folder, |blows| bar.set_position((done + blows) as u64));
        done += outcome.blows;
        if !outcome.survived() {
            bar.suspend(|| eprintln!("seed {}: {outcome:#?}", campaign.seed));
        }
        outcomes.push(outcome);
    }
    bar.finish_and_clear();
    println!("{}", table(what, &outcomes));
    outcomes.iter().all(Outcome::survived)
}

fn table(what: &str, outcomes: &[Outcome]) -> String {
    use std::fmt::Write;
    let mut restarts: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for (process, ms) in outcomes.iter().flat_map(|o| &o.restarts_ms) {
        restarts.entry(process).or_default().extend(ms);
    }
    let mut text = String::new();
    let sum = |of: &dyn Fn(&Outcome) -> u64| outcomes.iter().map(of).sum::<u64>();
    let (blows, starting) = (sum(&|o| o.blows as u64), sum(&|o| o.while_starting as u64));
    // Writing into a string cannot fail.
    let _ = writeln!(text, "{what}: {blows} in {} runs, {starting} of them while starting", outcomes.len());
    for (process, ms) in &mut restarts {
        ms.sort_by(f64::total_cmp);
        let at = |share: f64| ms[((ms.len() - 1) as f64 * share) as usize];
        let _ = writeln!(
            text,
            "  {process:<12} back {:>4} times: p50 {:>5.0} ms, p99 {:>5.0} ms, max {:>5.0} ms",
            ms.len(),
            at(0.5),
            at(0.99),
            at(1.0)
        );
    }
    let _ = writeln!(text, "  not back, or its state lost: {}", sum(&|o| o.given_up as u64));
    let share = |lost: u64, of: u64| 100.0 * lost as f64 / of.max(1) as f64;
    for (name, of) in [("poses", 0), ("camera fields", 1)] {
        let pair = |o: &Outcome| if of == 0 { o.poses } else { o.fields };
        let (all, lost) = (sum(&|o| pair(o)[0]), sum(&|o| pair(o)[1]));
        let _ = writeln!(text, "  {name} lost: {lost} of {all} ({:.2} %)", share(lost, all));
    }
    let longest = outcomes.iter().map(|o| o.longest_without_picture_ms).fold(0.0, f64::max);
    let _ = writeln!(text, "  longest time without a picture: {longest:.0} ms");
    let verify = outcomes.iter().filter(|o| o.unverified.is_none()).count();
    let _ = writeln!(text, "  recordings that verify: {verify} of {}", outcomes.len());
    let _ = writeln!(text, "  left over: {}", sum(&|o| o.left_over.len() as u64));
    text
}
