//! `vitreo-fpga-model`: the virtual camera hardware as a process.

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    let config = fpga_model::config::Config::parse();
    match fpga_model::process::run(&config) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vitreo-fpga-model: {}", told(&error));
            ExitCode::FAILURE
        }
    }
}

/// The error with its causes; a cause that the text before it tells already is passed over.
fn told(error: &anyhow::Error) -> String {
    let mut text = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    text
}
