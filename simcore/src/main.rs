//! `vitreo-simcore`: the simulation as a process of its own.

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    match simcore::process::run(&simcore::config::Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vitreo-simcore: {}", ipc::shell::told(error.as_ref()));
            ExitCode::FAILURE
        }
    }
}
