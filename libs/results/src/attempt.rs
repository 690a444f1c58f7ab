//! An attempt at a module, as it is kept.

use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Points of a category or a metric.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Points {
    /// Name for programs.
    pub key: String,
    /// A metric's figure in its own unit; `None` for categories, and where the task has nothing of
    /// the kind.
    pub value: Option<f64>,
    /// Deviation of the figure by tracking noise.
    pub sigma: Option<f64>,
    /// Points it brought.
    pub points: f64,
    /// Points it could have brought.
    pub of: f64,
}

/// An attempt at a module.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Attempt {
    /// When it began, seconds since 1970 UTC.
    pub at_s: i64,
    /// Name of the module.
    pub module: String,
    /// Level, from 1 on.
    pub level: u32,
    /// The scripted surgeon who made it; `None` for a person.
    pub surgeon: Option<String>,
    /// Version of the program that ran it.
    pub program: String,
    /// Version of the score.
    pub score_version: u32,
    /// Seed of the run.
    pub seed: Option<u64>,
    /// Points of 100.
    pub total: f64,
    /// Deviation of the total by tracking noise.
    pub sigma: f64,
    /// Every goal was reached in time.
    pub finished: bool,
    /// It was left before its end; the points are those it had by then.
    pub broken_off: bool,
    /// The serious injury that failed it.
    pub failed: Option<String>,
    /// Time of the attempt, s.
    pub took_s: f64,
    /// Points by category.
    pub categories: Vec<Points>,
    /// Every metric.
    pub metrics: Vec<Points>,
    /// Path of the recording.
    pub recording: Option<String>,
    /// SHA-256 of the recording, 64 hexadecimal digits.
    pub recording_sha256: Option<String>,
}

/// An attempt with what the store adds to it.
#[derive(Debug, Clone, PartialEq)]
pub struct Stored {
    /// Number in the store; never used again.
    pub id: i64,
    /// The trainee's pseudonym.
    pub trainee: String,
    /// [`Attempt::at_s`] for people: `2002-09-25T08:30:00Z`.
    pub at: String,
    /// The attempt.
    pub attempt: Attempt,
}

/// SHA-256 of a recording's file, or of its parts one after the other, in hexadecimal digits.
///
/// # Errors
/// If the file cannot be read.
pub fn sha256_of(path: &Path) -> std::io::Result<String> {
    let (mut hasher, mut buffer) = (Sha256::new(), vec![0; 256 << 10]);
    for path in recording::files_of(path) {
        let mut file = File::open(path)?;
        loop {
            match file.read(&mut buffer)? {
                0 => break,
                read => hasher.update(&buffer[..read]),
            }
        }
    }
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_is_that_of_the_standard() {
        // FIPS 180-4, example "abc", as NIST publishes it.
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "abc").unwrap();
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(sha256_of(file.path()).unwrap(), expected);
        assert!(sha256_of(Path::new("/nowhere/a.mcap")).is_err());
    }
}
