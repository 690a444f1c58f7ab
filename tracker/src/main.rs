//! `vitreo-tracker`: marker blobs in, poses out.

use clap::Parser;
use std::process::ExitCode;
use tracker::config::Config;

fn main() -> ExitCode {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    match tracker::process::run(&Config::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vitreo-tracker: {}", ipc::shell::told(error.as_ref()));
            ExitCode::FAILURE
        }
    }
}
