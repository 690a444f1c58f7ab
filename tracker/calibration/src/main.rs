//! `vitreo-calibration`: a rig's lenses, camera poses, markers and trocars; `vitreo calibrate`.

use calibration::cli::{self, CalibrateArgs};
use clap::Parser;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run(&CalibrateArgs::parse()).unwrap_or_else(|error| {
        // The launcher starts this program under the name `vitreo calibrate`.
        let called = std::env::args_os().next().map(PathBuf::from);
        let name = called.as_deref().and_then(Path::file_name).unwrap_or_default();
        eprintln!("{}: {}", name.display(), ipc::shell::told(error.as_ref()));
        ExitCode::FAILURE
    })
}
