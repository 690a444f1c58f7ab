//! Prints the likely cause of large residuals at the end of a run. `vitreo-replay` searches for it in the
//! recording. The amount of work is bounded, not the time, so that the result does not depend on the
//! machine's speed. After Ctrl-C, when the user waits, the time is bounded as well.

use super::report::Report;
use crate::programs::REPLAY;
use crate::runtime::StopSignal;
use anyhow::{Context, bail};
use diagnosis::{Finding, Judged, SHORTEST_S, Warning, with_judged};
use ipc::logging::{arguments, warn};
use ipc::programs::command;
use outputs::{println, shell_word};
use serde_json::Value;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;
use tokio::process::Command;
use tokio::time::timeout;

/// The search uses the last part of a recording, of this length, s.
const LAST_S: &str = "60";
/// Maximum time after a run that was ended by a signal: for the search, and in addition for starting the
/// program and reading the file.
const HURRIED: [Duration; 2] = [Duration::from_millis(1_500), Duration::from_millis(400)];
/// Timeout after a normal end, which is exceeded only if something is broken.
const LONGEST: Duration = Duration::from_secs(120);
/// Residual of a body, px RMS, above which the end of an unrecorded run names `--record` as the way to the
/// cause. The residuals of a well-calibrated rig are smaller.
const NOISE_PX: f64 = 0.4;
/// Minimum share of frames in which each body is tracked on a well-working rig, 0 to 1.
const TRACKED_SHARE: f64 = 0.9;

/// Result of the search.
enum Found {
    /// Text and warning; both `None` if the rig is consistent. `too_little`: what was missing for a judgement.
    Said { text: Option<String>, warning: Option<Judged>, too_little: Option<String> },
    /// The search ran out of time or was interrupted.
    TimedOut,
}

/// Prints the likely cause of a run's residuals, if there is one, and adds it to the warnings of the report.
/// `has_cameras`: the poses come from the tracker. Returns what was missing for a judgement, if nothing was judged.
pub async fn print(report: &mut Report, has_cameras: bool, stop: &StopSignal) -> Option<String> {
    let too_short = too_short(report.duration_s);
    if !has_cameras || report.tracking.frames == 0 {
        return too_short;
    }
    let Some(recording) = report.recording.as_ref().filter(|r| r.problem.is_none()) else {
        print_how_to_find(report);
        return too_short;
    };
    match search(Path::new(&recording.file), stop).await {
        Ok(Found::Said { text, warning, too_little }) => {
            text.iter().for_each(|text| println!("{text}"));
            report.warnings = with_judged(std::mem::take(&mut report.warnings), warning);
            return too_little;
        }
        Ok(Found::TimedOut) if is_suspect(report) => {
            println!(
                "the search for the cause of the residuals was stopped; to continue: vitreo residuals {} --causes",
                shell_word(&recording.file)
            );
        }
        Ok(Found::TimedOut) => {}
        Err(problem) => warn(&format!("the cause of residuals: {problem:#}")),
    }
    too_short
}

/// What a run of this length lacks for the warnings that appear while it runs.
fn too_short(duration_s: f64) -> Option<String> {
    (duration_s < SHORTEST_S)
        .then(|| format!("a run of {duration_s:.1} s, at least {SHORTEST_S:.0} s are needed"))
}

/// True if residuals or tracked share are worse than those of a well-calibrated rig.
fn is_suspect(report: &Report) -> bool {
    let large = |residual_px: f64| residual_px > NOISE_PX;
    report.least_tracked.1 < TRACKED_SHARE
        || report.tracking.bodies.values().any(|body| large(body.summary.residual_rms_px))
}

/// Prints a hint for a run without a recording, in which the cause cannot be searched for.
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

/// Runs `vitreo-replay residuals` until it answers, its time is over, or a further signal arrives.
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
        () = stop.raised(), if !hurried => return Ok(Found::TimedOut),
    };
    let Ok(answered) = answered else { return Ok(Found::TimedOut) };
    let answered = answered.with_context(|| REPLAY.to_owned())?;
    if !answered.status.success() {
        bail!("{REPLAY} residuals {}: {}", file.display(), answered.status);
    }
    let figures: Value = serde_json::from_slice(&answered.stdout).context("its answer")?;
    if figures["causes"]["verdict"] == "stopped" {
        return Ok(Found::TimedOut);
    }
    let text = |key: &str| figures[key].as_str().map(str::to_owned);
    let (text, too_little) = (text("likely_cause"), text("too_little"));
    Ok(Found::Said { text, warning: judged_of(&figures), too_little })
}

/// Parses a judgement as `vitreo-replay` writes it.
fn judged_of(figures: &Value) -> Option<Judged> {
    let value = &figures["warning"];
    let text = |key: &str| value[key].as_str().map(str::to_owned);
    let finding = Finding {
        what: text("what")?,
        cause: text("cause")?,
        remedy: text("remedy")?,
        subject: "rig".into(),
    };
    let warning = Warning { from_s: value["from_s"].as_f64()?, to_s: None, finding };
    let ids = figures["cameras"].as_array().into_iter().flatten();
    let cameras = ids.filter_map(|id| u32::try_from(id.as_u64()?).ok()).collect();
    Some(Judged { warning, cameras })
}
