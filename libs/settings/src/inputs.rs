//! Checks of input files before a command starts; errors name the option and the file.

use protocol::file::STDIN;
use std::fmt::Display;
use std::fs::{File, metadata};
use std::path::Path;

/// A file that an option names cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{option} {path}: {problem}")]
pub struct InputError {
    /// The option.
    option: String,
    /// The file.
    path: String,
    /// Why not.
    problem: String,
}

/// Refuses a file that cannot be read. A pipe and standard input (`-`) are not opened: data read from them
/// would be gone.
///
/// # Errors
/// Where it is absent, a folder, or not for this user.
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

/// Refuses a folder that is absent or none.
///
/// # Errors
/// Where there is no such folder.
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
