//! Where the programs of this installation are, and the surroundings in which one is started.

use std::path::{Path, PathBuf};
use std::process::Command;

/// A program of this installation is not where it should be.
#[derive(Debug, thiserror::Error)]
#[error("{name} is not in {folder}; build everything with: cargo build --release --workspace")]
pub struct MissingProgram {
    /// The program.
    name: String,
    /// Where it was looked for first.
    folder: String,
}

/// The directories where the binaries may be, given the path of this executable: beside it, and
/// for a test program in `target/PROFILE/deps`, one up.
fn candidates(executable: &Path) -> Vec<PathBuf> {
    let beside = executable.parent().map(Path::to_path_buf);
    let above = beside.as_deref().filter(|d| d.ends_with("deps")).and_then(Path::parent);
    let above = above.map(Path::to_path_buf);
    above.into_iter().chain(beside).collect()
}

/// Path of a program of this installation, for instance `vitreo-tracker`.
///
/// # Errors
/// Where it is absent; the text names the command that builds it.
pub fn find(name: &str) -> Result<PathBuf, MissingProgram> {
    // Without a path of its own, nothing lies beside it.
    let places = std::env::current_exe().map(|executable| candidates(&executable)).unwrap_or_default();
    let found = places.iter().map(|folder| folder.join(name)).find(|path| path.is_file());
    found.ok_or_else(|| {
        let folder = places.first().map(|folder| folder.display().to_string()).unwrap_or_default();
        MissingProgram { name: name.into(), folder }
    })
}

/// Environment of every program that is started, where the user has not set it. Graphics drivers
/// ask Wayland for a display even where none is needed; without a folder for its socket its library
/// writes to standard error, with one that is absent it gives up in silence.
const ENVIRONMENT: [(&str, &str); 1] = [("XDG_RUNTIME_DIR", "/nonexistent")];

/// The command that runs a program of this installation.
///
/// # Errors
/// Where it is absent.
pub fn command(name: &str) -> Result<Command, MissingProgram> {
    let mut command = Command::new(find(name)?);
    set_environment(&mut command);
    Ok(command)
}

/// Sets what a driver needs, where the user has not.
pub fn set_environment(command: &mut Command) {
    for (name, value) in ENVIRONMENT {
        if std::env::var_os(name).is_none() {
            command.env(name, value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn programs_are_sought_beside_the_program_and_above_a_test() {
        assert_eq!(candidates(Path::new("/x/bin/vitreo")), [Path::new("/x/bin")]);
        let test = candidates(Path::new("/x/target/debug/deps/t-1"));
        assert_eq!(test, [Path::new("/x/target/debug"), Path::new("/x/target/debug/deps")]);
    }

    #[test]
    fn a_missing_program_says_how_to_build_it() {
        let error = find("vitreo-no-such-thing").unwrap_err().to_string();
        assert!(error.contains("cargo build --release --workspace"), "{error}");
    }
}
