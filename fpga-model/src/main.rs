//! `vitreo-fpga-model`: the virtual camera hardware as a process.

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    let config = fpga_model::config::Config::parse();
    match fpga_model::process::run(&config) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vitreo-fpga-model: {}", protocol::shell::told(error.as_ref()));
            ExitCode::FAILURE
        }
    }
}
