//! The likely cause of large residuals, at the end of a run. `vitreo-replay` searches it in the recording,
//! within a time limit, which is shorter after Ctrl-C.

use super::report::Report;
use crate::programs::REPLAY;
use crate::runtime::StopSignal;
use anyhow::{Context, bail};
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
/// Longest search after a normal end of a run, and after an end by a signal.
const WITHIN: [Duration; 2] = [Duration::from_millis(10_000), Duration::from_millis(1_500)];
/// Besides, for starting and reading.
const MARGIN: Duration = Duration::from_millis(400);
/// Residuals of a body above which a run that was not recorded says how the cause is found, px RMS: a rig that
/// holds leaves less.
const NOISE_PX: f64 = 0.4;

/// What became of the search.
enum Found {
    /// Message; none if the rig is consistent.
    Said(Option<String>),
    /// There was no time for it.
    LeftOff,
}

/// Prints the likely cause of a run's residuals, if there is one. `has_cameras`: something was tracked.
pub async fn print(report: &Report, has_cameras: bool, stop: &StopSignal) {
    if !has_cameras || report.tracking.frames == 0 {
        return;
    }
    let Some(recording) = report.recording.as_ref().filter(|r| r.problem.is_none()) else {
        return print_how_to_find(report);
    };
    match search(Path::new(&recording.file), stop).await {
        Ok(Found::Said(said)) => said.iter().for_each(|text| println!("{text}")),
        Ok(Found::LeftOff) => {
            println!(
                "the search for the cause of the residuals was stopped; to continue: vitreo residuals {} --causes",
                recording.file
            );
        }
        Err(problem) => warn(&format!("the cause of residuals: {problem:#}")),
    }
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
    let within = WITHIN[usize::from(hurried)];
    let mut asked = Command::from(command(REPLAY)?);
    asked.args(arguments()).args(["--no-config", "residuals"]).arg(file);
    asked.args(["--causes", "--json", "--last", LAST_S, "--within", &within.as_secs_f64().to_string()]);
    asked.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).kill_on_drop(true);
    let answer = asked.output();
    let answered = tokio::select! {
        answered = timeout(within + MARGIN, answer) => answered,
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
    Ok(Found::Said(figures["likely_cause"].as_str().map(str::to_owned)))
}
