//! What an input costs: the time of each, watched from beside the thread that runs it, and the
//! memory of the process.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// An input must not take longer.
pub const SLOW: Duration = Duration::from_secs(1);
/// An input that takes longer than this ends the process: it may never end by itself.
const HUNG: Duration = Duration::from_secs(20);
/// From one look for that to the next.
const LOOK: Duration = Duration::from_millis(200);
/// Exit code of a process that was ended for that.
pub const HUNG_CODE: i32 = 7;
/// The process must not hold more, bytes.
pub const MOST_MEMORY: u64 = 1 << 30;
/// Address space at which an allocation fails, which ends the process, bytes.
const ADDRESS_SPACE: u64 = 6 << 30;

/// Watches for inputs that do not end.
pub struct Watch {
    begun: Instant,
    /// When the present input began, ns after `begun`; 0 between inputs.
    since_ns: Arc<AtomicU64>,
}

impl Watch {
    /// Starts watching. `present` is the file with the input that runs; where one hangs, it is what
    /// is left of it.
    pub fn start() -> Self {
        let watch = Watch { begun: Instant::now(), since_ns: Arc::default() };
        let since_ns = Arc::downgrade(&watch.since_ns);
        std::thread::spawn(move || {
            // Counted in looks: a process that is stopped for a while looks once.
            let (mut seen_ns, mut looks) = (0, 0);
            while let Some(since_ns) = since_ns.upgrade().map(|s| s.load(Ordering::Relaxed)) {
                looks = if since_ns > 0 && since_ns == seen_ns { looks + 1 } else { 0 };
                seen_ns = since_ns;
                if LOOK * looks > HUNG {
                    std::process::exit(HUNG_CODE);
                }
                std::thread::sleep(LOOK);
            }
        });
        watch
    }

    /// An input begins.
    #[inline]
    pub fn begin(&self) -> Duration {
        self.since_ns.store(self.begun.elapsed().as_nanos() as u64 + 1, Ordering::Relaxed);
        computed()
    }

    /// It has ended; how long this thread computed for it.
    #[inline]
    pub fn end(&self, begin: Duration) -> Duration {
        self.since_ns.store(0, Ordering::Relaxed);
        computed().saturating_sub(begin)
    }
}

/// How long this thread has computed: what others do on the machine is not in it.
fn computed() -> Duration {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
}

/// Bounds the memory of this process, so that a runaway allocation ends it and not the machine.
pub fn bound_memory() {
    let bound = rustix::process::Rlimit { current: Some(ADDRESS_SPACE), maximum: Some(ADDRESS_SPACE) };
    let _ = rustix::process::setrlimit(rustix::process::Resource::As, bound);
}

/// Most memory that this process has held so far, bytes.
pub fn peak_memory() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    let kib = line.and_then(|l| l.split_whitespace().next()?.parse::<u64>().ok());
    kib.unwrap_or(0) << 10
}

/// The file in which the input stands that runs, so that it is there when the process is not.
pub struct Present {
    file: Option<std::fs::File>,
}

impl Present {
    /// In this folder.
    pub fn in_folder(folder: &Path) -> Self {
        Present { file: std::fs::File::create(Self::path(folder)).ok() }
    }

    /// Where it stands.
    pub fn path(folder: &Path) -> PathBuf {
        folder.join("present")
    }

    /// Notes an input.
    pub fn note(&self, input: &[u8]) {
        use std::os::unix::fs::FileExt;
        if let Some(file) = &self.file {
            let length = (input.len() as u64).to_le_bytes();
            let _ = file.write_all_at(input, 8).and_then(|()| file.write_all_at(&length, 0));
        }
    }

    /// What was noted last.
    pub fn read(folder: &Path) -> Option<Vec<u8>> {
        let bytes = std::fs::read(Self::path(folder)).ok()?;
        let (length, rest) = bytes.split_first_chunk::<8>()?;
        rest.get(..u64::from_le_bytes(*length) as usize).map(<[u8]>::to_vec)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_present_input_is_there_for_others() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Present::read(folder.path()), None);
        let present = Present::in_folder(folder.path());
        for input in [&b"long one"[..], b"short", b""] {
            present.note(input);
            assert_eq!(Present::read(folder.path()).unwrap(), input);
        }
        assert!(peak_memory() > 1 << 20);
    }
}
