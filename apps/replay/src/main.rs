//! `vitreo-replay`: the commands on recordings, in one process and without a clock.

use outputs::exit::INTERRUPTED;
use outputs::exit_code;
use settings::commands::RecordingCommand;
use settings::{Program, SettingsArgs};
use std::process::ExitCode;

/// What vitreo.toml says to this program: to the command that people type, under its own name.
const SETTINGS: Program = Program { prefix: "", without: &[], elsewhere: None };

/// Replay and analyse recordings, in one process and independent of the clock.
#[derive(Debug, clap::Parser)]
#[command(name = "vitreo", version)]
struct Args {
    #[command(flatten)]
    settings: SettingsArgs,
    #[command(flatten)]
    log: ipc::logging::LogArgs,
    #[command(subcommand)]
    command: RecordingCommand,
}

fn main() -> ExitCode {
    let args: Args = match settings::parse(&SETTINGS) {
        Ok(args) => args,
        Err((problem, log)) => return ipc::logging::wrong_use("replay", &log, &problem),
    };
    ipc::logging::init("replay", &args.log);
    if let Err(problem) = ipc::signals::end_by_default(INTERRUPTED) {
        ipc::logging::warn(&format!("signals: {problem}"));
    }
    let fail = |error: &anyhow::Error| {
        ipc::logging::fail(error.as_ref());
        ExitCode::from(replay::exit::code_of(error))
    };
    exit_code(run(&args.command), fail, ipc::logging::warn)
}

fn run(command: &RecordingCommand) -> anyhow::Result<ExitCode> {
    match command {
        RecordingCommand::Replay(args) => replay::command::run(args),
        RecordingCommand::Import(args) => replay::import::run(args),
        RecordingCommand::Export(args) => replay::export::run(args),
        RecordingCommand::Cut(args) => replay::cut::run(args),
        RecordingCommand::Merge(args) => replay::merge::run(args),
        RecordingCommand::Recover(args) => replay::recover::run(args),
        RecordingCommand::Info(args) => replay::info::run(args),
        RecordingCommand::Check(args) => replay::check::run(args),
        RecordingCommand::Trace(args) => replay::trace::run(args),
        RecordingCommand::Residuals(args) => replay::residuals::run(args),
        RecordingCommand::Inspect(args) => replay::inspect::run(args),
        RecordingCommand::Diff(args) => replay::diff::run(args),
        RecordingCommand::Settings(args) => replay::what_if::keys::run(args),
        RecordingCommand::Sweep(args) => replay::sweep::run(args),
        RecordingCommand::Film(args) => replay::film::run(args),
        RecordingCommand::Score(args) => replay::score::run(args),
        RecordingCommand::Suite(args) => replay::suite::run(args),
        RecordingCommand::Results(args) => replay::results::run(args),
    }
}
