//! `vitreo certify`: measures the latency from the last blobs of a triple to a subscriber's poses, in real
//! time and under load, and writes a certificate.
//!
//! - `stream`: synthetic blobs of a rig's cameras; `feeder`, `subscriber`: the threads that send blobs and
//!   receive poses; `bench`: both threads with a tracker between them; `progress`: progress messages
//! - `load`, `floor`: load on the processors, and the machine's own wake-up latency
//! - `tally`, `slowest`: counts and statistics of the received poses; `report`, `page`: the figures, as JSON
//!   and as a page

mod bench;
mod feeder;
mod floor;
mod load;
mod page;
mod progress;
mod report;
mod slowest;
mod stream;
mod subscriber;
mod tally;

use crate::children::{REALTIME_PRIORITY, realtime_allowed};
use crate::exit::{BUDGET, INTERRUPTED, LOSS, WrongUse};
use crate::machine::allow_open_files;
use crate::memory_file::MemoryFile;
use crate::run::{LoadAccount, positive};
use crate::runtime::{StopSignal, block_on};
use anyhow::{Context, bail};
use bench::{Bench, Ending, Stream};
use floor::Wanted;
use ipc::Instance;
use ipc::clock::now;
use ipc::logging::{inform, warn};
use load::{Beside, Load};
use outputs::{Force, Outputs, print};
use report::{AtSpeed, Figures, Losses, Report, Setup, room_in_the_past};
use rig::Rig;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::SystemTime;
use stream::{ROUND_S, Triples};
use tally::TRACKING;

/// The default rig.
const RIG: &str = include_str!("../../../assets/rig-200hz.json");
/// Name of the default rig in the report.
const RIG_NAME: &str = "assets/rig-200hz.json";
/// Duration of the measurement in real time, s: by default, and with `--long`.
const SHORT_S: f64 = 120.0;
const LONG_S: f64 = 1_800.0;
/// Number of triples at full speed with `--long`.
const LONG_AT_SPEED: u64 = 1_000_000;
/// Maximum number of triples in a measurement.
const MOST: u64 = 1_000_000_000;
/// Duration of the warm-up, whose triples are not counted, s.
const WARM_UP_S: f64 = 1.0;
/// Maximum duration of one floor measurement, s. The floor is measured before and after the latency, each
/// time for a quarter of the latency's duration.
const FLOOR_S: f64 = 60.0;

/// Arguments of `vitreo certify`.
#[derive(Debug, Clone, clap::Args)]
#[command(mut_arg("force", |arg| arg.help_heading("Outputs")))]
pub struct CertifyArgs {
    /// Rig file: cameras, markers and trocars [default: the shipped 200 Hz rig].
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
    /// Duration of the measurement in real time, s [default: 120].
    #[arg(long, value_name = "S", value_parser = positive, allow_negative_numbers = true, conflicts_with_all = ["triples", "long"], help_heading = "Measurement")]
    pub duration: Option<f64>,
    /// Duration of the measurement in triples (one field of each camera) instead of seconds.
    #[arg(long, value_name = "N", value_parser = settings::commands::numbers::whole::<u64>(1, MOST), conflicts_with = "long", help_heading = "Measurement")]
    pub triples: Option<u64>,
    /// Long measurement: 30 minutes in real time, and a million triples with --at-speed.
    #[arg(long, help_heading = "Measurement")]
    pub long: bool,
    /// Then send N more triples as fast as the tracker accepts them, and count lost ones [default: 0].
    #[arg(long, value_name = "N", value_parser = settings::commands::numbers::whole::<u64>(0, MOST), help_heading = "Measurement")]
    pub at_speed: Option<u64>,
    /// Load during the measurement: all (stress-ng on every processor, or busy threads if it is not installed) or none.
    #[arg(long, value_enum, value_name = "all|none", default_value_t = Beside::All, hide_possible_values = true, help_heading = "Measurement")]
    pub load: Beside,
    /// Write the certificate as a page (.html, .md) or as figures (.json); repeat for several files.
    #[arg(long, value_name = "FILE.html|FILE.md|FILE.json", value_parser = report_file, help_heading = "Outputs")]
    pub report: Vec<PathBuf>,
    /// Exit with code 4 if p99.9 exceeds the machine's own wake-up latency by more than 0.5 ms.
    #[arg(long, help_heading = "Checks")]
    pub assert: bool,
    /// Instance name of the measurement.
    #[arg(long, value_name = "NAME", default_value = "certify")]
    pub instance: String,
    /// Overwrite existing files.
    #[command(flatten)]
    pub force: Force,
}

/// Format of a report, selected by the file extension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    Html,
    Markdown,
    Json,
}

impl Form {
    fn of(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_lowercase().as_str() {
            "html" | "htm" => Some(Form::Html),
            "md" => Some(Form::Markdown),
            "json" => Some(Form::Json),
            _ => None,
        }
    }
}

fn report_file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    Form::of(&path).map(|_| path).ok_or_else(|| "expected a name that ends in .html, .md or .json".into())
}

/// Extent of a measurement, in triples and wake-ups.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Plan {
    /// Triples before the counted ones.
    warm_up: u64,
    /// Counted triples in real time.
    count: u64,
    /// Number of triples at rest, at the start of the counted ones.
    rest: u64,
    /// Wake-ups in each of the two floor measurements.
    floor: u64,
    /// Triples at full speed.
    at_speed: u64,
}

impl Plan {
    fn of(args: &CertifyArgs, period_ns: u64) -> Self {
        let triples = |seconds: f64| ((seconds * 1e9 / period_ns as f64).round() as u64).max(1);
        let seconds = args.duration.unwrap_or(if args.long { LONG_S } else { SHORT_S });
        let count = args.triples.unwrap_or_else(|| triples(seconds).min(MOST));
        Plan {
            warm_up: triples(WARM_UP_S),
            count,
            rest: (count / 4).min(triples(ROUND_S)),
            floor: (count / 4).clamp(1, triples(FLOOR_S)),
            at_speed: args.at_speed.unwrap_or(if args.long { LONG_AT_SPEED } else { 0 }),
        }
    }
}

/// Runs `vitreo certify`.
///
/// # Errors
/// If a file is refused, the rig has fewer than two cameras, the tracker does not start or ends early, or a
/// report cannot be written.
pub fn run(args: &CertifyArgs) -> anyhow::Result<ExitCode> {
    block_on(certify(args))
}

async fn certify(args: &CertifyArgs) -> anyhow::Result<ExitCode> {
    allow_open_files()?;
    let stop = StopSignal::install()?;
    let rig = args.rig.as_deref().map_or_else(|| Rig::parse(RIG, RIG_NAME), Rig::load).context("--rig")?;
    if rig.cameras().len() < 2 {
        return Err(WrongUse("--rig: at least two cameras are needed".into()).into());
    }
    let mut outputs = args.rig.iter().fold(Outputs::new(args.force.force), |o, rig| o.reading(rig));
    args.report.iter().try_for_each(|file| outputs.claim(file))?;
    let report = match measure(args, &rig, &stop).await {
        Err(_) if stop.is_raised() => {
            warn("stopped: nothing is certified");
            return Ok(ExitCode::from(INTERRUPTED));
        }
        measured => measured?,
    };
    for file in &args.report {
        let text = match Form::of(file) {
            Some(Form::Html) => page::html(&report)?,
            Some(Form::Json) => serde_json::to_string_pretty(&report)? + "\n",
            _ => page::markdown(&report),
        };
        outputs.write(file, text).context("the report is not written")?;
    }
    print!("{}", page::markdown(&report));
    Ok(verdict(&report, args.assert))
}

async fn measure(args: &CertifyArgs, rig: &Rig, stop: &StopSignal) -> anyhow::Result<Report> {
    let plan = Plan::of(args, rig.field_period_ns());
    let began = SystemTime::now();
    let instance = Instance::own(&args.instance)?;
    let realtime = realtime_allowed();
    // The tracker must read the same rig as this command, even if the file changes meanwhile.
    let file = MemoryFile::new(&rig.to_json())?;
    let bench = Bench { instance: &instance, rig: file.name(), realtime, stop };
    let scheduling = match realtime {
        true => format!("real-time, round robin, priority {REALTIME_PRIORITY}"),
        false => "ordinary: this user may not start real-time processes (vitreo doctor)".into(),
    };
    let cpus = std::thread::available_parallelism().map_or(1, usize::from);
    let load = Load::begin(args.load, cpus);
    let seconds = |n: u64| n as f64 * rig.field_period_ns() as f64 * 1e-9;
    let before = floor(&plan, rig, realtime, stop).await?;
    inform(&format!("{} triples in real time: {:.0} s", plan.count, seconds(plan.warm_up + plan.count)));
    let triples = Triples::of(rig, plan.warm_up + plan.rest);
    let setup_of = args.rig.as_deref().map_or(RIG_NAME.into(), |file| file.display().to_string());
    let stream =
        Stream { triples: triples.clone(), warm_up: plan.warm_up, count: plan.count, at_speed: false };
    let mut others = LoadAccount::default();
    others.start();
    let live = bench.measure(stream).await?;
    let stolen_percent = others.load(0.0).map(|load| load.stolen_percent);
    anyhow::ensure!(live.read.tally.triples() > 0, "stopped");
    let after = unless_stopped(stop, floor(&plan, rig, realtime, stop)).await?;
    let fast = unless_stopped(stop, at_speed(&bench, &triples, &plan)).await?.flatten();
    let load_text = (&*load.text, stolen_percent);
    let setup = Setup::of(began, (setup_of, rig.field_hz), &triples, &scheduling, load_text);
    drop(load);
    let ended = (plan.count, stop.is_raised());
    Ok(Report::of(setup, (&live.read, &live.fed.late), (&before, after.as_ref()), fast, ended))
}

/// Awaits a measurement that follows the triples in real time; `None` if the command has been asked to stop.
async fn unless_stopped<T>(
    stop: &StopSignal,
    measured: impl Future<Output = anyhow::Result<T>>,
) -> anyhow::Result<Option<T>> {
    if stop.is_raised() {
        return Ok(None);
    }
    match measured.await {
        Err(_) if stop.is_raised() => Ok(None),
        measured => measured.map(Some),
    }
}

async fn floor(plan: &Plan, rig: &Rig, realtime: bool, stop: &StopSignal) -> anyhow::Result<floor::Floor> {
    let ending = Ending(Arc::default());
    let seconds = plan.floor as f64 * rig.field_period_ns() as f64 * 1e-9;
    inform(&format!("the machine's own wake-ups: {seconds:.0} s"));
    let wanted = Wanted { period_ns: rig.field_period_ns(), count: plan.floor, realtime };
    tokio::select! {
        floor = floor::measure(wanted, Arc::clone(&ending.0)) => floor,
        () = stop.raised() => bail!("stopped"),
    }
}

async fn at_speed(bench: &Bench<'_>, triples: &Triples, plan: &Plan) -> anyhow::Result<Option<AtSpeed>> {
    if plan.at_speed == 0 {
        return Ok(None);
    }
    let room = room_in_the_past(now(), triples.period_ns()).saturating_sub(plan.warm_up);
    let count = plan.at_speed.min(room);
    anyhow::ensure!(count > 0, "--at-speed: the machine has only just been started");
    inform(&format!("{count} triples at speed"));
    let stream = Stream { triples: triples.clone(), warm_up: plan.warm_up, count, at_speed: true };
    let fast = bench.measure(stream).await?;
    if fast.fed.given_up > 0 {
        warn(&format!("at full speed, the poses of {} triples did not arrive", fast.fed.given_up));
    }
    let rate_hz = (plan.warm_up + count) as f64 / fast.seconds;
    let tracking = Figures::of(&fast.read.tally.parts[TRACKING]);
    Ok(Some(AtSpeed { losses: Losses::of(&fast.read), asked: plan.at_speed, rate_hz, tracking }))
}

/// Prints the reasons for the exit code on standard error and returns the code.
fn verdict(report: &Report, assert: bool) -> ExitCode {
    let goal = &report.goal;
    if report.stopped {
        let sent = report.real_time.triples;
        warn(&format!("stopped: the certificate covers {sent} of {} triples in real time", report.asked));
        return ExitCode::from(INTERRUPTED);
    }
    if report.drops() > 0 {
        warn(&format!("{} triples were dropped", report.drops()));
        return ExitCode::from(LOSS);
    }
    if assert && !goal.kept {
        let (found, allowed) = (goal.found_ms, goal.above_floor_ms);
        warn(&format!("p{} is {found:.3} ms above the floor, at most {allowed} is allowed", goal.percentile));
        return ExitCode::from(BUDGET);
    }
    ExitCode::SUCCESS
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::{Cli, Command};
    use clap::Parser;

    fn args(words: &str) -> Result<CertifyArgs, clap::Error> {
        let words = ["vitreo", "certify"].into_iter().chain(words.split_whitespace());
        let Command::Certify(args) = Cli::try_parse_from(words)?.command else { panic!("another command") };
        Ok(*args)
    }

    #[test]
    fn the_short_form_is_two_minutes_and_the_long_one_half_an_hour_and_a_million() {
        let plan = |words| Plan::of(&args(words).unwrap(), 5_000_000);
        let short = Plan { warm_up: 200, count: 24_000, rest: 2_000, floor: 6_000, at_speed: 0 };
        assert_eq!(plan(""), short);
        let long = Plan { count: 360_000, floor: 12_000, at_speed: 1_000_000, ..short };
        assert_eq!(plan("--long"), long);
        assert_eq!(plan("--long --at-speed 0"), Plan { at_speed: 0, ..long });
        let few = Plan { warm_up: 200, count: 400, rest: 100, floor: 100, at_speed: 0 };
        assert_eq!((plan("--duration 2"), plan("--triples 400 --load both")), (few, few));
        for refused in ["--triples 0", "--long --duration 3", "--report a.pdf", "--load some", "--duration 0"]
        {
            assert!(args(refused).is_err(), "{refused}");
        }
    }

    #[test]
    fn a_drop_costs_the_exit_code_and_a_missed_goal_where_it_is_asserted() {
        let code = |drops, kept, assert| {
            let mut report = report::tests::report(drops);
            report.goal.kept = kept;
            verdict(&report, assert)
        };
        assert_eq!(code(0, true, true), ExitCode::SUCCESS);
        assert_eq!(code(0, false, false), ExitCode::SUCCESS);
        assert_eq!(code(0, false, true), ExitCode::from(BUDGET));
        assert_eq!(code(1, true, false), ExitCode::from(LOSS));
        let stopped = report::Report { stopped: true, ..report::tests::report(0) };
        assert_eq!(verdict(&stopped, false), ExitCode::from(INTERRUPTED));
    }
}
