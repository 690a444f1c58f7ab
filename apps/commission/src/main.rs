//! `vitreo-commission`: takes a new rig into use; `vitreo commission`.

use commission::cli::{self, CommissionArgs, SETTINGS};
use std::process::ExitCode;

fn main() -> ExitCode {
    let args: CommissionArgs = match settings::parse(&SETTINGS) {
        Ok(args) => args,
        Err((problem, log)) => return ipc::logging::wrong_use("commission", &log, &problem),
    };
    ipc::logging::init("commission", &args.log);
    outputs::exit_code(cli::run(&args), |error| ipc::logging::fail(error.as_ref()), ipc::logging::warn)
}
