//! Sub-commands that belong to another crate: its binary takes over.

use crate::children::find_binary;
use anyhow::Context;
use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::process::Command;

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
pub fn to(binary: &str, sub_command: &str, args: &ForwardArgs) -> anyhow::Result<std::process::ExitCode> {
    let path = find_binary(binary)?;
    // Usage lines then say `vitreo blobs`, which is what was typed.
    let error = Command::new(&path).arg0("vitreo").arg(sub_command).args(&args.rest).exec();
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
