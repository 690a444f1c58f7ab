//! `vitreo-controls`: a pedal and handles in, their channels out; and its sub-commands.

use controls::config::{Config, SETTINGS};
use protocol::health::Process;
use std::process::ExitCode;

fn main() -> ExitCode {
    let config: Config = match settings::parse(&SETTINGS) {
        Ok(config) => config,
        Err((problem, log)) => return ipc::logging::wrong_use(Process::Controls.name(), &log, &problem),
    };
    ipc::logging::init(Process::Controls.name(), &config.shell.log);
    let done = match &config.command {
        Some(command) => controls::commands::run(command),
        None => controls::process::run(&config),
    };
    let done = done.map(|()| ExitCode::SUCCESS);
    outputs::exit_code(done, |error| ipc::logging::fail(error.as_ref()), ipc::logging::warn)
}
