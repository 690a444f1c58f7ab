//! A folder for temporary files, deleted when the command ends, in whatever way.

use super::OutputError;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use tempfile::{Builder, TempDir};

/// Existing folders of this program.
static FOLDERS: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// A folder of an unlikely name in the system's place for such (`TMPDIR`), which only its owner can read:
/// what lies in it may be of a person. Dropped, it is gone with all that it holds.
#[derive(Debug)]
pub struct Scratch(TempDir);

impl Scratch {
    /// Makes one.
    ///
    /// # Errors
    /// Where the system refuses.
    pub fn new() -> Result<Self, OutputError> {
        let folder = Builder::new().prefix("vitreo-").permissions(Permissions::from_mode(0o700)).tempdir();
        let folder = folder.map_err(|e| OutputError::io(&std::env::temp_dir(), e))?;
        FOLDERS.lock().unwrap_or_else(PoisonError::into_inner).push(folder.path().into());
        Ok(Scratch(folder))
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        self.0.path()
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        FOLDERS.lock().unwrap_or_else(PoisonError::into_inner).retain(|folder| folder != self.0.path());
    }
}

/// Removes all existing ones, for a program that is about to exit.
pub(super) fn remove_all() {
    let folders = FOLDERS.lock().unwrap_or_else(PoisonError::into_inner);
    folders.iter().for_each(|folder| drop(fs::remove_dir_all(folder)));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_its_owners_alone_and_goes_with_what_it_holds() {
        let scratch = Scratch::new().unwrap();
        let path = scratch.path().to_path_buf();
        assert_eq!(path.metadata().unwrap().permissions().mode() & 0o777, 0o700);
        fs::write(path.join("a"), "b").unwrap();
        assert!(FOLDERS.lock().unwrap().contains(&path));
        drop(scratch);
        assert!(!path.exists() && !FOLDERS.lock().unwrap().contains(&path));
    }
}
