//! `vitreo-cameras`: pictures from pipes and files in, fields of pixels out.

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let config = cameras::config::Config::parse();
    ipc::logging::init("cameras", &config.shell.log);
    match cameras::process::run(&config) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => ipc::logging::fail(error.as_ref()),
    }
}
