//! `vitreo-bridge`: poses of a running simulator for other programs, `vitreo bridge`; and poses of another tracker, as
//! a process of `vitreo run --poses`.

use ipc::shell::ShellArgs;
use settings::commands::bridge::{BridgeCommand, Server};
use settings::{Program, SettingsArgs};
use std::path::PathBuf;
use std::process::ExitCode;

/// What vitreo.toml says to this program: to the command that people type, under its own name.
const SETTINGS: Program = Program { prefix: "", without: &[], elsewhere: None };

/// Exchange poses with other programs.
#[derive(Debug, clap::Parser)]
#[command(name = "vitreo", version)]
#[command(subcommand_negates_reqs = true)]
struct Args {
    /// Sub-command, instead of running as a process.
    #[command(subcommand)]
    command: Option<BridgeCommand>,
    #[command(flatten)]
    shell: ShellArgs,
    #[command(flatten)]
    settings: SettingsArgs,
    /// The other tracker's server.
    #[arg(long, value_name = "igtl:HOST:PORT", hide = true, required = true)]
    from: Option<Server>,
    /// File that maps its transforms to bodies.
    #[arg(long, value_name = "MAP.toml", hide = true)]
    map: Option<PathBuf>,
}

fn main() -> ExitCode {
    let args: Args = match settings::parse(&SETTINGS) {
        Ok(args) => args,
        Err((problem, log)) => return ipc::logging::wrong_use("bridge", &log, &problem),
    };
    ipc::logging::init("bridge", &args.shell.log);
    let done = match (&args.command, &args.from) {
        (Some(BridgeCommand::Bridge(command)), _) => bridge::run::run(command),
        (None, Some(from)) => bridge::run::within(&args.shell, from, args.map.as_deref()),
        // clap asks for one of them.
        (None, None) => unreachable!("neither a command nor a server"),
    };
    let fail = |error: &anyhow::Error| ipc::logging::fail(error.as_ref());
    outputs::exit_code(done, fail, ipc::logging::warn)
}
