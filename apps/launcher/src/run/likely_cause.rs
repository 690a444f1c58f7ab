//! The likely cause of large residuals, at the end of a run. `vitreo-replay` judges the recording. Its work is bounded,
//! not its time, so that a recording is always judged alike; after Ctrl-C, where somebody waits, its time is too.

use super::report::Report;
use crate::programs::REPLAY;
use crate::runtime::StopSignal;
use anyhow::{Context, bail};
use diagnosis::{Finding, Warning, with_judged};
use ipc::logging::{arguments, warn};
use ipc::programs::command;
use outputs::println;
use serde_json::Value;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;
use tokio::process::Command;
use tokio::time::timeout;

/// The last part of a recording, which is judged, s.
const LAST_S: &str = "60";
/// Longest search after an end of a run by a signal, and the time besides for starting and reading.
const HURRIED: [Duration; 2] = [Duration::from_millis(1_500), Duration::from_millis(400)];
/// Longest wait after a normal end: something is broken then.
const LONGEST: Duration = Duration::from_secs(120);
/// Residuals of a body above which a run that was not recorded says how the cause is found, px RMS: a rig that
/// holds leaves less.
const NOISE_PX: f64 = 0.4;
/// Share of the frames in which a body is tracked below which something may be wrong.
const TRACKED_SHARE: f64 = 0.9;

/// What became of the search.
enum Found {
    /// Message and warning; none if the rig is consistent.
    Said(Option<String>, Option<Warning>),
    /// There was no time for it.
    LeftOff,
}

/// Prints the likely cause of a run's residuals, if there is one, and adds it to the warnings of the report.
/// `has_cameras`: something was tracked.
pub async fn print(report: &mut Report, has_cameras: bool, stop: &StopSignal) {
    if !has_cameras || report.tracking.frames == 0 {
        return;
    }
    let Some(recording) = report.recording.as_ref().filter(|r| r.problem.is_none()) else {
        return print_how_to_find(report);
    };
    match search(Path::new(&recording.file), stop).await {
        Ok(Found::Said(said, warning)) => {
            said.iter().for_each(|text| println!("{text}"));
            report.warnings = with_judged(std::mem::take(&mut report.warnings), warning);
        }
        Ok(Found::LeftOff) if is_suspect(report) => {
            println!(
                "the search for the cause of the residuals was stopped; to continue: vitreo residuals {} --causes",
                recording.file
            );
        }
        Ok(Found::LeftOff) => {}
        Err(problem) => warn(&format!("the cause of residuals: {problem:#}")),
    }
}

/// True where what the tracker leaves is more than a rig that holds does.
fn is_suspect(report: &Report) -> bool {
    let large = |residual_px: f64| residual_px > NOISE_PX;
    report.least_tracked.1 < TRACKED_SHARE
        || report.tracking.bodies.values().any(|body| large(body.summary.residual_rms_px))
}

/// Without a recording, only the presence of a problem can be reported.
fn print_how_to_find(report: &Report) {
    let large = report.tracking.bodies.iter().filter(|(_, body)| body.summary.residual_rms_px > NOISE_PX);
    let Some((name, body)) =
        large.max_by(|(_, a), (_, b)| a.summary.residual_rms_px.total_cmp(&b.summary.residual_rms_px))
    else {
        return;
    };
    println!(
        "residuals of {name} are {:.2} px RMS, above the cameras' noise: with --record, a run ends with the likely cause",
        body.summary.residual_rms_px
    );
}

/// Asks the program of recordings, until it has answered, its time is over, or a further signal comes.
async fn search(file: &Path, stop: &StopSignal) -> anyhow::Result<Found> {
    let hurried = stop.is_raised();
    let mut asked = Command::from(command(REPLAY)?);
    asked.args(arguments()).args(["--no-config", "residuals"]).arg(file);
    asked.args(["--causes", "--json", "--last", LAST_S]);
    if hurried {
        asked.args(["--within", &HURRIED[0].as_secs_f64().to_string()]);
    }
    asked.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).kill_on_drop(true);
    let answer = asked.output();
    let answered = tokio::select! {
        answered = timeout(if hurried { HURRIED.iter().sum() } else { LONGEST }, answer) => answered,
        () = stop.raised(), if !hurried => return Ok(Found::LeftOff),
    };
    let Ok(answered) = answered else { return Ok(Found::LeftOff) };
    let answered = answered.with_context(|| REPLAY.to_owned())?;
    if !answered.status.success() {
        bail!("{REPLAY} residuals {}: {}", file.display(), answered.status);
    }
    let figures: Value = serde_json::from_slice(&answered.stdout).context("its answer")?;
    if figures["causes"]["verdict"] == "stopped" {
        return Ok(Found::LeftOff);
    }
    Ok(Found::Said(figures["likely_cause"].as_str().map(str::to_owned), warning_of(&figures["warning"])))
}

/// A warning as `vitreo-replay` writes it.
fn warning_of(value: &Value) -> Option<Warning> {
    let text = |key: &str| value[key].as_str().map(str::to_owned);
    let finding = Finding {
        what: text("what")?,
        cause: text("cause")?,
        remedy: text("remedy")?,
        subject: "rig".into(),
    };
    Some(Warning { from_s: value["from_s"].as_f64()?, to_s: None, finding })
}
