//! `vitreo run`: the simulator, live.
//!
//! - `options`: the command line, and what each process is given of it
//! - `session`: the loop that hears, watches, records and shows
//! - `supervisor`, `policy`: starting, restarting, bounding restarts
//! - `tap`, `recorder`, `resume`: what is heard, written, and kept for a restarted simulation
//! - `ledger`, `report`: latencies against budgets; `monitor`, `screen`: the status

mod ledger;
mod monitor;
mod options;
mod policy;
mod recorder;
mod report;
mod resume;
mod screen;
mod session;
mod supervisor;
mod tap;

pub use options::RunArgs;

use crate::exit::{BUDGET, FAILED, LOSS};
use crate::machine::has_display;
use crate::modules::Composed;
use anyhow::Context;
use options::View;
use protocol::budget::Stage;
use protocol::recording::Provenance;
use protocol::rig::Rig;
use protocol::scene_file::{DEFAULT_SCENE, SceneFile};
use report::{Report, Versions};
use session::Session;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use std::collections::BTreeMap;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Runs it.
pub fn run(args: &RunArgs) -> anyhow::Result<ExitCode> {
    // The composed scene lasts as long as this does.
    let composed = args.module.as_deref().map(|m| Composed::new(m, args.level, &args.surgeon, args.seed));
    let composed = composed.transpose()?;
    let args = &args.with_scene_of(composed.as_ref());
    let view = args.view(has_display());
    let budgets = args.budget_table()?;
    let provenance = provenance(args)?;
    args.prepare()?;
    let stop = stop_flag()?;
    let mut session = Session::open(args, view, &budgets, &provenance, stop)?;
    let outcome = session.run();
    let live = session.live_score();
    let ended_by = match &outcome {
        Ok(why) => (*why).to_string(),
        Err(error) => format!("failure: {error:#}"),
    };
    let report = session.close(ended_by);
    if let Some(file) = &args.report {
        write_report(&report, file)?;
    }
    let ran = report.duration_s > 0.0;
    if ran {
        print!("{}", report.text());
        print!("{}", crate::score::live_text(&live));
    }
    outcome?;
    Ok(ExitCode::from(verdict(&report, args.assert_budgets, view)))
}

/// Raised by Ctrl-C, SIGTERM and SIGHUP; a second Ctrl-C ends the program at once.
pub(crate) fn stop_flag() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        let at_once = signal_hook::flag::register_conditional_shutdown(signal, 130, Arc::clone(&stop));
        at_once.and_then(|_| signal_hook::flag::register(signal, Arc::clone(&stop))).context("signals")?;
    }
    Ok(stop)
}

/// What makes the recording of this run complete; reads rig and scene, and so checks them early.
fn provenance(args: &RunArgs) -> anyhow::Result<Provenance> {
    let rig = Rig::load_or_shipped(args.rig.as_deref())?;
    let scene_name = args.scene.as_deref().unwrap_or(DEFAULT_SCENE);
    let scene = SceneFile::load(scene_name)?;
    let scene_name = args.module.as_deref().unwrap_or(scene_name);
    let file = |p: &Option<std::path::PathBuf>| p.as_ref().map(|p| p.display().to_string());
    let config = [
        ("module", args.module.as_ref().map(|m| format!("{m} level {}, {}", args.level, args.surgeon))),
        ("motion", file(&args.motion)),
        ("motion-full", args.motion_full.then(|| "true".into())),
        ("blobs", file(&args.blobs)),
        ("direct", args.direct.then(|| "true".into())),
        ("faults", args.faults.clone()),
        ("inject-delay", (!args.inject_delay.is_empty()).then(|| format!("{:?}", args.inject_delay))),
    ];
    let config = config.into_iter().filter_map(|(k, v)| Some((k.to_string(), v?)));
    let versions = Versions::of_this_build();
    let versions = [("vitreo", versions.vitreo), ("profile", versions.profile)];
    Ok(Provenance {
        rig_json: rig.to_json(),
        scene_name: scene_name.into(),
        scene_toml: scene.to_toml(),
        seeds: BTreeMap::from([("cameras".into(), args.seed.to_string())]),
        config: config.collect(),
        versions: versions.map(|(k, v)| (k.to_string(), v.to_string())).into(),
        ..Provenance::default()
    })
}

fn write_report(report: &Report, file: &Path) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(report)?;
    std::fs::write(file, text + "\n").with_context(|| format!("report {}", file.display()))
}

/// The exit code, with its reasons on standard error.
fn verdict(report: &Report, assert_budgets: bool, view: View) -> u8 {
    let mut code = 0;
    if let Some(recording) = &report.recording {
        if let Some(problem) = &recording.problem {
            eprintln!("vitreo: the recording is not complete: {problem}");
            return FAILED;
        }
        let lost = recording.lost + report.lost.values().sum::<u64>();
        if lost > 0 {
            eprintln!("vitreo: the recording misses {lost} blocks and says where");
            code = LOSS;
        }
    }
    if !assert_budgets {
        return code;
    }
    for stage in report.stages.iter().filter(|s| s.broken) {
        eprintln!("vitreo: {}", stage.blame());
        code = BUDGET;
    }
    let drawn = |s: Stage| !matches!(s, Stage::Rendering | Stage::WholeSystem) || view != View::None;
    let unmeasured = report.stages.iter().filter(|s| s.count == 0 && s.budget_ms > 0.0 && drawn(s.stage));
    let unmeasured: Vec<&str> = unmeasured.map(|s| s.stage.name()).collect();
    if code != BUDGET && !unmeasured.is_empty() {
        let names = unmeasured.join(", ");
        eprintln!("vitreo: nothing was measured of {names}; the first second of a run does not count");
        return FAILED;
    }
    code
}
