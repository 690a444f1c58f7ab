//! Turns settings of files into arguments before the typed ones, so that the typed ones take precedence.

use crate::check::{can_be_set, check, exclude_each_other, is_on, option_of, words};
use crate::files::Files;
use crate::toml_file::{Entry, winners};
use crate::{LOGGING, NO_CONFIG, Program, Refusal};
use clap::builder::ValueParser;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::parser::ValueSource;
use clap::{ArgAction, ArgMatches, Command};
use std::collections::BTreeSet;
use std::ffi::{OsStr, OsString};

/// A setting that the command line does not override.
struct Setting<'e> {
    entry: &'e Entry,
    /// Number of enclosing sub-commands; 0 for a global option.
    depth: usize,
    words: Vec<String>,
}

/// Parses a command line, program name first, together with the settings of files.
///
/// # Errors
/// [`Refusal::CommandLine`] if clap rejects the command line or prints help, [`Refusal::File`] if a settings
/// file cannot be read or is invalid.
pub fn matches(
    command: Command,
    program: &Program,
    files: &Files,
    typed: Vec<OsString>,
) -> Result<ArgMatches, Refusal> {
    let command = with_flags_turned_off(command, &typed);
    let plain = |command: Command| command.try_get_matches_from(&typed).map_err(Refusal::CommandLine);
    // What clap understands of the line alone: options that it requires may still come from files. `Err`
    // means help or version, which need no file.
    let Ok(understood) = command.clone().ignore_errors(true).try_get_matches_from(&typed) else {
        return plain(command);
    };
    if !reads_files(&understood, program) {
        return plain(command);
    }
    let mut built = command.clone();
    built.build();
    let checked = files.entries().and_then(|entries| check(&built, program, &entries).map(|()| entries));
    let entries = match checked {
        Ok(entries) => winners(entries),
        Err(problem) => return Err(Refusal::File(problem, Box::new(understood))),
    };
    let settings = not_overridden(&built, program, files, &understood, &entries);
    if settings.is_empty() {
        return plain(command);
    }
    let offsets = argument_offsets(&command, &typed, chain(&understood).len());
    let line = |settings: &[&Setting<'_>]| with_words(&typed, &offsets, settings);
    let all: Vec<&Setting<'_>> = settings.iter().collect();
    match command.clone().try_get_matches_from(line(&all)) {
        Err(error) if error.kind() == ErrorKind::MissingRequiredArgument => {
            let able = with_requirements_met(&command, &all, &line);
            command.try_get_matches_from(line(&able)).map_err(Refusal::CommandLine)
        }
        other => other.map_err(Refusal::CommandLine),
    }
}

fn reads_files(understood: &ArgMatches, program: &Program) -> bool {
    let own = understood.subcommand_name().is_some_and(|name| !program.without.contains(&name));
    let away = |m: &ArgMatches| m.try_get_one::<bool>("no_config").ok().flatten() == Some(&true);
    let elsewhere = understood.subcommand_name().is_some_and(|name| {
        // These tables belong to another program, which reads them itself.
        program.elsewhere.is_some_and(|tables| tables.contains(&name))
    });
    own && !elsewhere && !away(understood) && !chain(understood).iter().any(|(_, m)| away(m))
}

/// The chosen sub-commands with their parsed arguments, outermost first.
fn chain(matches: &ArgMatches) -> Vec<(&str, &ArgMatches)> {
    let mut all = Vec::new();
    let mut at = matches;
    while let Some((name, below)) = at.subcommand() {
        all.push((name, below));
        at = below;
    }
    all
}

/// Lets `--flag=false` turn off a flag that a file turns on. Only flags typed with a value get the ability to
/// take one, so that help and messages still show them without.
fn with_flags_turned_off(command: Command, typed: &[OsString]) -> Command {
    let typed_with_value: BTreeSet<String> = typed
        .iter()
        .filter_map(|word| word.to_str()?.strip_prefix("--")?.split_once('='))
        .filter(|(_, value)| matches!(*value, "true" | "false"))
        .map(|(name, _)| name.to_owned())
        .collect();
    if typed_with_value.is_empty() { command } else { accept_values(command, &typed_with_value) }
}

fn accept_values(command: Command, flags: &BTreeSet<String>) -> Command {
    let named = |arg: &clap::Arg| arg.get_long().is_some_and(|l| flags.contains(l) && l != NO_CONFIG);
    let command = command.mut_args(|arg| {
        if !named(&arg) || !matches!(arg.get_action(), ArgAction::SetTrue) {
            return arg;
        }
        let arg = arg.action(ArgAction::Set).num_args(0..=1).require_equals(true);
        arg.default_missing_value("true").default_value("false").value_parser(ValueParser::bool())
    });
    command.mut_subcommands(|below| accept_values(below, flags))
}

/// A command of the line, with its table in the files and its typed arguments.
struct Level<'c> {
    command: &'c Command,
    understood: &'c ArgMatches,
    table: Vec<String>,
    depth: usize,
}

/// The commands of a line, outermost first. The first level is the program itself with the keys at the top of
/// the files.
fn levels<'c>(built: &'c Command, program: &Program, understood: &'c ArgMatches) -> Vec<Level<'c>> {
    let prefix: Vec<String> =
        Some(program.prefix).filter(|p| !p.is_empty()).map(str::to_owned).into_iter().collect();
    let level = |command, understood, table: &[String], depth| Level {
        command,
        understood,
        table: table.to_vec(),
        depth,
    };
    let chain = chain(understood);
    // Global options may be typed after any sub-command; clap collects all of them in the innermost one.
    let deepest = chain.last().map_or(understood, |(_, m)| *m);
    let mut levels = vec![level(built, deepest, &[], 0)];
    if !prefix.is_empty() {
        levels.push(level(built, deepest, &prefix, 0));
    }
    let (mut command, mut table) = (built, prefix);
    for (depth, (name, below)) in chain.into_iter().enumerate() {
        let Some(found) = command.find_subcommand(name) else { break };
        command = found;
        table.push(name.to_owned());
        // A command whose arguments conflict with sub-commands accepts its own options only without one.
        if below.subcommand_name().is_none() || !command.is_args_conflicts_with_subcommands_set() {
            levels.push(level(command, below, &table, depth + 1));
        }
    }
    levels
}

/// Settings that the command line does not override, as arguments.
fn not_overridden<'e>(
    built: &Command,
    program: &Program,
    files: &Files,
    understood: &ArgMatches,
    entries: &'e [Entry],
) -> Vec<Setting<'e>> {
    let mut settings: Vec<Setting<'e>> = Vec::new();
    let innermost = chain(understood).len();
    // If several tables set a global option, the innermost table takes precedence.
    for level in levels(built, program, understood).iter().rev() {
        let own: Vec<&Entry> = entries.iter().filter(|e| e.table == level.table).collect();
        for entry in own.iter().filter(|entry| is_on(entry) && !is_overridden(entry, level, files, &own)) {
            let Some(arg) = option_of(level.command, &entry.key) else { continue };
            let global = arg.is_global_set();
            if global && settings.iter().any(|s| s.entry.key == entry.key) {
                continue;
            }
            let depth = if global { innermost } else { level.depth };
            settings.extend(words(arg, &entry.value).ok().map(|words| Setting { entry, depth, words }));
        }
    }
    // Options with separate values come first: a list of values ends at the next option.
    settings.sort_by_key(|s| s.words.first().is_some_and(|w| w.contains('=')));
    settings
}

/// True if the command line, a later file or the logging variable overrides a setting.
fn is_overridden(entry: &Entry, level: &Level<'_>, files: &Files, own: &[&Entry]) -> bool {
    let exclude = |other: &str| exclude_each_other(level.command, other, &entry.key);
    let typed = typed_options(level.command, level.understood);
    let logs = files.log_variable || typed.iter().any(|t| LOGGING.contains(&t.as_str()));
    typed.iter().any(|t| *t == entry.key || exclude(t))
        || own.iter().any(|other| other.rank > entry.rank && is_on(other) && exclude(&other.key))
        || (logs && LOGGING.contains(&entry.key.as_str()))
}

/// Names of the typed options: the long name, or the id of an argument without one.
fn typed_options(command: &Command, understood: &ArgMatches) -> Vec<String> {
    let typed = command.get_arguments().filter(|arg| {
        let source = understood.try_contains_id(arg.get_id().as_str()).ok();
        source.is_some() && understood.value_source(arg.get_id().as_str()) == Some(ValueSource::CommandLine)
    });
    typed.map(|arg| arg.get_long().map_or_else(|| arg.get_id().to_string(), str::to_owned)).collect()
}

/// Index of the first argument of each sub-command down to depth `deepest`, starting with the program's own
/// arguments. The arguments after that, perhaps thousands of files, are not examined.
fn argument_offsets(command: &Command, typed: &[OsString], deepest: usize) -> Vec<usize> {
    let mut offsets = vec![1];
    for end in 2..=typed.len() {
        if offsets.len() > deepest {
            break;
        }
        let part = command.clone().ignore_errors(true).try_get_matches_from(&typed[..end]);
        let depth = part.map_or(0, |m| chain(&m).len());
        while offsets.len() <= depth {
            offsets.push(end);
        }
    }
    offsets
}

fn with_words(typed: &[OsString], offsets: &[usize], settings: &[&Setting<'_>]) -> Vec<OsString> {
    let mut line = Vec::new();
    for (number, word) in typed.iter().enumerate() {
        line.push(word.clone());
        for (depth, _) in offsets.iter().enumerate().filter(|(_, offset)| **offset == number + 1) {
            let own = settings.iter().filter(|s| s.depth == depth);
            line.extend(own.flat_map(|s| s.words.iter().map(|w| OsStr::new(w).to_owned())));
        }
    }
    line
}

/// Drops settings whose required option is absent from both the command line and the other settings.
fn with_requirements_met<'s, 'e>(
    command: &Command,
    settings: &[&'s Setting<'e>],
    line: &impl Fn(&[&Setting<'_>]) -> Vec<OsString>,
) -> Vec<&'s Setting<'e>> {
    let missing = |chosen: &[&Setting<'_>]| -> BTreeSet<String> {
        match command.clone().try_get_matches_from(line(chosen)) {
            Err(e) if e.kind() == ErrorKind::MissingRequiredArgument => {
                match e.get(ContextKind::InvalidArg) {
                    Some(ContextValue::Strings(names)) => names.iter().cloned().collect(),
                    _ => BTreeSet::new(),
                }
            }
            _ => BTreeSet::new(),
        }
    };
    let (mut able, mut open): (Vec<&Setting<'_>>, Vec<&Setting<'_>>) = (Vec::new(), settings.to_vec());
    loop {
        let (before, lacking) = (able.len(), missing(&able));
        open.retain(|setting| {
            let with: Vec<&Setting<'_>> = able.iter().copied().chain([*setting]).collect();
            let usable = missing(&with).is_subset(&lacking);
            if usable {
                able.push(setting);
            }
            !usable
        });
        if able.len() == before {
            // In the order of the files again, so that the values of one option stay together.
            able.sort_by_key(|s| settings.iter().position(|o| std::ptr::eq(o.entry, s.entry)));
            return able;
        }
    }
}

/// Options of a command that a file can set.
pub fn settable(command: &Command) -> impl Iterator<Item = &clap::Arg> {
    command.get_arguments().filter(|arg| can_be_set(arg))
}
