//! `vitreo-calibration`: a rig's lenses, camera poses, markers and trocars; `vitreo calibrate`.

use calibration::cli::{self, CalibrateArgs, SETTINGS};
use std::process::ExitCode;

fn main() -> ExitCode {
    let args: CalibrateArgs = match settings::parse(&SETTINGS) {
        Ok(args) => args,
        Err((problem, log)) => return ipc::logging::wrong_use("calibration", &log, &problem),
    };
    ipc::logging::init("calibration", &args.log);
    outputs::exit_code(cli::run(&args), |error| ipc::logging::fail(error.as_ref()), ipc::logging::warn)
}
