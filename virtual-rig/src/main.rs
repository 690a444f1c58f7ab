//! `vitreo-virtual-rig`: scripted surgeon, eye and cameras as a process.

use clap::Parser;
use protocol::health::Process;
use std::process::ExitCode;

fn main() -> ExitCode {
    let config = virtual_rig::config::Config::parse();
    ipc::logging::init(Process::VirtualRig.name(), &config.shell.log);
    match virtual_rig::process::run(&config) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => ipc::logging::fail(error.as_ref()),
    }
}
