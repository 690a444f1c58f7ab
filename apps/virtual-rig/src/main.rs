//! `vitreo-virtual-rig`: scripted surgeon, eye and cameras as a process.

use clap::Parser;
use protocol::health::Process;
use std::process::ExitCode;
use virtual_rig::faults::spec::UnknownPreset;

/// Exit code of wrong use, as clap has it.
const WRONG_USE: u8 = 2;

fn main() -> ExitCode {
    let config = virtual_rig::config::Config::parse();
    ipc::logging::init(Process::VirtualRig.name(), &config.shell.log);
    match virtual_rig::process::run(&config) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let failed = ipc::logging::fail(error.as_ref());
            if error.is::<UnknownPreset>() { ExitCode::from(WRONG_USE) } else { failed }
        }
    }
}
