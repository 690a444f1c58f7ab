//! `vitreo config`: shows the values and sources of all options, and writes a template file.
//!
//! Programs with commands of their own (such as the camera's, the calibration's and the renderer's) are
//! started to list their options.

use crate::programs::{SETTINGS, WITH_SETTINGS};
use anyhow::Context;
use clap::Command;
use ipc::logging::inform;
use ipc::programs::command;
use outputs::printable;
use outputs::{Force, Outputs, print, println};
use serde::Serialize;
use settings::check::check;
use settings::describe::{ASK, SettableOption, from_json, options};
use settings::files::Files;
use settings::toml_file::{Entry, winners};
use settings::{LOG_VARIABLE, LOGGING};
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

/// Arguments of `vitreo config`.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct ConfigArgs {
    #[command(subcommand)]
    what: Option<What>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Write a settings file with every option in a comment.
    Init {
        /// File to write; - is standard output [default: the user's settings file].
        file: Option<PathBuf>,
        #[command(flatten)]
        force: Force,
    },
    /// Print the paths of settings files; later files take precedence.
    Path,
}

/// An option with its value.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Setting {
    /// The table; empty for the top of the file.
    table: String,
    key: String,
    /// The value as TOML.
    value: String,
    from: Origin,
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<String>,
    /// Line in the file, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    line: Option<usize>,
    /// Name of the environment variable.
    #[serde(skip_serializing_if = "Option::is_none")]
    variable: Option<&'static str>,
}

/// Source of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Origin {
    /// The program's default.
    Default,
    /// A line of a settings file.
    File,
    /// An environment variable.
    Environment,
}

/// Runs `vitreo config`; `line` is the command line of this program.
///
/// # Errors
/// If a settings file is invalid, another program does not list its options, or the template cannot be
/// written.
pub fn run(args: &ConfigArgs, line: Command) -> anyhow::Result<ExitCode> {
    let files = Files::of_this_machine();
    match &args.what {
        Some(What::Path) => files.paths.iter().for_each(|path| println!("{}", path.display())),
        Some(What::Init { file, force }) => {
            let own = file.clone().or_else(|| files.of_user().map(Into::into));
            let path = own.context("no path for the settings file: give FILE or set HOME")?;
            Outputs::new(force.force).write(&path, template(&every_option(line)?))?;
            if path.as_os_str() != outputs::STDOUT {
                inform(&format!("{}: remove the # from a line to set it", path.display()));
            }
        }
        None => show(args.json, line, &files)?,
    }
    Ok(ExitCode::SUCCESS)
}

/// The options of this program and of all programs in [`WITH_SETTINGS`].
fn every_option(line: Command) -> anyhow::Result<Vec<SettableOption>> {
    let mut all = options(line, &SETTINGS);
    for binary in WITH_SETTINGS {
        let answer = command(binary)?.arg(ASK).output().with_context(|| format!("start {binary}"))?;
        let text = String::from_utf8_lossy(&answer.stdout);
        let own = from_json(&text).with_context(|| format!("{binary} {ASK}: expected its options"))?;
        // Options of all commands are the same in every program.
        all.extend(own.into_iter().filter(|option| !option.table.is_empty()));
    }
    Ok(all)
}

fn show(json: bool, mut line: Command, files: &Files) -> anyhow::Result<()> {
    let (options, entries) = (every_option(line.clone())?, files.entries()?);
    line.build();
    check(&line, &SETTINGS, &entries)?;
    check_elsewhere(&options, &entries)?;
    let variable = std::env::var(LOG_VARIABLE).ok().filter(|_| files.log_variable);
    let settings = values(&options, &winners(entries), variable.as_deref());
    if json {
        println!("{}", serde_json::to_string_pretty(&settings)?);
        return Ok(());
    }
    for path in &files.paths {
        println!("# {}: {}", path.display(), if path.exists() { "read" } else { "not found" });
    }
    print!("{}", table(&settings));
    Ok(())
}

/// Checks the keys in tables of other programs. Their values are checked by those programs when they run.
fn check_elsewhere(options: &[SettableOption], entries: &[Entry]) -> anyhow::Result<()> {
    let tables = SETTINGS.elsewhere.unwrap_or_default();
    for entry in entries {
        let theirs = entry.table.first().is_some_and(|t| tables.contains(&t.as_str()));
        let known = options.iter().any(|o| o.table == entry.table.join(".") && o.key == entry.key);
        let global = options.iter().any(|o| o.table.is_empty() && o.key == entry.key);
        if theirs && !known && !global {
            let expected = format!("expected an option that vitreo {} takes", entry.table.join(" "));
            return Err(entry.problem(expected).into());
        }
    }
    Ok(())
}

/// All options that have a value, with its source: environment, file or default.
fn values(options: &[SettableOption], entries: &[Entry], log: Option<&str>) -> Vec<Setting> {
    let of = |table: &str, key: &str, default: Option<&String>| {
        let entry = entries.iter().find(|e| e.table.join(".") == table && e.key == key);
        let logs = LOGGING.contains(&key);
        let blank = Setting {
            table: table.to_owned(),
            key: key.to_owned(),
            value: default.cloned().unwrap_or_default(),
            from: Origin::Default,
            file: None,
            line: None,
            variable: None,
        };
        match (entry, log) {
            (_, Some(filter)) if key == LOGGING[0] => Some(Setting {
                value: settings::toml_file::quoted(filter),
                from: Origin::Environment,
                variable: Some(LOG_VARIABLE),
                ..blank
            }),
            // The environment variable overrides all logging options in files.
            (Some(entry), log) if !(logs && log.is_some()) => Some(Setting {
                value: entry.value.to_string(),
                from: Origin::File,
                file: Some(entry.file.clone()),
                line: Some(entry.line),
                ..blank
            }),
            _ => default.map(|_| blank),
        }
    };
    let shown = options
        .iter()
        .filter(|o| !o.hidden || entries.iter().any(|e| e.table.join(".") == o.table && e.key == o.key));
    let own = shown.filter_map(|o| of(&o.table, &o.key, o.default.as_ref()));
    // Options of all commands may also be in the table of one command.
    let inner = entries
        .iter()
        .filter(|e| !e.table.is_empty() && options.iter().any(|o| o.table.is_empty() && o.key == e.key));
    let mut all: Vec<Setting> =
        own.chain(inner.filter_map(|e| of(&e.table.join("."), &e.key, None))).collect();
    let place = |table: &str| options.iter().position(|o| o.table == table);
    all.sort_by_key(|s| place(&s.table));
    all
}

/// Formats the options as a settings file, with the source of each value in a comment.
fn table(settings: &[Setting]) -> String {
    let mut text = String::new();
    let mut last = "";
    for setting in settings {
        if setting.table != last {
            let _ = writeln!(text, "\n[{}]", setting.table);
            last = &setting.table;
        }
        let from = match (&setting.file, setting.line, setting.variable) {
            (Some(file), Some(line), _) => format!("{file}, line {line}"),
            (_, _, Some(variable)) => variable.to_owned(),
            _ => "default".to_owned(),
        };
        let set = format!("{} = {}", setting.key, setting.value);
        let _ = writeln!(text, "{:<40} # {}", printable(&set), printable(&from));
    }
    text
}

/// A settings file that contains every option in a comment.
fn template(options: &[SettableOption]) -> String {
    let mut text =
        "# Defaults of vitreo's options. Remove the # from a line to set it. Options on a command line take\n\
                    # precedence over this file, see docs/configuration.md. vitreo config shows the values in effect.\n"
            .to_owned();
    let mut last = None;
    for option in options.iter().filter(|o| !o.hidden) {
        if last != Some(&option.table) {
            let _ = match option.table.is_empty() {
                true => writeln!(text, "\n# Every command."),
                false => writeln!(text, "\n# {}\n[{}]", option.about, option.table),
            };
            last = Some(&option.table);
        }
        let help = option.help.replace('\n', "\n# ");
        let _ = writeln!(text, "# {help}\n#{} = {}", option.key, option.example);
    }
    text
}

#[cfg(test)]
mod tests;
