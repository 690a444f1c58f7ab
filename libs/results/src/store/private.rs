//! What other users may do with a store and the recordings beside it: nothing. Files of older versions
//! could be read by every user; every correction is logged. Another user's file stays as it is, and one on a
//! read-only disk.

use std::fs::{Permissions, set_permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

/// Removes the permissions of other users on a store; returns a message where they had any.
pub(super) fn mend_file(path: &Path) -> Option<String> {
    mend(path).then(|| {
        format!("results store {}: it was open to other users and is yours alone now", path.display())
    })
}

/// The same for the recordings that lie in the store's folder or below it.
pub(super) fn mend_recordings(store: &Path, recordings: &[PathBuf]) -> Option<String> {
    let folder = store.canonicalize().ok()?.parent()?.to_path_buf();
    let mended = recordings.iter().filter(|file| file.starts_with(&folder) && mend(file)).count();
    (mended > 0).then(|| {
        format!(
            "{mended} recordings in {} were open to other users and are yours alone now",
            folder.display()
        )
    })
}

/// Takes from others what they may do with a folder that holds nothing but the store and its recordings;
/// says so where they could.
pub fn mend_folder(folder: &Path) -> Option<String> {
    mend(folder).then(|| format!("{}: it was open to other users and is yours alone now", folder.display()))
}

/// True if there was something to mend, and it is mended.
fn mend(path: &Path) -> bool {
    let mode = path.metadata().map_or(0, |found| found.permissions().mode());
    mode & 0o077 != 0 && set_permissions(path, Permissions::from_mode(mode & 0o700)).is_ok()
}
