//! Sub-commands of other programs, which replace this process (`exec`).

use anyhow::Context;
use ipc::logging::arguments;
use ipc::programs::command;
use settings::{ALREADY_REPORTED, SettingsArgs};
use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::process::ExitCode;

/// Arguments after the sub-command, forwarded unchanged.
#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true, disable_version_flag = true)]
pub struct ForwardArgs {
    /// Arguments and options; `--help` lists them.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    pub rest: Vec<OsString>,
}

/// Replaces this process with `binary SUB_COMMAND …`, whose output, help and exit code become those of this
/// command. `called` is the program name that usage lines show.
///
/// # Errors
/// If the program is missing or cannot be started. On success the function does not return.
pub fn to(
    binary: &str,
    called: &str,
    sub_command: Option<&str>,
    settings: &SettingsArgs,
    args: &ForwardArgs,
) -> anyhow::Result<ExitCode> {
    let mut command = command(binary)?;
    command.arg0(called).args(sub_command).args(arguments()).args(settings.to_arguments());
    command.args(&args.rest).env(ALREADY_REPORTED, "1");
    Err(command.exec()).with_context(|| format!("start {binary}"))
}

/// Replaces this process with `binary` and the whole command line of this process. The command is declared
/// once for both programs, so this one has already checked it.
///
/// # Errors
/// If the program is missing or cannot be started. On success the function does not return.
pub fn whole(binary: &str) -> anyhow::Result<ExitCode> {
    let mut command = command(binary)?;
    command.arg0("vitreo").args(std::env::args_os().skip(1)).env(ALREADY_REPORTED, "1");
    Err(command.exec()).with_context(|| format!("start {binary}"))
}

#[cfg(test)]
mod tests {
    use crate::cli::{Cli, Command};
    use clap::Parser;

    #[test]
    fn everything_behind_the_sub_command_is_handed_on() {
        let words = ["vitreo", "blobs", "--help", "a.png", "-o", "-", "--x=1"];
        let Command::Blobs(args) = Cli::try_parse_from(words).unwrap().command else {
            panic!("not forwarded");
        };
        assert_eq!(args.rest, words[2..]);
    }
}
