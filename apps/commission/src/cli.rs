//! `vitreo commission`: the command line.

use crate::check::{self, CheckArgs};
use crate::folder::{Folder, Outcome, Record, Step};
use crate::lenses::{self, LensesArgs};
use crate::pictures::PicturesArgs;
use crate::poses::{self, PosesArgs};
use crate::trocars::{self, TrocarsArgs};
use crate::{NotBetter, Refused, colours};
use anyhow::{Result, anyhow};
use ipc::logging::{LogArgs, inform, warn};
use outputs::{Force, println, shell_word};
use settings::{Program, SettingsArgs};
use std::path::PathBuf;
use std::process::ExitCode;

/// What vitreo.toml says to the commissioning.
pub const SETTINGS: Program = Program { prefix: "commission", without: &[], elsewhere: None };

/// Set up a new rig step by step in a folder; without a step, show what is done and what is next.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "vitreo-commission", version)]
pub struct CommissionArgs {
    /// Folder of the rig, with rig.json, colours.toml, pictures and report.html; created if missing.
    #[arg(value_name = "FOLDER")]
    pub folder: PathBuf,
    /// Rig to start from: picture sizes of the cameras, markers, approximate positions [default: the shipped rig].
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
    /// Repeat a completed step; a previous result that is better is kept.
    #[command(flatten)]
    pub force: Force,
    /// What to do.
    #[command(subcommand)]
    pub task: Option<Task>,
    /// Whether files of settings are read.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// Logging.
    #[command(flatten)]
    pub log: LogArgs,
}

/// The steps.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum Task {
    /// Learn the colour classes from pictures of the markers held still.
    Colours(PicturesArgs),
    /// Calibrate the lens of each camera from pictures of a board in different poses.
    Lenses(LensesArgs),
    /// Calibrate the poses of the cameras from a board that they see together, or from waved instruments; exit code 5 if
    /// the rig is wrong, but waved instruments would not make it better.
    Poses(PosesArgs),
    /// Calibrate the trocars and the eye's centre from a stream in which the instruments tilt and the eye turns.
    Trocars(TrocarsArgs),
    /// Check the coverage of the cameras, the accuracy of tips, and whether the rig still holds; exit code 5 if anything
    /// is wrong.
    Check(CheckArgs),
}

impl Task {
    fn step(&self) -> Step {
        match self {
            Task::Colours(_) => Step::Colours,
            Task::Lenses(_) => Step::Lenses,
            Task::Poses(_) => Step::Poses,
            Task::Trocars(_) => Step::Trocars,
            Task::Check(_) => Step::Check,
        }
    }
}

/// Runs a step, or says what is next. Exit codes: 0 done, 1 failed or refused with advice, 5 the check found that
/// something is missing or does not hold, or a step cannot correct what is wrong.
///
/// # Errors
/// Those of the step; nothing is written then.
pub fn run(args: &CommissionArgs) -> Result<ExitCode> {
    let mut folder = Folder::open(&args.folder)?;
    let Some(task) = &args.task else {
        println!("{}", status(&folder));
        return Ok(ExitCode::SUCCESS);
    };
    let step = task.step();
    folder.claim(step, args.force.force)?;
    let rig = folder.rig(args.rig.as_deref())?;
    let done = match task {
        Task::Colours(args) => colours::run(&folder, &rig, args).map(|outcome| (outcome, true)),
        Task::Lenses(args) => lenses::run(&rig, args).map(|outcome| (outcome, true)),
        Task::Poses(args) => poses::run(&folder, &rig, args).map(|outcome| (outcome, true)),
        Task::Trocars(args) => trocars::run(&folder, &rig, args).map(|outcome| (outcome, true)),
        Task::Check(args) => check::run(&folder, &rig, args),
    };
    let (mut outcome, good): (Outcome, bool) = match done {
        Ok(done) => done,
        Err(error) => return refused(step, error),
    };
    // A step that changes the rig keeps it in the folder, also where it began with another one.
    if outcome.rig.as_ref() == Some(&rig) && folder.file("rig.json").exists() {
        outcome.rig = None;
    }
    outcome.record.advice.dedup();
    tell(step, &outcome.record);
    folder.take(step, outcome)?;
    inform(&format!("{} written", folder.file("report.html").display()));
    Ok(if good { ExitCode::SUCCESS } else { ExitCode::from(outputs::exit::DIFFERS) })
}

/// Prints why a step was refused; nothing is written.
fn refused(step: Step, error: anyhow::Error) -> Result<ExitCode> {
    if let Some(NotBetter { found, why }) = error.downcast_ref() {
        println!("{}: {found}", step.name());
        warn(&format!("{}: nothing was written: {why}", step.name()));
        return Ok(ExitCode::from(outputs::exit::DIFFERS));
    }
    match error.downcast_ref() {
        // Each is a line of its own.
        Some(Refused(advice)) if advice.len() > 1 => {
            advice.iter().for_each(|said| warn(said));
            Err(anyhow!("{}: {} problems to correct; nothing was written", step.name(), advice.len()))
        }
        _ => Err(error),
    }
}

fn tell(step: Step, record: &Record) {
    let kept = if record.kept { " (previous values are kept)" } else { "" };
    println!("{}: {}{kept}", step.name(), record.summary);
    for (name, value) in &record.figures {
        println!("  {name}: {value}");
    }
    record.notes.iter().for_each(|note| println!("  note: {note}"));
    record.advice.iter().for_each(|advice| warn(advice));
}

/// What is done and what is next, for a person.
fn status(folder: &Folder) -> String {
    let shown = folder.shown();
    let line = |step: Step| match folder.state.steps.get(&step) {
        Some(record) => {
            let more = record.advice.iter().map(|advice| format!("\n          {advice}")).collect::<String>();
            format!("{:<8}  done: {}{more}", step.name(), record.summary)
        }
        None => format!("{:<8}  to do", step.name()),
    };
    let mut lines: Vec<String> = Step::ALL.into_iter().map(line).collect();
    lines.push(match folder.state.next() {
        Some(step) => format!("next: vitreo commission {} {}", shell_word(&shown), step.how()),
        None => {
            let rig = shell_word(format!("{shown}/rig.json"));
            format!("all steps are done: vitreo run --rig {rig}; see {shown}/report.html")
        }
    });
    lines.join("\n")
}
