//! What a run announces to external programs: that it runs, and what it accepts from outside.
//!
//! The launcher names the channels in a file of the instance's directory once its own processes are at work. A
//! program that comes earlier waits for the file; where a launcher was killed it lies there without an owner and
//! counts for nothing.

use super::IpcError;
use super::instance::{Instance, LOCK, TOKEN, instance_directory};
use rustix::fs::{FlockOperation, flock};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// File that names the channels, one a line.
const FILE: &str = "outside";
/// A program that looks whether the owner runs holds its lock for a moment: the owner tries again.
const TRIES: u32 = 10;
/// Time between two tries.
const BETWEEN: Duration = Duration::from_millis(10);

/// Locks an owner's file; fails where another owner runs.
pub(super) fn lock_for_owner(lock: &File) -> rustix::io::Result<()> {
    let mut tried = flock(lock, FlockOperation::NonBlockingLockExclusive);
    for _ in 1..TRIES {
        if tried.is_ok() {
            break;
        }
        std::thread::sleep(BETWEEN);
        tried = flock(lock, FlockOperation::NonBlockingLockExclusive);
    }
    tried
}

/// True while the owner of a directory runs.
fn has_owner(directory: &Path) -> bool {
    let Ok(lock) = File::open(directory.join(LOCK)) else { return false };
    // Closing the file gives the lock back.
    flock(&lock, FlockOperation::NonBlockingLockShared).is_err()
}

/// Every owner draws another.
fn token_in(directory: &Path) -> Option<String> {
    fs::read_to_string(directory.join(TOKEN)).ok()
}

/// The channels that the run `name` takes from programs of other makers; `None` where no such run is at work yet.
///
/// # Errors
/// Where the name is refused, or the file cannot be read.
pub fn invited(name: &str) -> Result<Option<Vec<String>>, IpcError> {
    let directory = instance_directory(name)?;
    let file = directory.join(FILE);
    match fs::read_to_string(&file) {
        Ok(text) if has_owner(&directory) => Ok(Some(text.lines().map(str::to_owned).collect())),
        Ok(_) => Ok(None),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(IpcError::Directory { path: file.display().to_string(), problem: e.to_string() }),
    }
}

/// Shows an external program whether the run that it joined still exists.
#[derive(Debug, Clone)]
pub struct Host {
    directory: PathBuf,
    token: Option<String>,
}

impl Host {
    /// Of a run that was joined.
    pub fn of(instance: &Instance) -> Self {
        let directory = instance.directory().to_owned();
        Host { token: token_in(&directory), directory }
    }

    /// False once the run has ended, was killed, or another has begun in its place.
    pub fn is_there(&self) -> bool {
        token_in(&self.directory) == self.token && has_owner(&self.directory)
    }
}

impl Instance {
    /// Says that the run is at work and takes these channels from programs of other makers.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn invite(&self, channels: &[&str]) -> Result<(), IpcError> {
        let file = self.directory().join(FILE);
        let lines: String = channels.iter().map(|channel| format!("{channel}\n")).collect();
        let written = super::write_whole(&file, |to| to.write_all(lines.as_bytes()));
        written.map_err(|e| IpcError::Directory { path: file.display().to_string(), problem: e.to_string() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_is_found_from_its_invitation_to_its_end() {
        let name = format!("out{}", std::process::id() % 1_000_000);
        assert_eq!(invited(&name).unwrap(), None);
        let run = Instance::own(&name).unwrap();
        assert_eq!(invited(&name).unwrap(), None, "its processes are not at work yet");
        run.invite(&["blobs", "pedal"]).unwrap();
        assert_eq!(invited(&name).unwrap(), Some(vec!["blobs".into(), "pedal".into()]));
        let joined = Instance::join(&name).unwrap();
        let host = Host::of(&joined);
        assert!(host.is_there());
        drop(run);
        assert!(!host.is_there() && invited(&name).unwrap().is_none());
        let _next = Instance::own(&name).unwrap();
        assert!(!host.is_there(), "another run under the same name");
    }

    #[test]
    fn what_a_killed_launcher_left_invites_nobody() {
        let name = format!("dead{}", std::process::id() % 1_000_000);
        let run = Instance::own(&name).unwrap();
        run.invite(&["blobs"]).unwrap();
        let file = run.directory().join(FILE);
        let left = fs::read_to_string(&file).unwrap();
        let directory = run.directory().to_owned();
        drop(run);
        fs::create_dir(&directory).unwrap();
        fs::write(&file, left).unwrap();
        fs::write(directory.join(LOCK), "").unwrap();
        assert_eq!(invited(&name).unwrap(), None);
        fs::remove_dir_all(directory).unwrap();
    }
}
