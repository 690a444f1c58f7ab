//! A folder for temporary files, deleted when the command ends, also after an error or a signal.

use super::OutputError;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use tempfile::{Builder, TempDir};

/// Existing scratch folders of this program.
static FOLDERS: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// A private temporary folder in `TMPDIR` (mode 0700, it may hold personal data), deleted with its contents
/// on drop.
#[derive(Debug)]
pub struct Scratch(TempDir);

impl Scratch {
    /// Creates a scratch folder.
    ///
    /// # Errors
    /// If the folder cannot be created.
    pub fn new() -> Result<Self, OutputError> {
        let folder = Builder::new().prefix("vitreo-").permissions(Permissions::from_mode(0o700)).tempdir();
        let folder = folder.map_err(|e| OutputError::io(&std::env::temp_dir(), e))?;
        FOLDERS.lock().unwrap_or_else(PoisonError::into_inner).push(folder.path().into());
        Ok(Scratch(folder))
    }

    /// Path of the folder.
    pub fn path(&self) -> &Path {
        self.0.path()
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        FOLDERS.lock().unwrap_or_else(PoisonError::into_inner).retain(|folder| folder != self.0.path());
    }
}

/// Removes all existing scratch folders, for a program that is about to exit.
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
