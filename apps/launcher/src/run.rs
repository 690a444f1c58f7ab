//! `vitreo run`: runs the simulator in real time.
//! - `options`, `arguments`: the command line and the parsers of its values
//! - `session`: the main loop, which receives, supervises, records and shows the status
//! - `cameras`: real cameras, and waiting for them; `recorded_rig`: the rig of recorded cameras
//! - `colours`: colour classes; `controls`: a real pedal and real handles
//! - `attempt_control`: requests for a pause, a restart or the next level
//! - `supervisor`, `policy`, `standby`: starting and restarting processes, limits of restarts, standby renderers
//! - `channel_tap`, `recorder`, `resume`: receiving, recording, and the journal from which a restarted
//!   simulation resumes
//! - `delivery`: sources that deliver nothing; `watch`, `silence`: warnings; `field_trace`: the trace of every
//!   field
//! - `likely_cause`: the cause of large residuals, searched for at the end
//! - `latency_stats`, `load`, `report`: latencies compared with budgets; `monitor`, `screen`: the status

mod arguments;
mod attempt_control;
mod cameras;
mod channel_tap;
mod colours;
mod controls;
mod delivery;
mod external;
mod field_trace;
mod handed_on;
mod latency_stats;
mod likely_cause;
mod load;
mod monitor;
mod options;
mod policy;
mod recorded_rig;
mod recorder;
mod report;
mod resume;
mod screen;
mod session;
mod silence;
mod standby;
mod supervisor;
mod watch;

pub(crate) use arguments::positive;
pub use arguments::share;
pub use field_trace::TraceOutArgs;
pub(crate) use latency_stats::Durations;
pub use load::{Judged, Load, LoadAccount, NO_LOAD};
pub use options::{OutputArgs, RunArgs, TrainingArgs, TrialArgs, ViewArgs};
pub use policy::MAX_RESTARTS;

use crate::exit::{BUDGET, FAILED, LOSS, UNTRACKED, WARNED};
use crate::machine::{allow_open_files, has_display};
use crate::modules::Composed;
use crate::runtime::{StopSignal, block_on};
use anyhow::Context;
use diagnosis::{is_loss, unjudged, untracked, warned};
use ipc::logging::{inform, warn, with_causes};
use options::{View, open_store};
use outputs::{Outputs, print};
use protocol::budget::Stage;
use protocol::health::Process;
use protocol::steps::STATE_HASH_VERSION;
use recording::{DESK, Provenance, REALTIME_OFFSET, STATE_HASH, TRACKER, TRACKER_VERSION};
use report::{Report, Versions};
use results::keeping::{BEGAN, SURGEON, keep, seconds_since_1970};
use results::scored::live_text;
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};
use session::{Attempt, Closed, Session};
use settings::commands::processes::AUTO;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::ExitCode;
use std::time::SystemTime;

/// Runs `vitreo run`.
///
/// # Errors
/// If arguments or files are refused, a process does not start or dies too often, or the attempt cannot be
/// saved.
pub fn run(args: &RunArgs) -> anyhow::Result<ExitCode> {
    block_on(simulate(args))
}

async fn simulate(args: &RunArgs) -> anyhow::Result<ExitCode> {
    allow_open_files()?;
    let stop = StopSignal::install()?;
    if args.real.unscripted && args.real.poses.is_none() && !cameras::wait(args, &stop).await {
        return Ok(ExitCode::SUCCESS);
    }
    // The files of the recorded rig and of the composed scene exist as long as these values.
    let (args, _rig) = &args.with_rig_of_recording()?;
    let composed = args.training.module.as_deref();
    let composed = composed
        .map(|m| Composed::new(m, args.training.level, &args.training.surgeon, args.virtual_rig.seed));
    let mut composed = composed.transpose()?;
    let args = &args.with_scene_of(composed.as_ref()).with_recording_of_trainee()?;
    let view = args.view(has_display());
    let mut outputs = args.prepare()?;
    let budgets = args.budget_table()?;
    let mut session = Session::open(args, composed.as_mut(), view, &budgets, &mut outputs, stop.clone())?;
    let outcome = session.run().await;
    let ended_by = match &outcome {
        Ok(why) => (*why).to_string(),
        Err(error) => format!("failure: {error:#}"),
    };
    let Closed { mut report, attempts, trace } = session.close(ended_by).await;
    let trace_out = args.outputs.trace.trace_out.as_deref();
    let traced = trace.zip(trace_out).map(|(trace, file)| field_trace::write(&trace, &mut outputs, file));
    let mut shortage = None;
    if report.duration_s > 0.0 {
        print!("{}", report.text());
        attempts.iter().for_each(|a| print!("{}", attempt_text(a, attempts.len())));
        shortage = likely_cause::print(&mut report, args.is_tracked(), &stop).await;
    }
    // The attempt is saved even if the report cannot be written.
    let written =
        args.outputs.report.as_deref().map(|file| write_report(&report, &mut outputs, file)).transpose();
    outcome?;
    if let Some(trainee) = &args.training.trainee {
        keep_all(args, trainee, &attempts)?;
    }
    written?;
    traced.transpose().context("the trace is not written")?;
    Ok(ExitCode::from(verdict(&report, args, view, shortage.as_deref())))
}

/// The score of an attempt as text, with its level if there were several attempts.
fn attempt_text(attempt: &Attempt, attempts: usize) -> String {
    let text = live_text(&attempt.live);
    if attempts > 1 && !text.is_empty() { format!("level {}: {text}", attempt.level) } else { text }
}

/// Saves the attempts in the results store, including abandoned ones. An attempt that cannot be saved and has
/// no score is skipped with a warning if a person operated, there were several attempts, or `--stay` was
/// given; otherwise the error is returned.
fn keep_all(args: &RunArgs, trainee: &str, attempts: &[Attempt]) -> anyhow::Result<()> {
    let mut store = open_store(&args.training.store)?;
    let person = args.desk.is_some() || args.real.given().is_some() || args.real.driver().is_some();
    let open_end = args.training.stay || person || attempts.len() > 1;
    for attempt in attempts {
        let Some(file) = &attempt.record else { continue };
        let kept = match keep(&mut store, trainee, file) {
            Err(problem) if open_end && attempt.live.total.is_none() => {
                warn(&with_causes(problem.as_ref()));
                continue;
            }
            kept => kept.context("the attempt is not in the results store")?,
        };
        kept.warnings.iter().for_each(|text| warn(text));
        if kept.is_new { inform(&kept.text) } else { warn(&kept.text) }
    }
    Ok(())
}

/// Rig, scene, versions and settings, which make a recording self-contained. Called early, because it also
/// validates rig and scene.
fn provenance(args: &RunArgs) -> anyhow::Result<Provenance> {
    let rig = Rig::load_or_shipped(args.rig.rig.as_deref()).context("--rig")?;
    let scene_name = args.scene.scene.as_deref().unwrap_or(DEFAULT_SCENE);
    let scene = SceneFile::load(scene_name)?;
    let scene_name = args.training.module.as_deref().unwrap_or(scene_name);
    let versions = Versions::of_this_build();
    let versions = [
        ("vitreo", Some(versions.vitreo.to_string())),
        ("profile", Some(versions.profile.to_string())),
        (STATE_HASH, Some(STATE_HASH_VERSION.to_string())),
        // The poses of a desk do not come from a tracker.
        (TRACKER, args.is_tracked().then(|| TRACKER_VERSION.to_string())),
    ];
    Ok(Provenance {
        rig_json: rig.to_json(),
        scene_name: scene_name.into(),
        scene_toml: scene.to_toml(),
        seeds: BTreeMap::from([("cameras".into(), args.virtual_rig.seed.to_string())]),
        config: settings_of(args),
        versions: versions.into_iter().filter_map(|(k, v)| Some((k.to_string(), v?))).collect(),
        ..Provenance::default()
    })
}

/// The settings of this run by key, for the recording.
fn settings_of(args: &RunArgs) -> BTreeMap<String, String> {
    let file = |p: &Option<std::path::PathBuf>| p.as_ref().map(|p| p.display().to_string());
    let cameras = &args.virtual_rig;
    let scripted = args.training.module.is_some() && args.is_scripted();
    let config = [
        ("module", args.training.module.as_ref().map(|m| module(args, m, scripted))),
        (BEGAN, Some(seconds_since_1970(SystemTime::now()).to_string())),
        (REALTIME_OFFSET, Some(ipc::clock::realtime_offset_ns().to_string())),
        (SURGEON, scripted.then(|| args.training.surgeon.clone())),
        (
            DESK,
            args.desk
                .as_ref()
                .map(|d| file(&d.inputs).or_else(|| d.input.clone()).unwrap_or_else(|| AUTO.into()))
                // Poses of another tracker are used as they are, like those of a desk.
                .or_else(|| (!args.is_tracked()).then(|| Process::PosesDriver.name().into())),
        ),
        ("poses", args.real.poses.as_ref().map(ToString::to_string)),
        ("external", args.real.external.as_ref().map(ToString::to_string)),
        ("cameras", args.real.given().map(ToString::to_string)),
        ("colours", file(&args.extraction.colours)),
        ("pedal", args.controls.pedal.as_ref().map(ToString::to_string)),
        ("handles", args.controls.handles.as_ref().map(ToString::to_string)),
        ("motion", file(&cameras.motion)),
        ("motion-full", cameras.motion_full.then(|| "true".into())),
        ("blobs", file(&cameras.blobs)),
        ("direct", cameras.direct.then(|| "true".into())),
        ("faults", cameras.faults.clone()),
        (
            "inject-delay",
            (!args.trial.inject_delay.is_empty()).then(|| format!("{:?}", args.trial.inject_delay)),
        ),
    ];
    config.into_iter().filter_map(|(k, v)| Some((k.to_string(), v?))).collect()
}

/// Module, level and scripted surgeon, if any, as text.
fn module(args: &RunArgs, name: &str, scripted: bool) -> String {
    let who = if scripted { format!(", {}", args.training.surgeon) } else { String::new() };
    format!("{name} level {}{who}", args.training.level)
}

fn write_report(report: &Report, outputs: &mut Outputs, file: &Path) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(report)?;
    outputs.write(file, text + "\n").context("the report is not written")
}

/// Text about frames that are missing although their fields arrived, and whether they are enough to count as
/// loss. `None` if restarts, silences or gaps of the input, which are reported elsewhere, explain them.
fn missing_singly(report: &Report, input_has_gaps: bool) -> Option<(String, bool)> {
    let restarted = report.restarts.values().any(|n| *n > 0);
    let missing = report.frames_withheld.saturating_sub(report.overwritten);
    if restarted || input_has_gaps || !report.silences.is_empty() || missing == 0 {
        return None;
    }
    let due = report.tracking.frames_due;
    let text = format!("{missing} of {due} frames are missing although their fields arrived");
    Some((text, is_loss(missing, due)))
}

/// Prints the reasons for the exit code on standard error and returns the code. `shortage`: what was missing for a
/// judgement of cameras and rig.
fn verdict(report: &Report, args: &RunArgs, view: View, shortage: Option<&str>) -> u8 {
    if let Some(problem) = delivery::never_came(args, report) {
        warn(&problem);
        return FAILED;
    }
    if let Some(problem) = report.recording.as_ref().and_then(|recording| recording.problem.as_ref()) {
        warn(&format!("the recording is not complete: {problem}"));
        return FAILED;
    }
    let code = verdict_of_losses(report, args);
    if !report.unfinished.is_empty() {
        // The reason is in the last lines of these processes.
        warn("not everything could be written");
        return FAILED;
    }
    let (body, share) = report.least_tracked;
    if let Some(asserted) = args.judge.assert_tracking.filter(|asserted| share < *asserted) {
        warn(&untracked(body, share, asserted));
        return UNTRACKED;
    }
    let warned = warned(&report.warnings).or_else(|| shortage.map(unjudged));
    if let Some(warned) = warned.filter(|_| args.judge.assert_no_warnings) {
        warn(&warned);
        return WARNED;
    }
    if args.judge.assert_budgets { verdict_of_budgets(report, view).unwrap_or(code) } else { code }
}

/// [`LOSS`] if something was lost, else 0.
fn verdict_of_losses(report: &Report, args: &RunArgs) -> u8 {
    let mut code = 0;
    let lost = report.recording.as_ref().map_or(0, |recording| recording.lost + report.overwritten);
    if lost > 0 {
        warn(&format!("the recording lacks {lost} blocks; notes in it mark the gaps"));
        code = LOSS;
    }
    if report.states_lost > 0 {
        warn(&format!("the state of the eye was lost {} times", report.states_lost));
        code = LOSS;
    }
    for silence in &report.silences {
        let to_s = silence.to_s.unwrap_or(report.duration_s);
        warn(&format!("from {:.1} to {to_s:.1} s {}", silence.from_s, silence.finding.what));
        code = LOSS;
    }
    if let Some((text, is_loss)) =
        missing_singly(report, args.virtual_rig.faults.is_some() || args.virtual_rig.blobs.is_some())
    {
        warn(&text);
        code = if is_loss { LOSS } else { code };
    }
    code
}

/// [`BUDGET`] if a latency budget was exceeded, [`FAILED`] if a stage with a budget was not measured, `None`
/// otherwise.
fn verdict_of_budgets(report: &Report, view: View) -> Option<u8> {
    let broken: Vec<_> = report.stages.iter().filter(|s| s.broken).collect();
    broken.iter().for_each(|stage| warn(&stage.blame()));
    if !broken.is_empty() {
        return Some(BUDGET);
    }
    let drawn = |s: Stage| !matches!(s, Stage::Rendering | Stage::WholeSystem) || view != View::None;
    let unmeasured = report.stages.iter().filter(|s| s.count == 0 && s.budget_ms > 0.0 && drawn(s.stage));
    let unmeasured: Vec<&str> = unmeasured.map(|s| s.stage.name()).collect();
    if unmeasured.is_empty() {
        return None;
    }
    warn(&format!("no measurements of {}; the first second of a run does not count", unmeasured.join(", ")));
    Some(FAILED)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_that_are_missing_singly_are_told_and_cost_the_exit_code() {
        let mut report = report::tests::report();
        report.restarts.clear();
        report.tracking.frames_due = 3_000;
        assert_eq!(missing_singly(&report, false), None);
        report.frames_withheld = 26;
        let told = |report: &Report| missing_singly(report, false);
        let (text, is_loss) = told(&report).unwrap();
        assert!(is_loss && text.starts_with("26 of 3000 frames are missing"), "{text}");
        assert_eq!(missing_singly(&report, true), None, "the stream has gaps");
        report.overwritten = 10;
        assert!(matches!(told(&report), Some((text, false)) if text.starts_with("16 of")));
        report.restarts.insert("tracker", 1);
        assert_eq!(told(&report), None, "the restart was told");
    }
}
