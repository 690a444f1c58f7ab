//! The shared-memory files of an instance: found by their prefix, reserved, and removed.
//!
//! iceoryx2 makes files with holes. A page that is first written when the memory of the machine, or
//! of `/dev/shm`, is used up ends a process by SIGBUS; so every page is taken while a port is
//! opened, where a shortage is an error like any other.

use super::IpcError;
use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;
use std::fs::{self, Metadata, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// Where shared memory lives.
pub(super) const SHM: &str = "/dev/shm";
/// Shared memory that a run takes, MiB: 60 with the picture of `peel`, 84 with that of `vitrectomy`,
/// the largest shipped scene; besides them what a restarted process is given.
pub(super) const NEEDED_MIB: u64 = 96;
/// Room for the heads of the files of a port, MiB.
const HEADS_MIB: u64 = 1;
/// Unit of [`MetadataExt::blocks`], bytes.
const BLOCK: u64 = 512;

/// The files of one instance.
pub(super) struct Segments {
    prefix: String,
}

impl Segments {
    /// Those of the instance with this token.
    pub(super) fn new(token: &str) -> Self {
        Segments { prefix: format!("vitreo_{token}_") }
    }

    /// What their names begin with.
    pub(super) fn prefix(&self) -> &str {
        &self.prefix
    }

    fn files(&self) -> impl Iterator<Item = PathBuf> {
        let entries = fs::read_dir(SHM).into_iter().flatten().flatten();
        entries.filter(|e| e.file_name().to_string_lossy().starts_with(&self.prefix)).map(|e| e.path())
    }

    /// What the paths of its files begin with; `None` where there are none.
    pub(super) fn common_path(&self) -> Option<PathBuf> {
        self.files().next().map(|_| Path::new(SHM).join(&self.prefix))
    }

    /// Asks for the shared memory of a whole run.
    pub(super) fn check_free_space(&self) -> Result<(), IpcError> {
        let free_mib = free_mib();
        if free_mib < NEEDED_MIB {
            return Err(IpcError::SharedMemoryFull { free_mib, needed_mib: NEEDED_MIB });
        }
        Ok(())
    }

    /// Takes the memory of every file that has holes. One that is being made is reserved by its
    /// maker; one of somebody else cannot be opened and is left.
    pub(super) fn reserve(&self) -> Result<(), IpcError> {
        for file in self.files() {
            let Ok(meta) = fs::metadata(&file) else { continue };
            if meta.blocks() * BLOCK >= meta.len() {
                continue;
            }
            let Ok(open) = fs::File::options().read(true).write(true).open(&file) else { continue };
            let reserved = fallocate(&open, FallocateFlags::empty(), 0, meta.len());
            // A system that cannot reserve runs as well, as long as there is memory.
            if let Err(Errno::NOSPC | Errno::NOMEM) = reserved {
                let needed_mib = (meta.len() - meta.blocks() * BLOCK).div_ceil(1 << 20);
                return Err(IpcError::SharedMemoryFull { free_mib: free_mib(), needed_mib });
            }
        }
        Ok(())
    }

    /// To be asked before anything is made: refuses where not even the heads of files have room,
    /// which iceoryx2 writes while it makes them, and a file of somebody else, on which it would
    /// wait.
    pub(super) fn check(&self) -> Result<(), IpcError> {
        let free_mib = free_mib();
        if free_mib < HEADS_MIB {
            return Err(IpcError::SharedMemoryFull { free_mib, needed_mib: HEADS_MIB });
        }
        let own = rustix::process::getuid().as_raw();
        for file in self.files() {
            if let Some(meta) = fs::symlink_metadata(&file).ok().filter(|m| m.uid() != own) {
                let problem = format!("belongs to {}; remove it, or have it removed", owner_of(&meta));
                return Err(IpcError::Directory { path: file.display().to_string(), problem });
            }
        }
        Ok(())
    }

    /// iceoryx2 opens its management segment to every user, who could then block new nodes by
    /// writing to it. No other program has a reason to use them.
    pub(super) fn close_to_others(&self) {
        // Other segments are private from the start, and their mode marks whether they are ready.
        for file in self.files().filter(|f| f.extension().is_some_and(|e| e == "global_mgmt")) {
            let _ = fs::set_permissions(file, Permissions::from_mode(0o600));
        }
    }

    /// Removes all of them, as far as they can be removed.
    pub(super) fn remove(&self) {
        self.files().for_each(|file| drop(fs::remove_file(file)));
    }
}

fn free_mib() -> u64 {
    rustix::fs::statvfs(SHM).map_or(u64::MAX, |vfs| (vfs.f_bavail * vfs.f_frsize) >> 20)
}

/// The owner of a file, for a person.
pub(super) fn owner_of(meta: &Metadata) -> String {
    let uid = meta.uid().to_string();
    let users = fs::read_to_string(Path::new("/etc/passwd")).unwrap_or_default();
    let name = users.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)? == uid).then(|| name.to_owned())
    });
    name.unwrap_or_else(|| format!("user {uid}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Instance, Queue};
    use protocol::poses::TrackerFrame;

    #[test]
    fn every_page_of_a_port_is_taken_when_it_is_open() {
        let instance = Instance::own(&format!("res{}", std::process::id() % 1_000_000)).unwrap();
        let _sender = instance.sender::<TrackerFrame>().unwrap();
        let _receiver = instance.receiver::<TrackerFrame>(Queue::InOrder).unwrap();
        let token = fs::read_to_string(instance.directory().join("token")).unwrap();
        let files: Vec<Metadata> = Segments::new(&token).files().map(|f| fs::metadata(f).unwrap()).collect();
        let largest = files.iter().map(Metadata::len).max().unwrap();
        assert!(largest > 1 << 20, "the segment of the poses, found {largest} bytes");
        let holes = files.iter().filter(|m| m.blocks() * BLOCK < m.len()).count();
        assert_eq!(holes, 0, "of {} files", files.len());
    }

    #[test]
    fn owners_are_named() {
        let meta = fs::metadata("/").unwrap();
        assert_eq!(owner_of(&meta), "root");
    }
}
