//! A campaign: each target in a process of its own, so that one that dies ends nothing else; a table
//! at the end.

use crate::engine::{Limits, Outcome};
use crate::targets::Target;
use crate::watch::{HUNG_CODE, MOST_MEMORY, Present, SLOW};
use anyhow::{Context, Result, ensure};
use std::io::{BufRead, BufReader, IsTerminal, Write};
use std::path::Path;
use std::process::{Command, Stdio};

/// Prefix of the lines in which a process reports its progress.
pub const TELLS: &str = "outcome ";

/// What came of a target, and how its process ended where that was not in order.
#[derive(Debug, Clone)]
pub struct Row {
    name: &'static str,
    kind: &'static str,
    outcome: Outcome,
    died: Option<String>,
}

impl Row {
    /// True if nothing crashed, hung, or took too much.
    pub fn is_good(&self) -> bool {
        let o = &self.outcome;
        self.died.is_none() && o.crashes == 0 && o.slow == 0 && o.memory <= MOST_MEMORY
    }
}

/// Tries a target in a process of its own.
///
/// # Errors
/// Where the process cannot be started.
pub fn try_target(target: &Target, seed: u64, limits: Limits, out: &Path) -> Result<Row> {
    let folder = out.join(target.name);
    std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    let mut command = Command::new(std::env::current_exe()?);
    command.args(["one", target.name, "--seed", &seed.to_string(), "--out"]).arg(&folder);
    if let Some(time) = limits.time {
        command.args(["--seconds", &time.as_secs_f64().to_string()]);
    }
    if let Some(inputs) = limits.inputs {
        command.args(["--inputs", &inputs.to_string()]);
    }
    let mut child = command.stdout(Stdio::piped()).spawn().context("own program")?;
    let mut outcome = Outcome::default();
    for line in BufReader::new(child.stdout.take().context("standard output")?).lines() {
        if let Some(report) = line?.strip_prefix(TELLS).and_then(Outcome::from_line) {
            outcome = report;
            show(target, &outcome);
        }
    }
    let status = child.wait()?;
    let died = (!status.success()).then(|| {
        let rest = Present::read(&folder).unwrap_or_default();
        let _ = std::fs::write(folder.join("died"), &rest);
        match status.code() {
            Some(HUNG_CODE) => "hung".to_owned(),
            _ => status.to_string(),
        }
    });
    Ok(Row { name: target.name, kind: target.kind.name(), outcome, died })
}

/// The line of progress.
fn show(target: &Target, o: &Outcome) {
    let mut out = std::io::stderr();
    if out.is_terminal() {
        let each = o.inputs as f64 / o.seconds.max(1e-3);
        let (name, new, crashes) = (target.name, o.new, o.crashes);
        let _ = write!(out, "\r\x1b[K{name}: {} inputs, {each:.0}/s, {new} new, {crashes} crashes", o.inputs);
        let _ = out.flush();
    }
}

/// The table, with a line for each target.
pub fn table(rows: &[Row]) -> String {
    let mut text = String::from(
        "| target | kind | inputs | s | inputs/s | branches | kept (new) | crashes | slowest, ms | memory, MB |\n\
         |---|---|--:|--:|--:|--:|--:|--:|--:|--:|\n",
    );
    for row in rows {
        let o = &row.outcome;
        let crashes = row.died.as_ref().map_or(o.crashes.to_string(), |d| format!("{} ({d})", o.crashes));
        text += &format!(
            "| {} | {} | {} | {:.0} | {:.0} | {} | {} ({}) | {crashes} | {:.1}{} | {:.0} |\n",
            row.name,
            row.kind,
            grouped(o.inputs),
            o.seconds,
            o.inputs as f64 / o.seconds.max(1e-3),
            o.branches,
            o.kept,
            o.new,
            o.slowest_ms,
            if o.slow > 0 { format!(" ({} over {} s)", o.slow, SLOW.as_secs()) } else { String::new() },
            o.memory as f64 / 1e6,
        );
    }
    text
}

/// A number with its digits in groups of three.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let groups: Vec<&str> =
        digits.as_bytes().rchunks(3).rev().filter_map(|g| std::str::from_utf8(g).ok()).collect();
    groups.join(" ")
}

/// Tries targets one after the other and prints the table; fails where one crashed, hung, or took too
/// much.
///
/// # Errors
/// Where a process cannot be started, or a target is not good.
pub fn run(targets: &[Target], seed: u64, limits: impl Fn(&Target) -> Limits, out: &Path) -> Result<()> {
    let mut rows = Vec::new();
    for target in targets {
        rows.push(try_target(target, seed, limits(target), out)?);
        if std::io::stderr().is_terminal() {
            eprint!("\r\x1b[K");
        }
        eprint!("{}", table(&rows[rows.len() - 1..]).lines().next_back().unwrap_or_default());
        eprintln!();
    }
    print!("{}", table(&rows));
    let bad: Vec<&str> = rows.iter().filter(|r| !r.is_good()).map(|r| r.name).collect();
    ensure!(bad.is_empty(), "{}: see {}", bad.join(", "), out.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_has_a_line_for_each_target() {
        let outcome =
            Outcome { inputs: 1_234_567, seconds: 2.0, slow: 1, slowest_ms: 1500.0, ..Outcome::default() };
        let row = Row { name: "rig-json", kind: "text", outcome, died: None };
        assert!(!row.is_good());
        let text = table(&[row]);
        let line = text.lines().nth(2).unwrap();
        assert!(
            line.contains("| 1 234 567 | 2 | 617284 |") && line.contains("1500.0 (1 over 1 s)"),
            "{line}"
        );
    }
}
