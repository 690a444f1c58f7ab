//! `vitreo-calibration`: a rig's lenses, camera poses, markers and trocars; `vitreo calibrate`.

use calibration::cli::{self, CalibrateArgs};
use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let args = CalibrateArgs::parse();
    ipc::logging::init("calibration", &args.log);
    cli::run(&args).unwrap_or_else(|error| ipc::logging::fail(error.as_ref()))
}
