//! `vitreo-bridge`: poses of a running simulator for other programs; `vitreo bridge`.

use settings::commands::bridge::BridgeCommand;
use settings::{Program, SettingsArgs};
use std::process::ExitCode;

/// What vitreo.toml says to this program: to the command that people type, under its own name.
const SETTINGS: Program = Program { prefix: "", without: &[], elsewhere: None };

/// Poses for other programs.
#[derive(Debug, clap::Parser)]
#[command(name = "vitreo", version)]
struct Args {
    #[command(flatten)]
    log: ipc::logging::LogArgs,
    #[command(flatten)]
    settings: SettingsArgs,
    #[command(subcommand)]
    command: BridgeCommand,
}

fn main() -> ExitCode {
    let args: Args = match settings::parse(&SETTINGS) {
        Ok(args) => args,
        Err((problem, log)) => return ipc::logging::wrong_use("bridge", &log, &problem),
    };
    ipc::logging::init("bridge", &args.log);
    let BridgeCommand::Bridge(bridge) = &args.command;
    let fail = |error: &anyhow::Error| ipc::logging::fail(error.as_ref());
    outputs::exit_code(bridge::run::run(bridge), fail, ipc::logging::warn)
}
