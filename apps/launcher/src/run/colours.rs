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
    bail!("{}", outputs::printable(&first_line(&String::from_utf8_lossy(&read.stderr))))
}

/// The first line of a program's error, without the program's name.
fn first_line(error: &str) -> String {
    let error = error.trim();
    let error = error.strip_prefix(CAMERA).and_then(|rest| rest.strip_prefix(": ")).unwrap_or(error);
    error.lines().next().unwrap_or("the file is refused").into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use settings::commands::processes::{ExtractionArgs, VirtualRigArgs};

    #[test]
    fn the_error_of_the_reader_is_repeated_without_its_name() {
        assert_eq!(first_line("vitreo-fpga-model: c.toml: low: found 0\n"), "c.toml: low: found 0");
        assert_eq!(
            first_line("c.toml, line 1: missing key class\nmore\n"),
            "c.toml, line 1: missing key class"
        );
        assert_eq!(first_line(""), "the file is refused");
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
