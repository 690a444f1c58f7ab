//! Validates tables, keys and values of settings files with clap's own parsers.

use crate::toml_file::{Entry, Value};
use crate::{ONLY_TYPED, Problem, Program};
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Arg, ArgAction, Command};
use std::any::TypeId;
use std::error::Error;

/// True if a file can set the option.
pub fn can_be_set(arg: &Arg) -> bool {
    arg.get_long().is_some_and(|long| !ONLY_TYPED.contains(&long))
}

/// The option that a key in the command's table sets.
pub fn option_of<'c>(command: &'c Command, key: &str) -> Option<&'c Arg> {
    command.get_arguments().find(|arg| arg.get_long() == Some(key) && can_be_set(arg))
}

/// Validates the entries for this program. `command` must be built.
///
/// # Errors
/// The first invalid entry: unknown table or key, wrong value, or conflict with another entry of its file.
pub fn check(command: &Command, program: &Program, entries: &[Entry]) -> Result<(), Problem> {
    for entry in entries {
        if let Some(table) = table_of(command, program, entry)? {
            check_entry(table, entry)?;
        }
    }
    for (number, entry) in entries.iter().enumerate() {
        let same = |e: &&Entry| e.rank == entry.rank && e.table == entry.table;
        for other in entries[..number].iter().filter(same) {
            let Some(table) = table_of(command, program, entry)? else { continue };
            if is_on(entry) && is_on(other) && exclude_each_other(table, &entry.key, &other.key) {
                let text = format!("cannot be together with {} of line {}", other.key, other.line);
                return Err(entry.problem(text));
            }
        }
    }
    Ok(())
}

/// False for a flag that is set to false, which gives no argument.
pub fn is_on(entry: &Entry) -> bool {
    entry.value != Value::Truth(false)
}

/// True if two options of a command conflict.
pub fn exclude_each_other(command: &Command, one: &str, other: &str) -> bool {
    let (Some(a), Some(b)) = (option_of(command, one), option_of(command, other)) else { return false };
    let names = |a: &Arg, b: &Arg| command.get_arg_conflicts_with(a).iter().any(|c| c.get_id() == b.get_id());
    names(a, b) || names(b, a)
}

/// The command of an entry's table; `None` if the table belongs to another program.
fn table_of<'c>(
    command: &'c Command,
    program: &Program,
    entry: &Entry,
) -> Result<Option<&'c Command>, Problem> {
    let mut path = &entry.table[..];
    if path.is_empty() {
        return Ok(Some(command));
    }
    if !program.prefix.is_empty() {
        match path.split_first() {
            Some((first, rest)) if first == program.prefix => path = rest,
            _ => return Ok(None),
        }
    }
    // These tables are checked by the program that owns them.
    let tables = program.elsewhere.unwrap_or_default();
    if path.first().is_some_and(|first| tables.contains(&first.as_str())) {
        return Ok(None);
    }
    let any_may = program.prefix.is_empty() && program.elsewhere.is_none();
    let mut at = command;
    for (depth, name) in path.iter().enumerate() {
        match at.find_subcommand(name) {
            Some(below) if !(depth == 0 && program.without.contains(&name.as_str())) => at = below,
            _ if depth == 0 && any_may => return Ok(None),
            _ => return Err(unknown_table(at, program, entry, depth)),
        }
    }
    Ok(Some(at))
}

fn unknown_table(at: &Command, program: &Program, entry: &Entry, depth: usize) -> Problem {
    let below = at.get_subcommands().map(Command::get_name).filter(|n| *n != "help");
    let others = program.elsewhere.into_iter().flatten().copied();
    let known = below.chain(others).filter(|n| depth > 0 || !program.without.contains(n));
    let name = &entry.table[depth];
    let nearest = nearest(name, known).map(|n| format!("; did you mean {n}?")).unwrap_or_default();
    let table = entry.table.join(".");
    let text =
        format!("[{table}]: expected the name of a command that takes settings, found {name}{nearest}");
    Problem { file: entry.file.clone(), line: Some(entry.line), text }
}

/// True if the option can be in the table: only options of all commands can be at the top of a file.
pub fn may_stand_in(table: &[String], arg: &Arg) -> bool {
    !table.is_empty() || arg.is_global_set()
}

/// Checks that a key is an option of the command and that the option accepts the value.
fn check_entry(command: &Command, entry: &Entry) -> Result<(), Problem> {
    let Some(arg) = option_of(command, &entry.key).filter(|arg| may_stand_in(&entry.table, arg)) else {
        return Err(unknown_key(command, entry));
    };
    let words = words(arg, &entry.value).map_err(|text| entry.problem(text))?;
    if words.is_empty() {
        return Ok(());
    }
    let line = std::iter::once("vitreo".to_owned()).chain(words);
    let Err(error) = command.clone().no_binary_name(false).try_get_matches_from(line) else { return Ok(()) };
    match error.kind() {
        ErrorKind::InvalidValue
        | ErrorKind::ValueValidation
        | ErrorKind::TooManyValues
        | ErrorKind::TooFewValues
        | ErrorKind::WrongNumberOfValues
        | ErrorKind::NoEquals
        | ErrorKind::UnknownArgument
        | ErrorKind::InvalidUtf8 => Err(entry.problem(expected(arg, &error, &entry.value))),
        // The command line may still provide missing values.
        _ => Ok(()),
    }
}

fn unknown_key(command: &Command, entry: &Entry) -> Problem {
    if ONLY_TYPED.contains(&entry.key.as_str()) {
        return entry.problem("works on the command line only");
    }
    if command.get_positionals().any(|a| a.get_id().as_str() == entry.key) {
        return entry.problem("is not an option; give it on the command line");
    }
    let known = command
        .get_arguments()
        .filter(|a| can_be_set(a) && !a.is_hide_set() && may_stand_in(&entry.table, a));
    let nearest = nearest(&entry.key, known.filter_map(Arg::get_long));
    let nearest = nearest.map(|n| format!("; did you mean {n}?")).unwrap_or_default();
    let name = if entry.table.is_empty() {
        "all commands take".to_owned()
    } else {
        format!("vitreo {} takes", entry.table.join(" "))
    };
    entry.problem(format!("expected an option that {name}, found {}{nearest}", entry.key))
}

/// Expected and actual value of an option, as the text of an error.
fn expected(arg: &Arg, error: &clap::Error, value: &Value) -> String {
    let possible: Vec<String> = arg
        .get_possible_values()
        .iter()
        .filter(|v| !v.is_hide_set())
        .map(|v| v.get_name().to_owned())
        .collect();
    let types: [(TypeId, &str); 8] = [
        (TypeId::of::<u8>(), "a whole number from 0 to 255"),
        (TypeId::of::<u16>(), "a whole number from 0 to 65535"),
        (TypeId::of::<u32>(), "a whole number of 0 or more"),
        (TypeId::of::<u64>(), "a whole number of 0 or more"),
        (TypeId::of::<usize>(), "a whole number of 0 or more"),
        (TypeId::of::<i64>(), "a whole number"),
        (TypeId::of::<f32>(), "a number"),
        (TypeId::of::<f64>(), "a number"),
    ];
    let kind = arg.get_value_parser().type_id();
    let name = arg.get_value_names().and_then(|names| names.first()).map(ToString::to_string);
    let wanted = match types.iter().find(|(id, _)| kind == *id) {
        _ if !possible.is_empty() => format!("one of {}", possible.join(", ")),
        Some((_, text)) => (*text).to_owned(),
        None => name.unwrap_or_else(|| "a value".into()),
    };
    let suggested = match error.get(ContextKind::SuggestedValue) {
        Some(ContextValue::String(value)) => format!("; did you mean {value}?"),
        _ => String::new(),
    };
    // The parser's own error is more precise than the type.
    let is_precise = |cause: &dyn Error| !cause.to_string().contains("invalid digit");
    let reason = error
        .source()
        .filter(|cause| is_precise(*cause))
        .map(|cause| format!(" ({cause})"))
        .unwrap_or_default();
    format!("expected {wanted}, found {value}{suggested}{reason}")
}

/// A setting as command-line arguments; none if it turns a flag off.
///
/// # Errors
/// The expected form, if the value's type does not fit the option.
pub fn words(arg: &Arg, value: &Value) -> Result<Vec<String>, String> {
    let name = arg.get_long().unwrap_or_default();
    let with = |text: &str| format!("--{name}={text}");
    let least = arg.get_num_args().map_or(1, |range| range.min_values());
    match (arg.get_action(), value) {
        (ArgAction::SetTrue, Value::Truth(truth)) => Ok(vec![format!("--{name}"); usize::from(*truth)]),
        (ArgAction::SetTrue, other) => Err(format!("expected true or false, found {other}")),
        (ArgAction::Count, Value::Text(text)) => match text.parse::<u8>() {
            Ok(times) => Ok(vec![format!("--{name}"); times.into()]),
            Err(_) => Err(format!("expected a count, 0 to 255, found {value}")),
        },
        (ArgAction::Count, other) => Err(format!("expected a count, 0 to 255, found {other}")),
        (_, Value::Truth(truth)) if least == 0 => Ok(vec![format!("--{name}"); usize::from(*truth)]),
        (_, Value::Truth(truth)) => Ok(vec![with(&truth.to_string())]),
        (_, Value::Text(text)) => Ok(vec![with(text)]),
        (ArgAction::Append, Value::List(texts)) if least > 1 => {
            Ok(std::iter::once(format!("--{name}")).chain(texts.iter().cloned()).collect())
        }
        (ArgAction::Append, Value::List(texts)) => Ok(texts.iter().map(|t| with(t)).collect()),
        (_, other) => Err(format!("expected one value, found {other}")),
    }
}

/// The known name with the smallest edit distance, if that distance is small.
fn nearest<'a>(written: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let ranked = known.map(|name| (distance(written, name), name));
    let (distance, name) = ranked.min_by_key(|(d, name)| (*d, name.len().abs_diff(written.len())))?;
    (distance <= written.chars().count().max(3) / 3 + 1).then_some(name)
}

/// Edit distance in characters: insertions, deletions, substitutions and swaps of neighbours (Damerau and
/// Levenshtein, restricted: no substring is edited twice).
fn distance(one: &str, other: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (one.chars().collect(), other.chars().collect());
    let mut rows = vec![(0..=b.len()).collect::<Vec<usize>>()];
    for i in 1..=a.len() {
        let mut row = vec![i];
        for j in 1..=b.len() {
            let changed = rows[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
            let mut least = changed.min(rows[i - 1][j] + 1).min(row[j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                least = least.min(rows[i - 2][j - 2] + 1);
            }
            row.push(least);
        }
        rows.push(row);
    }
    rows[a.len()][b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_nearest_name_is_found_and_a_far_one_is_not() {
        let known = ["duration", "direct", "report", "record", "level"];
        let of = |written: &str| nearest(written, known.into_iter());
        assert_eq!(of("durration"), Some("duration"));
        assert_eq!(of("reprot"), Some("report"));
        assert_eq!(of("recrod"), Some("record"));
        assert_eq!((of("lvel"), of("wholly-other"), of("")), (Some("level"), None, None));
    }

    proptest! {
        #[test]
        fn the_distance_is_one(a in "[ab]{0,6}", b in "[ab]{0,6}", at in 0_usize..6) {
            let d = distance(&a, &b);
            prop_assert_eq!(d, distance(&b, &a));
            prop_assert_eq!(d == 0, a == b);
            prop_assert!(d <= a.len().max(b.len()) && d >= a.len().abs_diff(b.len()));
            let mut longer = a.clone();
            longer.insert(at.min(a.len()), 'x');
            prop_assert_eq!(distance(&a, &longer), 1);
        }
    }
}
