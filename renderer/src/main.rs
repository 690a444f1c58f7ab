//! `vitreo-renderer`: the surgeon's stereo view.

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    match renderer::process::run(&renderer::config::Config::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vitreo-renderer: {}", protocol::shell::told(error.as_ref()));
            ExitCode::FAILURE
        }
    }
}
