//! `vitreo-desk`: inputs of a person in, poses, handles and pedal out.

use clap::Parser;
use protocol::health::Process;
use std::process::ExitCode;

fn main() -> ExitCode {
    let config = desk::config::Config::parse();
    ipc::logging::init(Process::Desk.name(), &config.shell.log);
    match desk::process::run(&config) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => ipc::logging::fail(error.as_ref()),
    }
}
