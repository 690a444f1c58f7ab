//! `vitreo`: the one command a person types.

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli = launcher::cli::Cli::parse();
    ipc::logging::init("launcher", &cli.log);
    match launcher::cli::dispatch(&cli) {
        Ok(code) => code,
        Err(error) => ipc::logging::fail(error.as_ref()),
    }
}
