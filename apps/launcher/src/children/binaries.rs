//! Where the binaries of this installation are, and how one is started under a scheduler.

use anyhow::Context;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

/// Priority of real-time processes, 1 to 99; above ordinary ones, below the kernel's own threads.
const REALTIME_PRIORITY: &str = "10";

/// The directories where the binaries may be, given the path of this executable: beside it, and
/// for a test program in `target/PROFILE/deps`, one up.
fn candidates(executable: &Path) -> Vec<PathBuf> {
    let beside = executable.parent().map(Path::to_path_buf);
    let above = beside.as_deref().filter(|d| d.ends_with("deps")).and_then(Path::parent);
    let above = above.map(Path::to_path_buf);
    above.into_iter().chain(beside).collect()
}

/// Path of a binary of this installation, for instance `vitreo-tracker`.
///
/// # Errors
/// Where it is absent; the text names the command that builds it.
pub fn find_binary(name: &str) -> anyhow::Result<PathBuf> {
    let executable = std::env::current_exe().context("path of the running program")?;
    let places = candidates(&executable);
    let found = places.iter().map(|d| d.join(name)).find(|p| p.is_file());
    found.with_context(|| {
        let first = places.first().map(|d| d.display().to_string()).unwrap_or_default();
        format!("{name} is not in {first}; build everything with: cargo build --release --workspace")
    })
}

/// True if `chrt` is there and this user may start real-time processes. Tried once.
pub fn realtime_allowed() -> bool {
    static ALLOWED: OnceLock<bool> = OnceLock::new();
    *ALLOWED.get_or_init(|| {
        let mut attempt = Command::new("chrt");
        attempt.args(["--rr", REALTIME_PRIORITY, "true"]);
        attempt.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        attempt.status().is_ok_and(|s| s.success())
    })
}

/// Environment of every program that is started, where the user has not set it. Graphics drivers
/// ask Wayland for a display even where none is needed; without a folder for its socket its library
/// writes to standard error, with one that is absent it gives up in silence.
const ENVIRONMENT: [(&str, &str); 1] = [("XDG_RUNTIME_DIR", "/nonexistent")];

/// The command that runs a binary of this installation.
///
/// # Errors
/// Where the binary is absent.
pub fn command(name: &str) -> anyhow::Result<Command> {
    let mut command = Command::new(find_binary(name)?);
    set_environment(&mut command);
    Ok(command)
}

fn set_environment(command: &mut Command) {
    for (name, value) in ENVIRONMENT {
        if std::env::var_os(name).is_none() {
            command.env(name, value);
        }
    }
}

/// The command that runs a program, with `realtime` under the real-time scheduler.
pub(super) fn scheduled_command(program: &Path, realtime: bool) -> Command {
    let mut command = Command::new(if realtime { Path::new("chrt") } else { program });
    if realtime {
        // `chrt` replaces itself by the program: the child's id is the program's.
        command.args(["--rr", REALTIME_PRIORITY]).arg(program);
    }
    set_environment(&mut command);
    command
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn binaries_are_sought_beside_the_program_and_above_a_test() {
        assert_eq!(candidates(Path::new("/x/bin/vitreo")), [Path::new("/x/bin")]);
        let test = candidates(Path::new("/x/target/debug/deps/t-1"));
        assert_eq!(test, [Path::new("/x/target/debug"), Path::new("/x/target/debug/deps")]);
    }

    #[test]
    fn a_missing_binary_says_how_to_build_it() {
        let error = find_binary("vitreo-no-such-thing").unwrap_err().to_string();
        assert!(error.contains("cargo build --release --workspace"), "{error}");
    }
}
