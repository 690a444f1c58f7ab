//! `vitreo`: the one command a person types.

use launcher::cli::{Cli, SETTINGS};
use std::io;
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli: Cli = match settings::parse(&SETTINGS) {
        Ok(cli) => cli,
        Err((problem, log)) => return ipc::logging::wrong_use("launcher", &log, &problem),
    };
    ipc::logging::init("launcher", &cli.log);
    let code = match launcher::cli::dispatch(&cli) {
        Ok(code) => code,
        // Who reads the output has seen enough of it.
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            ipc::logging::fail(error.as_ref());
            ExitCode::from(launcher::exit::code_of(&error))
        }
    };
    match outputs::standard_output_failure() {
        Some(problem) if code == ExitCode::SUCCESS => {
            ipc::logging::warn(&format!("standard output: {}", outputs::plainly(&problem.into())));
            ExitCode::FAILURE
        }
        _ => code,
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    let of_io = |e: &io::Error| e.kind() == io::ErrorKind::BrokenPipe;
    error.chain().any(|cause| cause.downcast_ref().is_some_and(of_io))
}
