//! `vitreo config`: values and sources of all options, and a template file.
//!
//! The camera's, the calibration's and the renderer's programs have commands of their own and are
//! asked what these take.

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

/// An option that has a value.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Setting {
    /// The table, empty at the top.
    table: String,
    key: String,
    /// As TOML writes it.
    value: String,
    from: Origin,
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<String>,
    /// From 1 on.
    #[serde(skip_serializing_if = "Option::is_none")]
    line: Option<usize>,
    /// The environment's variable.
    #[serde(skip_serializing_if = "Option::is_none")]
    variable: Option<&'static str>,
}

/// Where a value comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Origin {
    /// Built in.
    Default,
    /// A line of a file.
    File,
    /// A variable of the environment.
    Environment,
}

/// Runs it; `line` is this program's command line.
///
/// # Errors
/// Where a file is refused, another program does not answer, or the new file cannot be written.
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

/// The options of this program and of those that have commands of their own.
fn every_option(line: Command) -> anyhow::Result<Vec<SettableOption>> {
    let mut all = options(line, &SETTINGS);
    for binary in WITH_SETTINGS {
        let answer = command(binary)?.arg(ASK).output().with_context(|| format!("start {binary}"))?;
        let text = String::from_utf8_lossy(&answer.stdout);
        let own = from_json(&text).with_context(|| format!("{binary} {ASK}: expected its options"))?;
        // Those of all commands are the same in every program.
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
        println!("# {}: {}", path.display(), if path.exists() { "read" } else { "not there" });
    }
    print!("{}", table(&settings));
    Ok(())
}

/// Keys of tables that other programs read; they judge the values when they run.
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

/// Every option that has a value: of the environment, of a file, built in.
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
            // The variable silences what says the same in files.
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
    // Options of all commands may stand in the table of one.
    let inner = entries
        .iter()
        .filter(|e| !e.table.is_empty() && options.iter().any(|o| o.table.is_empty() && o.key == e.key));
    let mut all: Vec<Setting> =
        own.chain(inner.filter_map(|e| of(&e.table.join("."), &e.key, None))).collect();
    let place = |table: &str| options.iter().position(|o| o.table == table);
    all.sort_by_key(|s| place(&s.table));
    all
}

/// As a file of settings, with where each value comes from behind it.
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

/// A file that sets nothing and names everything.
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
