//! `vitreo-fpga-model`: the twin of the camera hardware as a process, and its sub-commands.

use clap::Parser;
use protocol::health::Process;
use std::process::ExitCode;

fn main() -> ExitCode {
    let config = fpga_model::config::Config::parse();
    ipc::logging::init(Process::FpgaModel.name(), &config.shell.log);
    let done = match &config.command {
        Some(command) => fpga_model::commands::run(command),
        None => fpga_model::process::run(&config),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => ipc::logging::fail(error.as_ref()),
    }
}
