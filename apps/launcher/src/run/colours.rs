//! Colour classes of a run: checks the file of `--colours` before anything starts.

use super::options::RunArgs;
use crate::exit::WrongUse;
use crate::programs::CAMERA;
use anyhow::{Context, bail};
use ipc::programs::command;
use protocol::health::Process;
use settings::inputs::check_file;
use std::path::Path;
use std::process::Stdio;

/// Refuses an invalid colour file, and one that no process would use.
///
/// # Errors
/// Where it is so.
pub fn check(args: &RunArgs) -> anyhow::Result<()> {
    let Some(file) = &args.extraction.colours else { return Ok(()) };
    if !args.trackers().contains(&Process::FpgaModel) {
        let problem = "--colours: this run extracts no blobs from pictures; omit --colours, or the other source of blobs or poses";
        return Err(WrongUse(problem.into()).into());
    }
    check_file("--colours", file)?;
    judged(file).context("--colours")
}

/// Lets the program that uses the file read it: this one has no colour parser.
fn judged(file: &Path) -> anyhow::Result<()> {
    let mut reading = command(CAMERA)?;
    reading.args(["colours", "show", "--json", "--"]).arg(file).stdin(Stdio::null()).stdout(Stdio::null());
    let read = reading.output().with_context(|| format!("start {CAMERA}"))?;
    if read.status.success() {
        return Ok(());
    }
    bail!("{}", outputs::printable(&in_short(&String::from_utf8_lossy(&read.stderr))))
}

/// A program's error about a file, without the program's name and the quoted lines of the file.
fn in_short(told: &str) -> String {
    let told = told.trim();
    let told = told.strip_prefix(CAMERA).and_then(|rest| rest.strip_prefix(": ")).unwrap_or(told);
    match (told.lines().next(), told.lines().next_back()) {
        (Some(first), Some(last)) if first != last => format!("{first}: {last}"),
        (Some(only), _) => only.into(),
        _ => "the file is refused".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use settings::commands::processes::{ExtractionArgs, VirtualRigArgs};

    #[test]
    fn what_the_reader_says_is_told_in_a_line() {
        let toml = "vitreo-fpga-model: c.toml: TOML parse error at line 1, column 1\n  |\n1 | x\n  | ^\nmissing field `class`\n";
        assert_eq!(in_short(toml), "c.toml: TOML parse error at line 1, column 1: missing field `class`");
        assert_eq!(in_short("vitreo-fpga-model: c.toml: low: found 0\n"), "c.toml: low: found 0");
        assert_eq!(in_short(""), "the file is refused");
    }

    #[test]
    fn colours_without_pictures_or_without_a_file_are_refused() {
        let colours = |file: &str, direct| {
            let extraction = ExtractionArgs { colours: Some(file.into()) };
            let virtual_rig = VirtualRigArgs { direct, ..VirtualRigArgs::default() };
            check(&RunArgs { extraction, virtual_rig, ..RunArgs::default() }).unwrap_err()
        };
        assert!(colours("a.toml", true).is::<WrongUse>());
        let absent = format!("{:#}", colours("/no/colours.toml", false));
        assert!(absent.contains("--colours") && absent.contains("No such file"), "{absent}");
        assert!(check(&RunArgs::default()).is_ok());
    }
}
