//! `vitreo-tracker`: marker blobs in, poses out; and the calibration of what they were seen with.

use clap::Parser;
use std::process::ExitCode;
use tracker::config::{Command, Config};

fn main() -> ExitCode {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    let config = Config::parse();
    let done = match &config.command {
        Some(Command::Calibrate(args)) => tracker::calibrate::cli::run(args),
        None => tracker::process::run(&config).map(|()| ExitCode::SUCCESS),
    };
    done.unwrap_or_else(|error: anyhow::Error| {
        // The launcher starts sub-commands under its own name.
        let called = std::env::args_os().next().map(std::path::PathBuf::from);
        let name = called.as_deref().and_then(std::path::Path::file_name).unwrap_or_default();
        eprintln!("{}: {}", name.display(), ipc::shell::told(error.as_ref()));
        ExitCode::FAILURE
    })
}
