//! `vitreo-cameras`: pictures from cameras, pipes and files in, fields of pixels out; and its sub-command.

use cameras::config::{Config, SETTINGS};
use std::process::ExitCode;

fn main() -> ExitCode {
    let config: Config = match settings::parse(&SETTINGS) {
        Ok(config) => config,
        Err((problem, log)) => return ipc::logging::wrong_use("cameras", &log, &problem),
    };
    ipc::logging::init("cameras", &config.shell.log);
    let done = match &config.command {
        Some(command) => cameras::commands::run(command),
        None => cameras::process::run(&config),
    };
    let done = done.map(|()| ExitCode::SUCCESS);
    outputs::exit_code(done, |error| ipc::logging::fail(error.as_ref()), ipc::logging::warn)
}
