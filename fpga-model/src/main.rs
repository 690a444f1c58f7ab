//! `vitreo-fpga-model`: the twin of the camera hardware as a process, and its sub-commands.

use fpga_model::config::{Config, SETTINGS};
use protocol::health::Process;
use std::process::ExitCode;

fn main() -> ExitCode {
    let config: Config = match settings::parse(&SETTINGS) {
        Ok(config) => config,
        Err((problem, log)) => return ipc::logging::wrong_use(Process::FpgaModel.name(), &log, &problem),
    };
    ipc::logging::init(Process::FpgaModel.name(), &config.shell.log);
    let done = match &config.command {
        Some(command) => fpga_model::commands::run(command),
        None => fpga_model::process::run(&config),
    };
    let done = done.map(|()| ExitCode::SUCCESS);
    outputs::exit_code(done, |error| ipc::logging::fail(error.as_ref()), ipc::logging::warn)
}
