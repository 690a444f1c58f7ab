//! `vitreo`: the command-line program.

use launcher::cli::Cli;
use launcher::programs::SETTINGS;
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli: Cli = match settings::parse(&SETTINGS) {
        Ok(cli) => cli,
        Err((problem, log)) => return ipc::logging::wrong_use("launcher", &log, &problem),
    };
    ipc::logging::init("launcher", &cli.log);
    let fail = |error: &anyhow::Error| {
        ipc::logging::fail(error.as_ref());
        ExitCode::from(launcher::exit::code_of(error))
    };
    outputs::exit_code(launcher::cli::dispatch(&cli), fail, ipc::logging::warn)
}
