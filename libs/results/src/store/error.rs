//! What can be wrong with a store, in words that say what to do.

use rusqlite::ErrorCode;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::Duration;

/// Why the store could not do it.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Another program holds it.
    #[error(
        "results store {file}: locked by another program for more than {seconds} s; end that program or try later"
    )]
    Locked {
        /// The file.
        file: String,
        /// How long it was waited for, s.
        seconds: u64,
    },
    /// No room is left.
    #[error("results store {file}: the disk is full; nothing was changed")]
    Full {
        /// The file.
        file: String,
    },
    /// It may be read only.
    #[error("results store {file}: not writable by you{owner}")]
    ReadOnly {
        /// The file.
        file: String,
        /// Whose it is, where it is somebody else's.
        owner: String,
    },
    /// It may not even be read.
    #[error("results store {file}: cannot be opened by you{owner}")]
    Refused {
        /// The file.
        file: String,
        /// Whose it is, where it is somebody else's.
        owner: String,
    },
    /// Its bytes are not those that were written.
    #[error(
        "results store {file}: damaged: {problem}; it is left unchanged. `vitreo results add NAME \
         RECORDING… --store NEW.sqlite` makes a new store of its attempts from their recordings"
    )]
    Damaged {
        /// The file.
        file: String,
        /// What is wrong with it.
        problem: String,
    },
    /// An attempt is not what was kept.
    #[error(
        "results store {file}: attempt {id} of {trainee} is damaged: {problem}; `vitreo results delete \
         {trainee} --attempt {id}` removes it, `vitreo results add` adds it again from its recording"
    )]
    Attempt {
        /// The file.
        file: String,
        /// Number of the attempt, as far as it can be read.
        id: String,
        /// The trainee, as far as it can be read.
        trainee: String,
        /// What is wrong with it.
        problem: String,
    },
    /// Something else lies there.
    #[error("results store {file}: expected a results store, found {found}")]
    Foreign {
        /// The file.
        file: String,
        /// What it is.
        found: String,
    },
    /// Made by a newer program.
    #[error(
        "results store {file}: expected a schema up to {newest}, found {found}; use the newer vitreo that made it"
    )]
    Newer {
        /// The file.
        file: String,
        /// The newest schema this build knows.
        newest: usize,
        /// The store's.
        found: i64,
    },
    /// There is none.
    #[error("results store {file}: no such file; `vitreo run --module NAME --trainee NAME` creates it")]
    Missing {
        /// The file.
        file: String,
    },
    /// A value makes no sense.
    #[error("{field}: expected {expected}, found {found}")]
    Value {
        /// What was given.
        field: &'static str,
        /// What would be right.
        expected: String,
        /// What it was.
        found: String,
    },
    /// Anything else, in SQLite's words.
    #[error("results store {file}: {problem}")]
    Other {
        /// The file.
        file: String,
        /// Why.
        problem: String,
    },
}

/// SQLite's error in words that say what to do.
pub(super) fn store_error(path: &Path, patience: Duration, error: rusqlite::Error) -> StoreError {
    let file = path.display().to_string();
    match error.sqlite_error_code() {
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => {
            StoreError::Locked { file, seconds: patience.as_secs() }
        }
        Some(ErrorCode::DiskFull) => StoreError::Full { file },
        Some(ErrorCode::ReadOnly) => StoreError::ReadOnly { file, owner: owner_of(path) },
        Some(ErrorCode::CannotOpen | ErrorCode::PermissionDenied) if path.exists() && !path.is_dir() => {
            StoreError::Refused { file, owner: owner_of(path) }
        }
        Some(ErrorCode::NotADatabase) => {
            StoreError::Foreign { file, found: "a file that is not a database".into() }
        }
        Some(ErrorCode::DatabaseCorrupt) => StoreError::Damaged { file, problem: error.to_string() },
        _ => StoreError::Other { file, problem: error.to_string() },
    }
}

/// "; it belongs to user 1000 (mode 0600)", where a file is somebody else's.
fn owner_of(path: &Path) -> String {
    let own = rustix::process::geteuid().as_raw();
    match path.metadata() {
        Ok(found) if found.uid() != own => {
            format!("; it belongs to user {} (mode {:04o})", found.uid(), found.mode() & 0o7777)
        }
        _ => String::new(),
    }
}
