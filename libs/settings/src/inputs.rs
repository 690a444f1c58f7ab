//! Checks input files before a command starts; errors name the option and the file.

use protocol::file::STDIN;
use std::fmt::Display;
use std::fs::{File, metadata};
use std::path::Path;

/// An option names a file that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{option} {path}: {problem}")]
pub struct InputError {
    /// The option.
    option: String,
    /// The file.
    path: String,
    /// Why it cannot be used.
    problem: String,
}

/// Checks that a file can be opened. Pipes and standard input (`-`) are not opened, because that would
/// consume data or disturb the writer.
///
/// # Errors
/// If the file is missing or unreadable, or is a folder.
pub fn check_file(option: &str, path: &Path) -> Result<(), InputError> {
    if path.as_os_str() == STDIN {
        return Ok(());
    }
    let refuse = |problem: &dyn Display| refusal(option, path, problem);
    let about = metadata(path).map_err(|problem| refuse(&problem))?;
    if about.is_dir() {
        return Err(refuse(&"expected a file, found a folder"));
    }
    if about.is_file() {
        File::open(path).map_err(|problem| refuse(&problem))?;
    }
    Ok(())
}

/// Checks that a folder exists.
///
/// # Errors
/// If the path is missing or not a folder.
pub fn check_folder(option: &str, path: &Path) -> Result<(), InputError> {
    let about = metadata(path).map_err(|problem| refusal(option, path, &problem))?;
    let refused = || refusal(option, path, &"expected a folder, found a file");
    if about.is_dir() { Ok(()) } else { Err(refused()) }
}

fn refusal(option: &str, path: &Path, problem: &dyn Display) -> InputError {
    InputError { option: option.into(), path: path.display().to_string(), problem: problem.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn option_and_file_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rig.json");
        let told = |checked: Result<(), InputError>| checked.unwrap_err().to_string();
        let missing = told(check_file("--rig", &file));
        assert!(missing.contains("--rig") && missing.contains("rig.json: No such file"), "{missing}");
        std::fs::write(&file, "").unwrap();
        assert!(check_file("--rig", &file).is_ok() && check_folder("--instruments", folder.path()).is_ok());
        assert!(told(check_file("--rig", folder.path())).contains("expected a file"));
        assert!(told(check_folder("--instruments", &file)).contains("expected a folder"));
        assert!(told(check_folder("--instruments", &folder.path().join("x"))).contains("--instruments"));
    }
}
