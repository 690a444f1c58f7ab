//! Option defaults from `vitreo.toml`: one table per command, long option names as keys. The files are read
//! in the order of [`files::Files`]; later ones take precedence, and the command line over all. A setting
//! becomes an argument before the typed ones ([`apply`]), so clap parses and validates it like a typed
//! argument. Files are validated first ([`check`]); errors name file, line, key and the expected value. A
//! command of another program reads its own tables there: `vitreo blobs` reads those under `blobs`, in the
//! camera's program. Programs that a run starts get all settings on their command lines and read no file.

pub mod apply;
pub mod blob_source;
pub mod check;
pub mod commands;
pub mod describe;
pub mod files;
pub mod inputs;
pub mod toml_file;

use clap::{ArgMatches, FromArgMatches, Parser};
use std::ffi::OsString;
use std::io::Write;

/// One program's part of vitreo.toml.
#[derive(Debug, Clone, Copy)]
pub struct Program {
    /// The table in which this program's sub-commands lie; empty where they are tables themselves.
    pub prefix: &'static str,
    /// Sub-commands that read no file.
    pub without: &'static [&'static str],
    /// The tables that belong to other programs; `None` where any table may.
    pub elsewhere: Option<&'static [&'static str]>,
}

/// The option of every program that reads settings.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub struct SettingsArgs {
    /// Ignore vitreo.toml.
    #[arg(long, global = true, help_heading = "Settings")]
    pub no_config: bool,
}

impl SettingsArgs {
    /// The option as arguments of another program of this build.
    pub fn to_arguments(&self) -> Vec<String> {
        if self.no_config { vec![format!("--{NO_CONFIG}")] } else { Vec::new() }
    }
}

/// The long name of [`SettingsArgs::no_config`].
const NO_CONFIG: &str = "no-config";
/// Options that only a command line can give: those that request something other than the command's
/// work, and those that overwrite or delete files, which no file in a folder should cause.
const ONLY_TYPED: [&str; 5] = ["help", "version", NO_CONFIG, "force", "recordings"];
/// Options that say the same thing in different ways: one of them that is typed silences the others
/// in files, and so does the variable.
pub const LOGGING: [&str; 3] = ["log", "verbose", "quiet"];
/// The variable of [`LOGGING`].
pub const LOG_VARIABLE: &str = "RUST_LOG";

/// Set for a program that replaces another of this build, which has already reported ignored files.
pub const TOLD: &str = "VITREO_SETTINGS_TOLD";

/// Error in a settings file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {}{text}", line.map(|l| format!("line {l}: ")).unwrap_or_default())]
pub struct Problem {
    /// The file.
    pub file: String,
    /// The line, from 1 on; `None` where it is about the whole file.
    pub line: Option<usize>,
    /// Table, key and expected value.
    pub text: String,
}

/// Why a program cannot begin.
#[derive(Debug)]
pub enum Refusal {
    /// The command line: clap says it, or shows help.
    CommandLine(clap::Error),
    /// A file; with what was typed, as far as it is clear.
    File(Problem, Box<ArgMatches>),
}

/// Reads the command line of this program with its settings. Ends the program where the command line
/// is refused or asks for help, as clap does.
///
/// # Errors
/// Where a file of settings is refused; with the arguments `L` that were typed, as far as they are
/// clear, to say it as the user asked for.
pub fn parse<P: Parser, L: FromArgMatches + Default>(program: &Program) -> Result<P, (Problem, L)> {
    let words: Vec<OsString> = std::env::args_os().collect();
    if words.get(1).is_some_and(|w| w == describe::ASK) {
        outputs::println!("{}", describe::to_json(&describe::options(P::command(), program)));
        std::process::exit(0);
    }
    let found = files::Files::of_this_machine();
    let without = words.iter().any(|w| w.to_str() == Some(&format!("--{NO_CONFIG}")));
    let told_before = std::env::var_os(TOLD).is_some();
    if let Some(told) = found.passed_over.as_ref().filter(|_| !without && !told_before) {
        // Before logging begins; a closed standard error is no reason to fail.
        let _ = writeln!(std::io::stderr(), "vitreo: {told}");
    }
    match apply::matches(P::command(), program, &found, words).map(|mut m| P::from_arg_matches_mut(&mut m)) {
        Ok(Ok(parsed)) => Ok(parsed),
        Ok(Err(error)) => error.format(&mut P::command()).exit(),
        Err(Refusal::CommandLine(error)) => error.exit(),
        Err(Refusal::File(problem, typed)) => Err((problem, L::from_arg_matches(&typed).unwrap_or_default())),
    }
}

#[cfg(test)]
mod tests;
