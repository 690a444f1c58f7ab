//! All file output of commands, without loss of existing or half-written data.
//! - An existing file is refused without `--force`; an input of the command is always refused, under any name
//!   or link.
//! - A file appears under its name complete or not at all: it is written under a temporary name beside it,
//!   flushed to disk and renamed ([`OutputFile`]).
//! - A recording or film of a run gets its name when the run has begun and grows from then on, so that a
//!   crash loses only its end ([`GrowingFile`]).
//! - Temporary files are in a folder that is deleted when the command ends ([`Scratch`]).
//! - `-` is standard output. A pipe or a device is written directly. Missing folders are created.
//! - [`shell_word`] quotes paths in the commands that messages suggest.
//! - [`print!`] and [`println!`] work like the standard ones, but a closed standard output does not end the
//!   program ([`standard_output_failure`]).

mod claim;
pub mod exit;
mod file;
mod printable;
pub mod progress;
mod scratch;
mod shell_word;
mod stdout;
mod video;

pub use claim::{FILM_STILLS, Names, Outputs, STILLS};
pub use file::{GrowingFile, OutputFile, remove_unfinished, save};
pub use printable::printable;
pub use scratch::Scratch;
pub use shell_word::shell_word;
pub use stdout::{exit_code, standard_output_failure, write_to_stdout};
pub use video::{VideoFormat, video_file};

use std::borrow::Cow;
use std::io;
use std::path::{Path, PathBuf};

/// File name of standard output on the command line.
pub const STDOUT: &str = "-";

/// The `--force` option of commands that write files.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::Args)]
pub struct Force {
    /// Overwrite existing files.
    #[arg(long)]
    pub force: bool,
}

/// Why an output is refused or cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// A file of that name exists.
    #[error("{path}: already exists; use --force to overwrite it")]
    Exists {
        /// The file.
        path: String,
    },
    /// The output is an input of the same command.
    #[error("{path}: is an input of the command ({input}) and would be overwritten")]
    Input {
        /// The output.
        path: String,
        /// The same file, under the input's name.
        input: String,
    },
    /// Two outputs of one command have the same name.
    #[error("{path}: two outputs cannot have the same name")]
    Twice {
        /// The name.
        path: String,
    },
    /// Another program is still writing the file.
    #[error("{path}: another program is writing it; choose another name")]
    InUse {
        /// The file.
        path: String,
    },
    /// The path is a folder where a file is expected, or a file where a folder is expected.
    #[error("{path}: expected {expected}")]
    Kind {
        /// The name.
        path: String,
        /// What was expected and what was found.
        expected: &'static str,
    },
    /// The operating system refused.
    #[error("{path}: cannot be written: {}", plainly(problem))]
    Io {
        /// The file or folder.
        path: String,
        /// The system's error.
        #[source]
        problem: io::Error,
    },
}

impl OutputError {
    /// Wraps a system error on the output `path`. An [`OutputError`] inside `problem` is returned unchanged.
    pub fn io(path: &Path, problem: io::Error) -> Self {
        // Errors of this crate's writers already name the file.
        let named = |problem| OutputError::Io { path: path.display().to_string(), problem };
        problem.downcast().unwrap_or_else(named)
    }
}

/// Describes the frequent system errors in plain words.
pub fn plainly(problem: &io::Error) -> String {
    match problem.kind() {
        io::ErrorKind::StorageFull => "the disk is full".into(),
        io::ErrorKind::QuotaExceeded => "the disk quota is used up".into(),
        io::ErrorKind::ReadOnlyFilesystem => "the file system is read-only".into(),
        io::ErrorKind::PermissionDenied => "no permission".into(),
        io::ErrorKind::NotADirectory => "a part of its path is a file".into(),
        io::ErrorKind::NotFound => "its folder does not exist and cannot be created".into(),
        _ => problem.to_string(),
    }
}

/// Text for a table cell: precedes with an apostrophe what a spreadsheet would interpret as a formula.
pub fn no_formula(text: &str) -> Cow<'_, str> {
    match text.starts_with(['=', '+', '-', '@', '\t', '\r']) {
        true => Cow::Owned(format!("'{text}")),
        false => Cow::Borrowed(text),
    }
}

/// The first path of `file`, `file-2`, `file-3` and so on that does not exist, counted from index `number`
/// on; index 0 is `file` itself, which is returned even if it exists. With `force`, the path of index
/// `number`.
pub fn numbered(file: &Path, number: u32, force: bool) -> PathBuf {
    let name = |n: u32| match n {
        0 => file.to_path_buf(),
        _ => {
            let stem = file.file_stem().unwrap_or_default().to_string_lossy();
            let ending = file.extension().map(|e| format!(".{}", e.to_string_lossy())).unwrap_or_default();
            file.with_file_name(format!("{stem}-{}{ending}", n + 1))
        }
    };
    let is_taken = |path: &PathBuf| !force && number > 0 && path.symlink_metadata().is_ok();
    (number..=u32::MAX).map(name).find(|path| !is_taken(path)).unwrap_or_else(|| name(number))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_pass_over_what_exists() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.y4m");
        let name = |path: PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
        assert_eq!(name(numbered(&file, 0, false)), "a.y4m");
        assert_eq!(name(numbered(&file, 2, false)), "a-3.y4m");
        std::fs::write(folder.path().join("a-3.y4m"), "").unwrap();
        assert_eq!(name(numbered(&file, 2, false)), "a-4.y4m");
        assert_eq!(name(numbered(&file, 2, true)), "a-3.y4m");
        assert_eq!(name(numbered(&folder.path().join("stills"), 1, false)), "stills-2");
    }

    #[test]
    fn no_text_becomes_a_formula() {
        for text in ["plain", "a \"b\"", "", "1=1"] {
            assert_eq!(no_formula(text), text);
        }
        for formula in ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1"] {
            assert_eq!(no_formula(formula), format!("'{formula}"));
        }
    }

    #[test]
    fn a_full_disk_is_told_in_plain_words() {
        let error = OutputError::io(Path::new("a/b.mcap"), io::ErrorKind::StorageFull.into());
        assert_eq!(error.to_string(), "a/b.mcap: cannot be written: the disk is full");
    }
}
