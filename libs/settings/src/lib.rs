//! Option defaults from `vitreo.toml`: one table per command, long option names as keys. The files are read
//! in the order of [`files::Files`]; later files take precedence over earlier ones, and the command line over
//! all files. A setting becomes an argument before the typed ones ([`apply`]), so clap parses and validates
//! it like a typed argument. Files are validated first ([`check`]); errors name file, line, key and the
//! expected value. A program behind a command of `vitreo` reads the same files and uses only its own tables:
//! `vitreo-fpga-model` those under `blobs`, among others. Programs that a run starts get all settings on
//! their command lines and read no file.

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
    /// The table that contains the tables of this program's sub-commands; empty if those are at the top
    /// level.
    pub prefix: &'static str,
    /// Sub-commands that read no file.
    pub without: &'static [&'static str],
    /// Tables that belong to other programs; `None` if unknown tables are accepted.
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
/// Options that are accepted only on the command line: those that replace the command's work (help, version),
/// and those that overwrite or delete files, which a file in some folder must not cause.
const ONLY_TYPED: [&str; 5] = ["help", "version", NO_CONFIG, "force", "recordings"];
/// Options that set the log level. If one of them is typed, or the variable [`LOG_VARIABLE`] is set, all of
/// them are ignored in files.
pub const LOGGING: [&str; 3] = ["log", "verbose", "quiet"];
/// Environment variable that overrides the options of [`LOGGING`] in files.
pub const LOG_VARIABLE: &str = "RUST_LOG";

/// Environment variable set for a program that replaces another one of this build (`exec`), which has already
/// reported ignored files.
pub const ALREADY_REPORTED: &str = "VITREO_SETTINGS_TOLD";

/// An error in a settings file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {}{text}", line.map(|l| format!("line {l}: ")).unwrap_or_default())]
pub struct Problem {
    /// The file.
    pub file: String,
    /// The line, from 1; `None` if the error concerns the whole file.
    pub line: Option<usize>,
    /// Table, key and expected value.
    pub text: String,
}

/// Why a program does not start.
#[derive(Debug)]
pub enum Refusal {
    /// clap's error, or the text of help or version.
    CommandLine(clap::Error),
    /// An error in a settings file, with the typed arguments as far as clap understands them.
    File(Problem, Box<ArgMatches>),
}

/// Parses the command line of this program together with its settings. As clap does, it exits the process if
/// the command line is invalid or asks for help.
///
/// # Errors
/// The error in a settings file, with the typed arguments `L` as far as clap understands them, so that the
/// caller can report the error as the typed logging options ask.
pub fn parse<P: Parser, L: FromArgMatches + Default>(program: &Program) -> Result<P, (Problem, L)> {
    let words: Vec<OsString> = std::env::args_os().collect();
    if words.get(1).is_some_and(|w| w == describe::ASK) {
        outputs::println!("{}", describe::to_json(&describe::options(P::command(), program)));
        std::process::exit(0);
    }
    let found = files::Files::of_this_machine();
    let without = words.iter().any(|w| w.to_str() == Some(&format!("--{NO_CONFIG}")));
    let already_reported = std::env::var_os(ALREADY_REPORTED).is_some();
    if let Some(reason) = found.passed_over.as_ref().filter(|_| !without && !already_reported) {
        // Logging is not yet set up. A closed standard error is no reason to fail.
        let _ = writeln!(std::io::stderr(), "vitreo: {reason}");
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
