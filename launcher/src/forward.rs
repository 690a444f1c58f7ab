//! Sub-commands that belong to another crate: its binary takes over.

use crate::children::find_binary;
use anyhow::Context;
use std::ffi::{OsStr, OsString};
use std::os::unix::process::CommandExt;
use std::process::{Command, ExitCode};

/// What follows the sub-command, handed on as it is.
#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true, disable_version_flag = true)]
pub struct ForwardArgs {
    /// Arguments and options; `--help` lists them.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    pub rest: Vec<OsString>,
}

/// Becomes `binary SUB_COMMAND …`: its output, help and exit code are those of this command. Returns only
/// if the binary cannot be started.
pub fn to(binary: &str, sub_command: &str, args: &ForwardArgs) -> anyhow::Result<ExitCode> {
    // Usage lines then say `vitreo blobs`, which is what was typed.
    become_binary(binary, "vitreo", std::iter::once(sub_command.as_ref()).chain(rest(args)))
}

/// Becomes `binary …` under the name `called`; otherwise as [`to`].
pub fn whole(binary: &str, called: &str, args: &ForwardArgs) -> anyhow::Result<ExitCode> {
    become_binary(binary, called, rest(args))
}

fn rest(args: &ForwardArgs) -> impl Iterator<Item = &OsStr> {
    args.rest.iter().map(OsString::as_os_str)
}

fn become_binary<'a>(
    binary: &str,
    called: &str,
    args: impl Iterator<Item = &'a OsStr>,
) -> anyhow::Result<ExitCode> {
    let path = find_binary(binary)?;
    let error = Command::new(&path).arg0(called).args(args).exec();
    Err(error).with_context(|| format!("start {}", path.display()))
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
