//! `vitreo-tracker`: marker blobs in, poses out.

use clap::Parser;
use protocol::health::Process;
use std::process::ExitCode;
use tracker::config::Config;

fn main() -> ExitCode {
    let config = Config::parse();
    ipc::logging::init(Process::Tracker.name(), &config.shell.log);
    match tracker::process::run(&config) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => ipc::logging::fail(error.as_ref()),
    }
}
