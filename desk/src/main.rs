//! `vitreo-desk`: inputs of a person in, poses, handles and pedal out.

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    match desk::process::run(&desk::config::Config::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vitreo-desk: {}", ipc::shell::told(error.as_ref()));
            ExitCode::FAILURE
        }
    }
}
