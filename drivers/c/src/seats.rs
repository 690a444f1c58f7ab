//! One driver a channel: who sends on it holds its seat, a locked file in the directory of the run.
//!
//! The lock is one of the process (`fcntl`), which the kernel gives back however the process ends, and which its
//! children do not inherit: a killed driver can be replaced at once. It does not divide the threads of one process;
//! for those there is a list.

use crate::code::{Code, Failure, failure};
use ipc::Instance;
use rustix::fs::{FlockOperation, fcntl_lock};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, Write};
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A process that is being killed gives its locks back when it is torn down: they are asked for again.
const TRIES: u32 = 25;
/// Time between two tries.
const BETWEEN: Duration = Duration::from_millis(10);
/// Bytes read of the holder's words, at most.
const MAX_WORDS: u64 = 256;

/// Seats of this program, and who holds each. A forked child finds those of its parent here, which are not its own.
static OWN: Mutex<BTreeMap<(u32, PathBuf), String>> = Mutex::new(BTreeMap::new());

fn own() -> MutexGuard<'static, BTreeMap<(u32, PathBuf), String>> {
    OWN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The right to send on a channel, until it is dropped.
#[derive(Debug)]
pub(crate) struct Seat {
    key: (u32, PathBuf),
    _locked: File,
}

impl Drop for Seat {
    fn drop(&mut self) {
        own().remove(&self.key);
    }
}

impl Seat {
    /// Takes the seat of `channel` in a run for the driver `name`.
    ///
    /// # Errors
    /// Where another driver has it, who is named, or the file cannot be written.
    pub(crate) fn take(run: &Instance, channel: &str, name: &str) -> Result<Self, Failure> {
        let path = run.directory().join(format!("{channel}.driver"));
        let taken = |holder: &str| {
            let holder = if holder.is_empty() { "another driver" } else { holder };
            let text =
                format!("the run '{}' takes its {channel} from {holder}: end that one first", run.name());
            failure(Code::Taken, text)
        };
        let system =
            |problem: &dyn std::fmt::Display| failure(Code::System, format!("{}: {problem}", path.display()));
        let pid = std::process::id();
        let key = (pid, path.clone());
        // Held to the end: a file that this process has open twice loses its lock with the first that is closed.
        let mut own = own();
        if let Some(holder) = own.get(&key) {
            return Err(taken(holder));
        }
        let opened = File::options().read(true).write(true).create(true).truncate(false).open(&path);
        let mut file = opened.map_err(|e| system(&e))?;
        if !lock(&file).map_err(|e| system(&e))? {
            let mut holder = String::new();
            // Words that are no text name nobody.
            let _ = file.take(MAX_WORDS).read_to_string(&mut holder);
            return Err(taken(&holder));
        }
        let holder = format!("the driver '{name}' (process {pid})");
        let written =
            file.set_len(0).and_then(|()| file.rewind()).and_then(|()| file.write_all(holder.as_bytes()));
        written.map_err(|e| system(&e))?;
        own.insert(key.clone(), holder);
        Ok(Seat { key, _locked: file })
    }
}

/// Locks the file; false where another process has it.
fn lock(file: &File) -> rustix::io::Result<bool> {
    for attempt in 1..=TRIES {
        match fcntl_lock(file, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => return Ok(true),
            Err(rustix::io::Errno::AGAIN | rustix::io::Errno::ACCESS) if attempt == TRIES => {}
            Err(rustix::io::Errno::AGAIN | rustix::io::Errno::ACCESS) => std::thread::sleep(BETWEEN),
            Err(error) => return Err(error),
        }
    }
    Ok(false)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_channel_has_one_driver_until_that_one_leaves() {
        let run = Instance::own(&format!("seat{}", std::process::id() % 1_000_000)).unwrap();
        let first = Seat::take(&run, "blobs", "left").unwrap();
        let refused = Seat::take(&run, "blobs", "right").unwrap_err();
        let named = format!("takes its blobs from the driver 'left' (process {})", std::process::id());
        assert!(refused.code == Code::Taken && refused.text.contains(&named), "{refused}");
        let _pedal = Seat::take(&run, "pedal", "right").unwrap();
        drop(first);
        let second = Seat::take(&run, "blobs", "right").unwrap();
        assert!(Seat::take(&run, "blobs", "left").unwrap_err().text.contains("'right'"));
        drop(second);
    }
}
