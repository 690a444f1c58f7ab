//! Colour classes of a run: validates the file of `--colours` before any process starts.

use super::options::RunArgs;
use crate::exit::WrongUse;
use crate::programs::CAMERA;
use anyhow::{Context, bail};
use ipc::programs::command;
use protocol::health::Process;
use settings::inputs::check_file;
use std::path::Path;
use std::process::Stdio;

/// Checks the colour file, and that a process of the run uses it.
///
/// # Errors
/// If no process of the run extracts blobs from pictures, or the file is missing or invalid.
pub fn check(args: &RunArgs) -> anyhow::Result<()> {
    let Some(file) = &args.extraction.colours else { return Ok(()) };
    if !args.trackers().contains(&Process::FpgaModel) {
        let problem = "--colours: this run extracts no blobs from pictures; omit --colours, or the other source of blobs or poses";
        return Err(WrongUse(problem.into()).into());
    }
    check_file("--colours", file)?;
    judged(file).context("--colours")
}

/// Lets the camera's program parse the file, because this program has no parser for colours.
fn judged(file: &Path) -> anyhow::Result<()> {
    let mut reading = command(CAMERA)?;
    reading.args(["colours", "show", "--json", "--"]).arg(file).stdin(Stdio::null()).stdout(Stdio::null());
    let read = reading.output().with_context(|| format!("start {CAMERA}"))?;
    if read.status.success() {
        return Ok(());
    }
    bail!("{}", outputs::printable(&in_short(&String::from_utf8_lossy(&read.stderr))))
}

/// Shortens a program's error about a file to its first and last line, without the program's name and the
/// quoted lines.
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
