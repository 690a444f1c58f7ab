//! `vitreo-fpga-model`: the virtual camera hardware as a process, and its sub-commands.

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    let config = fpga_model::config::Config::parse();
    let done = match &config.command {
        Some(command) => fpga_model::commands::run(command),
        None => fpga_model::process::run(&config),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // The launcher starts sub-commands under its own name.
            let called = std::env::args_os().next().map(std::path::PathBuf::from);
            let name = called.as_deref().and_then(std::path::Path::file_name).unwrap_or_default();
            eprintln!("{}: {}", name.display(), ipc::shell::told(error.as_ref()));
            ExitCode::FAILURE
        }
    }
}
