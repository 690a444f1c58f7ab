//! `vitreo suite`: recordings, streams and modules, in parallel, against what is expected of them.
//!
//! - `file`: what a suite says
//! - `case`: one of its cases
//! - `truth`: where the tips of a stream were
//! - `junit`: the outcome for build servers

mod case;
mod file;
mod junit;
mod truth;

use crate::stop::StopSignal;
use anyhow::{Context, bail, ensure};
use case::Checked;
use file::{Case, Suite};
use ipc::logging::with_causes;
use outputs::exit::DIFFERS;
use outputs::progress::files_bar;
use outputs::{Outputs, println};
use settings::commands::SuiteArgs;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::available_parallelism;
use std::time::Instant;

/// What came of a case.
#[derive(Debug)]
struct Outcome {
    name: String,
    /// An error where it could not be run.
    checked: Result<Checked, String>,
    seconds: f64,
}

impl Outcome {
    /// Whether it could not be run (`error`), or is not as expected.
    fn has_failed(&self, error: bool) -> bool {
        match &self.checked {
            Ok(checked) => !error && !checked.failures.is_empty(),
            Err(_) => error,
        }
    }

    /// A line, and one for each expectation that does not hold.
    fn text(&self) -> String {
        let Outcome { name, seconds, .. } = self;
        match &self.checked {
            Err(problem) => format!("ERROR  {name} ({seconds:.1} s)\n         {problem}"),
            Ok(Checked { compared, failures, verified }) => {
                let word = if failures.is_empty() { "ok    " } else { "FAILED" };
                let bits =
                    if *verified > 0 { format!(", {verified} poses and states") } else { String::new() };
                let lines: String = failures.iter().map(|failure| format!("\n         {failure}")).collect();
                format!("{word} {name} ({compared} compared{bits}, {seconds:.1} s){lines}")
            }
        }
    }
}

/// Runs it. Exit code 0 where all is as expected, 5 where something is not or a case could not be run.
///
/// # Errors
/// Where the suite is refused, no case is chosen, a signal stops it, or the outcome cannot be written.
pub fn run(args: &SuiteArgs) -> anyhow::Result<ExitCode> {
    let stop = StopSignal::install().context("signals")?;
    let mut outputs = Outputs::new(args.force.force).reading(&args.file);
    args.junit.as_deref().map_or(Ok(()), |file| outputs.claim(file))?;
    let mut cases = Suite::load(&args.file)?.case;
    let all = cases.len();
    cases.retain(|case| args.only.as_ref().is_none_or(|text| case.name.contains(text)));
    let only = args.only.as_deref().unwrap_or_default();
    ensure!(!cases.is_empty(), "--only {only}: none of the {all} case names contains it");
    let folder = args.file.parent().unwrap_or(Path::new(""));
    let outcomes = run_all(&cases, folder, args.jobs, &stop);
    let Some(outcomes) = outcomes else { bail!(crate::pace::Stopped) };
    outcomes.iter().for_each(|outcome| println!("{}", outcome.text()));
    let bad = outcomes.iter().filter(|o| o.has_failed(true) || o.has_failed(false)).count();
    println!("{} cases, {bad} not as expected", outcomes.len());
    if let Some(path) = &args.junit {
        outputs.write(path, junit::xml(&args.file.display().to_string(), &outcomes)?)?;
    }
    Ok(if bad > 0 { ExitCode::from(DIFFERS) } else { ExitCode::SUCCESS })
}

/// Runs every case, several at a time; `None` where a signal came before the end.
fn run_all(cases: &[Case], folder: &Path, jobs: Option<u32>, stop: &StopSignal) -> Option<Vec<Outcome>> {
    let jobs = jobs.map_or_else(|| available_parallelism().map_or(1, Into::into), |jobs| jobs as usize);
    let (next, bar) = (AtomicUsize::new(0), files_bar(cases.len() as u64, "cases"));
    let done: Vec<Mutex<Option<Outcome>>> = cases.iter().map(|_| Mutex::default()).collect();
    std::thread::scope(|scope| {
        for _ in 0..jobs.min(cases.len()) {
            scope.spawn(|| {
                while !stop.is_raised()
                    && let at = next.fetch_add(1, Ordering::Relaxed)
                    && let Some(case) = cases.get(at)
                {
                    if let Ok(mut place) = done[at].lock() {
                        *place = Some(outcome(case, folder));
                    }
                    bar.inc(1);
                }
            });
        }
    });
    bar.finish_and_clear();
    done.into_iter().map(|place| place.into_inner().ok().flatten()).collect()
}

fn outcome(case: &Case, folder: &Path) -> Outcome {
    let begun = Instant::now();
    let checked = case::check(case, folder).map_err(|problem| with_causes(problem.as_ref()));
    Outcome { name: case.name.clone(), checked, seconds: begun.elapsed().as_secs_f64() }
}
