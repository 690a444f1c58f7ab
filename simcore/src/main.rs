//! `vitreo-simcore`: the simulation as a process of its own.

use clap::Parser;
use protocol::health::Process;
use std::process::ExitCode;

fn main() -> ExitCode {
    let args = simcore::config::Args::parse();
    ipc::logging::init(Process::Simcore.name(), &args.shell.log);
    match simcore::process::run(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => ipc::logging::fail(error.as_ref()),
    }
}
