//! Lists all options that files can set, with default, example and help.

use crate::Program;
use crate::apply::settable;
use crate::toml_file::quoted;
use clap::{Arg, ArgAction, Command};
use serde::{Deserialize, Serialize};

/// Sole argument that makes a program print its [`options`] as JSON.
pub const ASK: &str = "--describe-settings";

/// An option that a file can set.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SettableOption {
    /// The table, for instance `results.delete`; empty at the top of the file.
    pub table: String,
    /// Summary of the table's command.
    pub about: String,
    /// The key.
    pub key: String,
    /// Help text of the option.
    pub help: String,
    /// The default as TOML, if there is one.
    pub default: Option<String>,
    /// A valid or typical value as TOML.
    pub example: String,
    /// True for options that are hidden from help.
    pub hidden: bool,
}

/// All options of a program that files can set.
pub fn options(mut command: Command, program: &Program) -> Vec<SettableOption> {
    command.build();
    let mut all = Vec::new();
    let top = |arg: &&Arg| arg.is_global_set();
    all.extend(settable(&command).filter(top).map(|arg| option("", "every command", arg)));
    if program.prefix.is_empty() {
        let own = command.get_subcommands().filter(|c| !program.is_other(c.get_name()));
        own.for_each(|below| add(below, below.get_name(), &mut all));
    } else {
        add(&command, program.prefix, &mut all);
    }
    all
}

impl Program {
    /// True if a sub-command has no settings in this program.
    fn is_other(&self, name: &str) -> bool {
        let elsewhere = self.elsewhere.is_some_and(|tables| tables.contains(&name));
        name == "help" || elsewhere || self.without.contains(&name)
    }
}

fn add(command: &Command, table: &str, to: &mut Vec<SettableOption>) {
    let about = command.get_about().map(ToString::to_string).unwrap_or_default();
    let own = settable(command).filter(|arg| !arg.is_global_set());
    to.extend(own.map(|arg| option(table, &about, arg)));
    for below in command.get_subcommands().filter(|c| c.get_name() != "help") {
        add(below, &format!("{table}.{}", below.get_name()), to);
    }
}

fn option(table: &str, about: &str, arg: &Arg) -> SettableOption {
    let default = match (arg.get_action(), arg.get_default_values()) {
        (ArgAction::SetTrue, _) => Some("false".to_owned()),
        (ArgAction::Count, _) => Some("0".to_owned()),
        (_, [value]) => Some(quoted(&value.to_string_lossy())),
        _ => None,
    };
    let name = arg.get_value_names().and_then(|names| names.first()).map(ToString::to_string);
    let first = arg.get_possible_values().first().map(|v| v.get_name().to_owned());
    let text = toml::Value::from(first.or(name).unwrap_or_default()).to_string();
    let several = matches!(arg.get_action(), ArgAction::Append);
    let example = if several { format!("[{text}]") } else { text };
    SettableOption {
        table: table.to_owned(),
        about: about.to_owned(),
        key: arg.get_long().unwrap_or_default().to_owned(),
        help: arg.get_help().map(ToString::to_string).unwrap_or_default(),
        example: default.clone().unwrap_or(example),
        default,
        hidden: arg.is_hide_set(),
    }
}

/// Serialises the options for another program of this build.
pub fn to_json(options: &[SettableOption]) -> String {
    // Texts and booleans only, which JSON can always represent.
    serde_json::to_string(options).unwrap_or_default()
}

/// Parses the output of [`to_json`] of another program of this build.
///
/// # Errors
/// If the text is not such a list.
pub fn from_json(text: &str) -> Result<Vec<SettableOption>, serde_json::Error> {
    serde_json::from_str(text)
}
