//! `vitreo budgets`: reports of runs side by side, judged by their latency budgets.

use crate::exit::BUDGET;
use crate::run::Load;
use anyhow::{Context, ensure};
use outputs::println;
use serde::Deserialize;
use std::fs::read_to_string;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Arguments of `vitreo budgets`.
#[derive(Debug, clap::Args)]
pub struct BudgetsArgs {
    /// Reports that `vitreo run --report` wrote.
    #[arg(value_name = "REPORT.json", required = true)]
    pub reports: Vec<PathBuf>,
    /// Of how many reports all budgets must be kept; all of them where it is not given.
    #[arg(long, value_name = "N")]
    pub at_least: Option<usize>,
    /// Pass over budgets that were broken while other programs loaded the machine; say so only.
    #[arg(long)]
    pub forgive_load: bool,
}

/// What is read of a report.
#[derive(Debug, Deserialize)]
struct Report {
    stages: Vec<Stage>,
    load: Option<Load>,
}

/// A stage of a report. Durations in ms.
#[derive(Debug, Deserialize)]
struct Stage {
    stage: String,
    verdict: String,
    broken: bool,
    percentile: f64,
    judged_ms: f64,
    budget_ms: f64,
    mean_ms: f64,
    mean_budget_ms: f64,
    violations: u64,
    count: u64,
    below_floor: u64,
}

impl Report {
    fn read(file: &Path) -> anyhow::Result<Self> {
        let text = read_to_string(file).with_context(|| format!("{}", file.display()))?;
        let report: Report = serde_json::from_str(&text)
            .with_context(|| format!("{}: expected a report of vitreo run", file.display()))?;
        let judged = report.stages.iter().any(|s| s.is_judged());
        ensure!(judged, "{}: no budget was judged; the first second of a run does not count", file.display());
        Ok(report)
    }

    fn is_kept(&self) -> bool {
        self.stages.iter().all(|s| !s.broken)
    }

    fn is_loaded(&self) -> bool {
        self.load.is_some_and(|l| l.is_loaded())
    }

    /// In words.
    fn verdict(&self) -> String {
        let load = self.load.map(|l| l.text()).unwrap_or_else(|| "the system does not tell its load".into());
        if self.is_kept() {
            return format!("kept; {load}");
        }
        let broken: Vec<String> = self.stages.iter().filter(|s| s.broken).map(Stage::blame).collect();
        let broken = broken.join("; ");
        match self.is_loaded() {
            true => format!("BROKEN on a loaded machine ({load}): {broken}"),
            false => format!("BROKEN by the program itself ({load}): {broken}"),
        }
    }
}

impl Stage {
    fn is_judged(&self) -> bool {
        matches!(self.verdict.as_str(), "kept" | "broken")
    }

    fn blame(&self) -> String {
        let mut told = vec![];
        if self.budget_ms > 0.0 && self.judged_ms > self.budget_ms {
            let Stage { percentile, judged_ms, budget_ms, violations, count, .. } = self;
            told.push(format!(
                "p{percentile} {judged_ms:.1} of {budget_ms} ms, {violations} of {count} over"
            ));
        }
        if self.mean_budget_ms > 0.0 && self.mean_ms > self.mean_budget_ms {
            told.push(format!("mean {:.1} of {} ms", self.mean_ms, self.mean_budget_ms));
        }
        if self.below_floor > 0 {
            told.push(format!("{} of {} frames smaller than 2×320×256", self.below_floor, self.count));
        }
        format!("{} {}", self.stage, told.join(", "))
    }

    /// The judged figure beside its limit, for a table.
    fn cell(&self) -> String {
        match self.is_judged() {
            true => {
                format!("{:.1}/{}{}", self.judged_ms, self.budget_ms, if self.broken { " !" } else { "" })
            }
            false => "–".into(),
        }
    }
}

/// Runs it.
///
/// # Errors
/// Where a report cannot be read, or judged nothing.
pub fn run(args: &BudgetsArgs) -> anyhow::Result<ExitCode> {
    let reports = args.reports.iter().map(|f| Report::read(f)).collect::<anyhow::Result<Vec<_>>>()?;
    let asked = args.at_least.unwrap_or(reports.len());
    ensure!(asked <= reports.len(), "--at-least {asked}: only {} reports are given", reports.len());
    print_table(&args.reports, &reports);
    let kept = reports.iter().filter(|r| r.is_kept()).count();
    println!("all budgets kept in {kept} of {} runs, asked {asked}", reports.len());
    let forgiven = reports.iter().filter(|r| args.forgive_load && !r.is_kept() && r.is_loaded()).count();
    Ok(if kept + forgiven >= asked { ExitCode::SUCCESS } else { ExitCode::from(BUDGET) })
}

fn print_table(files: &[PathBuf], reports: &[Report]) {
    let names: Vec<&str> = reports[0].stages.iter().map(|s| s.stage.as_str()).collect();
    println!("latency at the judged percentile / its budget, ms (! is over it)");
    println!("{:<24}{}", "run", names.iter().map(|n| format!("{n:>15}")).collect::<String>());
    for (file, report) in files.iter().zip(reports) {
        let name = file.file_stem().unwrap_or_default().to_string_lossy();
        let cells = report.stages.iter().map(|s| format!("{:>15}", s.cell()));
        println!("{name:<24}{}", cells.collect::<String>());
    }
    for (file, report) in files.iter().zip(reports) {
        println!("{}: {}", file.display(), report.verdict());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn report(rendering_ms: f64, others_percent: f64) -> String {
        let broken = rendering_ms > 15.0;
        let verdict = if broken { "broken" } else { "kept" };
        format!(
            r#"{{"stages": [{{"stage": "rendering", "verdict": "{verdict}", "broken": {broken}, "percentile": 99.0,
            "judged_ms": {rendering_ms}, "budget_ms": 15.0, "mean_ms": 8.0, "mean_budget_ms": 0.0,
            "violations": 3, "count": 90, "below_floor": 0, "span": "a → b"}}],
            "load": {{"processors": 2, "others_percent": {others_percent}, "stolen_percent": 0.0}}}}"#
        )
    }

    #[test]
    fn enough_kept_runs_are_enough_and_a_loaded_machine_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, text: String| {
            let path = folder.path().join(name);
            fs::write(&path, text).unwrap();
            path
        };
        let good = file("a.json", report(12.0, 1.0));
        let slow = file("b.json", report(16.0, 60.0));
        let code = |reports: &[&PathBuf], at_least, forgive_load| {
            let reports = reports.iter().map(|p| (*p).clone()).collect();
            run(&BudgetsArgs { reports, at_least, forgive_load }).map(|c| c == ExitCode::SUCCESS)
        };
        let own = file("d.json", report(16.0, 2.0));
        assert!(code(&[&good, &good, &slow], Some(2), false).unwrap());
        assert!(!code(&[&good, &slow], None, false).unwrap());
        assert!(code(&[&good, &slow], None, true).unwrap());
        assert!(!code(&[&good, &own], None, true).unwrap(), "nobody else can be blamed");
        assert!(code(&[&good], Some(2), false).unwrap_err().to_string().contains("only 1"));
        let told = Report::read(&slow).unwrap().verdict();
        assert!(told.starts_with("BROKEN on a loaded machine (other programs took 60 %"), "{told}");
        assert!(told.contains("rendering p99 16.0 of 15 ms, 3 of 90 over"), "{told}");
        let told = Report::read(&file("c.json", report(16.0, 2.0))).unwrap().verdict();
        assert!(told.starts_with("BROKEN by the program itself"), "{told}");
    }

    #[test]
    fn what_is_no_report_or_judged_nothing_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.json");
        for (text, expected) in [
            ("", "expected a report"),
            ("{\"stages\": []}", "no budget was judged"),
            (&report(1.0, 0.0).replace("kept", "no-samples"), "no budget was judged"),
        ] {
            fs::write(&path, text).unwrap();
            let told = format!("{:#}", Report::read(&path).unwrap_err());
            assert!(told.contains("x.json") && told.contains(expected), "{told}");
        }
        assert!(Report::read(Path::new("/no/such")).unwrap_err().to_string().contains("/no/such"));
    }
}
