//! Looking at files before anything is begun with them: a message names the option and the file.

use anyhow::{Context, ensure};
use std::fs::{File, metadata};
use std::path::Path;

/// Refuses a file that cannot be read. A pipe is left alone: what is read of it is gone.
///
/// # Errors
/// Where it is absent, a folder, or not for this user.
pub fn check_file(option: &str, path: &Path) -> anyhow::Result<()> {
    let named = || format!("{option} {}", path.display());
    let about = metadata(path).with_context(named)?;
    ensure!(!about.is_dir(), "{}: expected a file, found a folder", named());
    if about.is_file() {
        File::open(path).with_context(named)?;
    }
    Ok(())
}

/// Refuses a folder that is absent or none.
///
/// # Errors
/// Where there is no such folder.
pub fn check_folder(option: &str, path: &Path) -> anyhow::Result<()> {
    let named = || format!("{option} {}", path.display());
    let about = metadata(path).with_context(named)?;
    ensure!(about.is_dir(), "{}: expected a folder, found a file", named());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn option_and_file_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rig.json");
        let told = |checked: anyhow::Result<()>| format!("{:#}", checked.unwrap_err());
        let missing = told(check_file("--rig", &file));
        assert!(missing.contains("--rig") && missing.contains("rig.json: No such file"), "{missing}");
        std::fs::write(&file, "").unwrap();
        assert!(check_file("--rig", &file).is_ok() && check_folder("--instruments", folder.path()).is_ok());
        assert!(told(check_file("--rig", folder.path())).contains("expected a file"));
        assert!(told(check_folder("--instruments", &file)).contains("expected a folder"));
        assert!(told(check_folder("--instruments", &folder.path().join("x"))).contains("--instruments"));
    }
}
