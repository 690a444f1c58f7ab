//! `vitreo budgets`: compares the reports of several runs with their latency budgets.

use crate::exit::{BUDGET, WrongUse};
use crate::run::{Judged, Load, NO_LOAD};
use anyhow::{Context, ensure};
use outputs::println;
use protocol::file::{MAX_TABLE_BYTES, read_text};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Arguments of `vitreo budgets`.
#[derive(Debug, clap::Args)]
pub struct BudgetsArgs {
    /// Reports written by vitreo run --report.
    #[arg(value_name = "REPORT.json", required = true)]
    pub reports: Vec<PathBuf>,
    /// Number of reports that must keep all budgets [default: all of them].
    #[arg(long, value_name = "N")]
    pub at_least: Option<usize>,
    /// Excuse overruns that the load of other programs explains: if they used a fraction s of the processors, latencies
    /// up to budget / (1 − s) pass, and up to a fraction s of the frames may fall below the lowest permitted tier.
    /// Reports without load data get no allowance.
    #[arg(long)]
    pub forgive_load: bool,
    /// Print one sentence per report, without tables.
    #[arg(long)]
    pub brief: bool,
}

/// The parts of a run's report that are checked.
#[derive(Debug, Deserialize)]
struct Report {
    stages: Vec<Stage>,
    load: Option<Load>,
    picture: Option<Picture>,
}

/// Figures of the picture in a report.
#[derive(Debug, Deserialize)]
struct Picture {
    /// Number of frames shown at each quality tier.
    frames_by_tier: BTreeMap<u32, u64>,
}

/// Figures of a stage in a report; durations in ms.
#[derive(Debug, Deserialize)]
struct Stage {
    stage: String,
    verdict: String,
    broken: bool,
    percentile: f64,
    p50_ms: f64,
    judged_ms: f64,
    budget_ms: f64,
    mean_ms: f64,
    mean_budget_ms: f64,
    violations: u64,
    count: u64,
    below_floor: u64,
}

/// Verdict on a run, from best to worst.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    /// All budgets were met.
    Kept,
    /// Some budgets were exceeded, and the load of other programs explains all of it.
    Explained,
    /// Some budgets were exceeded without such an explanation.
    Broken,
}

impl Report {
    fn read(file: &Path) -> anyhow::Result<Self> {
        let text = read_text(file, MAX_TABLE_BYTES).with_context(|| format!("{}", file.display()))?;
        let report: Report = serde_json::from_str(&text)
            .with_context(|| format!("{}: expected a report of vitreo run", file.display()))?;
        let judged = report.stages.iter().any(|s| s.is_judged());
        ensure!(
            judged,
            "{}: no budget was checked; the first second of a run does not count",
            file.display()
        );
        for (key, percent) in report.load.iter().flat_map(|l| {
            [("load.others_percent", l.others_percent), ("load.stolen_percent", l.stolen_percent)]
        }) {
            ensure!(
                (0.0..=100.0).contains(&percent),
                "{}: {key} is {percent}, expected 0 to 100",
                file.display()
            );
        }
        Ok(report)
    }

    fn broken(&self) -> impl Iterator<Item = &Stage> {
        self.stages.iter().filter(|s| s.broken)
    }

    fn verdict(&self) -> Verdict {
        if self.broken().next().is_none() {
            return Verdict::Kept;
        }
        let explained = self.load.is_some_and(|l| self.broken().all(|s| l.explains(&s.judged())));
        if explained { Verdict::Explained } else { Verdict::Broken }
    }

    /// The verdict as a sentence, with the load and the exceeded budgets.
    fn sentence(&self) -> String {
        let load = self.load.map_or_else(|| NO_LOAD.to_owned(), |l| l.text());
        let broken: Vec<String> = self.broken().map(|s| s.blame(self.load)).collect();
        let broken = broken.join("; ");
        match self.verdict() {
            Verdict::Kept => format!("{} met{}; {load}", self.checked(), self.rendering()),
            Verdict::Explained => format!("EXCEEDED, by no more than the load explains ({load}): {broken}"),
            Verdict::Broken => format!("EXCEEDED, and the load does not explain it ({load}): {broken}"),
        }
    }

    /// The budgets that were checked, and stages without samples, as the subject of a sentence.
    fn checked(&self) -> String {
        let idle = self.stages.iter().filter(|s| s.verdict == "no-samples").map(|s| s.stage.as_str());
        let idle = idle.collect::<Vec<_>>().join(", ");
        match idle.is_empty() {
            true => "all latency budgets were".into(),
            false => format!("all checked latency budgets (no samples: {idle}) were"),
        }
    }

    /// Figures of the rendering and its tiers as text; empty if nothing was drawn.
    fn rendering(&self) -> String {
        let drawn = self.stages.iter().find(|s| s.stage == "rendering" && s.is_judged());
        let (Some(s), Some(picture)) = (drawn, &self.picture) else { return String::new() };
        let Stage { percentile, judged_ms, budget_ms, p50_ms, .. } = s;
        let tiers = picture.tiers_text();
        format!(", rendering p50 {p50_ms:.1}, p{percentile} {judged_ms:.1} of {budget_ms} ms at {tiers}")
    }
}

impl Picture {
    /// Quality tiers at which frames were drawn, with their fractions of the frames, 0 to 1; the most
    /// frequent tier first.
    fn tiers(&self) -> Vec<(u32, f64)> {
        let all = self.frames_by_tier.values().sum::<u64>() as f64;
        let mut tiers: Vec<_> = self.frames_by_tier.iter().collect();
        tiers.sort_by_key(|&(_, frames)| std::cmp::Reverse(frames));
        tiers.into_iter().map(|(tier, frames)| (*tier, *frames as f64 / all)).collect()
    }

    /// The tiers as text for a sentence.
    fn tiers_text(&self) -> String {
        let tiers = self.tiers();
        if let [(tier, _)] = tiers[..] {
            return format!("quality tier {tier} (0 is the best)");
        }
        let shares =
            tiers.iter().map(|(tier, share)| format!("{tier} ({:.0} % of the frames)", 100.0 * share));
        format!("quality tiers {}; 0 is the best", shares.collect::<Vec<_>>().join(", "))
    }

    /// The tiers as text for a table cell.
    fn tiers_cell(&self) -> String {
        self.tiers().iter().map(|(tier, _)| tier.to_string()).collect::<Vec<_>>().join(", ")
    }
}

impl Stage {
    fn is_judged(&self) -> bool {
        matches!(self.verdict.as_str(), "kept" | "broken")
    }

    fn judged(&self) -> Judged {
        Judged {
            times_ms: [[self.judged_ms, self.budget_ms], [self.mean_ms, self.mean_budget_ms]],
            below_floor: self.below_floor,
            count: self.count,
        }
    }

    /// The exceeded figures of the stage, and their limits under the measured load.
    fn blame(&self, load: Option<Load>) -> String {
        let beside = |budget| {
            load.map_or(String::new(), |l| format!(" ({:.1} under this load)", l.allowed_ms(budget)))
        };
        let mut reasons = vec![];
        if self.budget_ms > 0.0 && self.judged_ms > self.budget_ms {
            let Stage { percentile, judged_ms, budget_ms, violations, count, .. } = self;
            let beside = beside(*budget_ms);
            reasons.push(format!(
                "p{percentile} {judged_ms:.1} of {budget_ms} ms{beside}, {violations} of {count} over"
            ));
        }
        if self.mean_budget_ms > 0.0 && self.mean_ms > self.mean_budget_ms {
            let beside = beside(self.mean_budget_ms);
            reasons.push(format!("mean {:.1} of {} ms{beside}", self.mean_ms, self.mean_budget_ms));
        }
        if self.below_floor > 0 {
            reasons.push(format!("{} of {} frames smaller than 2×320×256", self.below_floor, self.count));
        }
        format!("{} {}", self.stage, reasons.join(", "))
    }

    /// The figure at the judged percentile and its budget, for a table cell.
    fn cell(&self) -> String {
        match self.is_judged() {
            true => {
                format!("{:.1}/{}{}", self.judged_ms, self.budget_ms, if self.broken { " !" } else { "" })
            }
            false => "–".into(),
        }
    }
}

/// Runs `vitreo budgets`. Returns [`BUDGET`] as exit code if too few reports meet their budgets.
///
/// # Errors
/// If a report cannot be read or contains no checked budget, or `--at-least` exceeds the number of reports.
pub fn run(args: &BudgetsArgs) -> anyhow::Result<ExitCode> {
    let reports = args.reports.iter().map(|f| Report::read(f)).collect::<anyhow::Result<Vec<_>>>()?;
    let asked = args.at_least.unwrap_or(reports.len());
    if asked > reports.len() {
        let problem =
            format!("--at-least {asked}: expected at most the number of reports, {}", reports.len());
        return Err(WrongUse(problem).into());
    }
    let of = |wanted| reports.iter().filter(|r| r.verdict() == wanted).count();
    let (kept, explained) = (of(Verdict::Kept), if args.forgive_load { of(Verdict::Explained) } else { 0 });
    if !args.brief {
        print_table(&args.reports, &reports);
    }
    for (file, report) in args.reports.iter().zip(&reports) {
        let forgiven = args.forgive_load && report.verdict() == Verdict::Explained;
        println!("{}: {}{}", file.display(), report.sentence(), if forgiven { "; forgiven" } else { "" });
    }
    if !args.brief {
        let forgiven = if args.forgive_load { format!(", {explained} forgiven") } else { String::new() };
        println!("all budgets met in {kept} of {} runs{forgiven}; {asked} required", reports.len());
    }
    Ok(if kept + explained >= asked { ExitCode::SUCCESS } else { ExitCode::from(BUDGET) })
}

fn print_table(files: &[PathBuf], reports: &[Report]) {
    let names: Vec<&str> = reports[0].stages.iter().map(|s| s.stage.as_str()).collect();
    println!("latency at the judged percentile / its budget, ms (! marks values over budget)");
    println!("tiers: quality tiers of the picture, the one with the most frames first; 0 is the best");
    println!("{:<24}{:>8}{}", "run", "tiers", names.iter().map(|n| format!("{n:>15}")).collect::<String>());
    for (file, report) in files.iter().zip(reports) {
        let name = file.file_stem().unwrap_or_default().to_string_lossy();
        let cells = report.stages.iter().map(|s| format!("{:>15}", s.cell()));
        let tiers = report.picture.as_ref().map_or_else(|| "–".into(), Picture::tiers_cell);
        println!("{name:<24}{tiers:>8}{}", cells.collect::<String>());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn report(rendering_ms: f64, load: &str) -> String {
        let broken = rendering_ms > 15.0;
        let verdict = if broken { "broken" } else { "kept" };
        format!(
            r#"{{"stages": [{{"stage": "rendering", "verdict": "{verdict}", "broken": {broken}, "percentile": 99.0,
            "p50_ms": 7.9, "judged_ms": {rendering_ms}, "budget_ms": 15.0, "mean_ms": 8.0, "mean_budget_ms": 0.0,
            "violations": 3, "count": 90, "below_floor": 0, "span": "a → b"}}],
            "picture": {{"frames": 90, "frames_by_tier": {{"5": 30, "6": 60}}}}, "load": {load}}}"#
        )
    }

    fn beside(others_percent: f64) -> String {
        format!(r#"{{"processors": 2, "others_percent": {others_percent}, "stolen_percent": 0.0}}"#)
    }

    #[test]
    fn enough_kept_runs_are_enough_and_no_more_is_forgiven_than_a_load_explains() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, text: String| {
            let path = folder.path().join(name);
            fs::write(&path, text).unwrap();
            path
        };
        let good = file("a.json", report(12.0, &beside(1.0)));
        // A budget of 15 ms becomes 20 ms if other programs took a quarter of the processor time.
        let explained = file("b.json", report(19.9, &beside(25.0)));
        let beyond = file("c.json", report(20.1, &beside(25.0)));
        let own = file("d.json", report(15.5, &beside(2.0)));
        let unknown = file("e.json", report(15.5, "null"));
        let code = |reports: &[&PathBuf], at_least, forgive_load| {
            let reports = reports.iter().map(|p| (*p).clone()).collect();
            let args = BudgetsArgs { reports, at_least, forgive_load, brief: false };
            run(&args).map(|c| c == ExitCode::SUCCESS)
        };
        assert!(code(&[&good, &good, &explained], Some(2), false).unwrap());
        assert!(!code(&[&good, &explained], None, false).unwrap());
        assert!(code(&[&good, &explained], None, true).unwrap());
        for blamed in [&beyond, &own, &unknown] {
            assert!(!code(&[&good, blamed], None, true).unwrap(), "{}", blamed.display());
        }
        assert!(
            code(&[&good], Some(2), false)
                .unwrap_err()
                .to_string()
                .contains("at most the number of reports, 1")
        );
        for (path, begins, holds) in [
            (
                &good,
                "all latency budgets were met",
                "p50 7.9, p99 12.0 of 15 ms at quality tiers 6 (67 % of the frames), 5 (33 % of the frames); 0 is the \
                 best; other programs",
            ),
            (
                &explained,
                "EXCEEDED, by no more than the load explains (other programs took 25 %",
                "19.9 of 15 ms (20.0 under this load)",
            ),
            (
                &beyond,
                "EXCEEDED, and the load does not explain it",
                "20.1 of 15 ms (20.0 under this load), 3 of 90 over",
            ),
            (
                &unknown,
                "EXCEEDED, and the load does not explain it (the machine's other load is unknown)",
                "15.5 of 15 ms, 3",
            ),
        ] {
            let told = Report::read(path).unwrap().sentence();
            assert!(told.starts_with(begins) && told.contains(holds), "{told}");
        }
    }

    #[test]
    fn what_is_no_report_or_judged_nothing_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.json");
        for (text, expected) in [
            ("", "expected a report"),
            ("{\"stages\": []}", "no budget was checked"),
            (&report(1.0, "null").replace("kept", "no-samples"), "no budget was checked"),
            (&report(1.0, &beside(-3.0)), "load.others_percent is -3, expected 0 to 100"),
        ] {
            fs::write(&path, text).unwrap();
            let told = format!("{:#}", Report::read(&path).unwrap_err());
            assert!(told.contains("x.json") && told.contains(expected), "{told}");
        }
        assert!(Report::read(Path::new("/no/such")).unwrap_err().to_string().contains("/no/such"));
    }
}
