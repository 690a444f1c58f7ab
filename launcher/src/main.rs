//! `vitreo`: the one command a person types.

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    let cli = launcher::cli::Cli::parse();
    match launcher::cli::dispatch(&cli) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("vitreo: {}", ipc::shell::told(error.as_ref()));
            ExitCode::from(launcher::exit::FAILED)
        }
    }
}
