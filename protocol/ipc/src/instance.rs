//! The private directory of one simulator, and the node of this process in it.

use super::{IpcError, transport};
use iceoryx2::prelude::*;
use protocol::message::fnv1a;
use std::fs;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path as StdPath, PathBuf};

/// Where shared memory lives.
const SHM: &str = "/dev/shm";
/// Longest instance name; longer root paths fail inside iceoryx2.
const MAX_NAME: usize = 18;
/// Free shared memory asked for before anything is created, MiB: too little would end in SIGBUS.
const NEEDED_MIB: u64 = 96;

pub(super) type Service = ipc::Service;

/// This process's place in a simulator.
pub struct Instance {
    name: String,
    directory: PathBuf,
    pub(super) node: Node<Service>,
    /// Held by the launcher for as long as the simulator runs. The last field, so that the node has
    /// written its last when the directory is taken away.
    _ownership: Option<Ownership>,
}

/// Takes the directory and its shared memory away when dropped; by then its processes have ended.
struct Ownership {
    directory: PathBuf,
    _lock: fs::File,
}

impl Drop for Ownership {
    fn drop(&mut self) {
        remove_contents(&self.directory, true);
    }
}

/// The directory of an instance: `/dev/shm/vitreo-<uid>-<name>`.
///
/// # Errors
/// Where the name is refused.
pub fn instance_directory(name: &str) -> Result<PathBuf, IpcError> {
    let allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
    if name.is_empty() || name.len() > MAX_NAME || !name.chars().all(allowed) {
        return Err(IpcError::InstanceName(name.into()));
    }
    let uid = rustix::process::getuid().as_raw();
    Ok(StdPath::new(SHM).join(format!("vitreo-{uid}-{name}")))
}

/// Prefix of the shared-memory files of an instance, unique by user and name.
fn prefix(directory: &StdPath) -> String {
    format!("vitreo_{:016x}_", fnv1a(directory.as_os_str().as_encoded_bytes()))
}

impl Instance {
    /// Joins the instance `name`, making its directory where it does not exist.
    ///
    /// # Errors
    /// Where the name or the directory is refused, or shared memory is full.
    pub fn join(name: &str) -> Result<Self, IpcError> {
        let directory = instance_directory(name)?;
        make_private(&directory)?;
        Self::open(name, directory, None)
    }

    /// Owns the instance `name`: refuses where another owner runs, and removes what a dead one
    /// left.
    ///
    /// # Errors
    /// Where another simulator runs under this name, the name or the directory is refused, or
    /// shared memory is full.
    pub fn own(name: &str) -> Result<Self, IpcError> {
        let directory = instance_directory(name)?;
        make_private(&directory)?;
        let io = |e: std::io::Error| directory_error(&directory, e.to_string());
        let lock = fs::File::create(directory.join("owner.lock")).map_err(io)?;
        if rustix::fs::flock(&lock, rustix::fs::FlockOperation::NonBlockingLockExclusive).is_err() {
            return Err(IpcError::InUse(name.into()));
        }
        remove_contents(&directory, false);
        let ownership = Ownership { directory: directory.clone(), _lock: lock };
        Self::open(name, directory, Some(ownership))
    }

    fn open(name: &str, directory: PathBuf, ownership: Option<Ownership>) -> Result<Self, IpcError> {
        check_free_space()?;
        set_log_level(LogLevel::Fatal);
        let mut config = Config::default();
        let path = directory.as_os_str().as_encoded_bytes();
        config.global.set_root_path(&Path::new(path).map_err(transport("node", "open"))?);
        config.global.prefix =
            FileName::new(prefix(&directory).as_bytes()).map_err(transport("node", "open"))?;
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Service>()
            .map_err(transport("node", "open"))?;
        close_to_others(&directory);
        Ok(Self { name: name.into(), directory, node, _ownership: ownership })
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its private directory, for small files between launcher and processes.
    pub fn directory(&self) -> &StdPath {
        &self.directory
    }

    /// Frees what dead processes of this instance held.
    pub fn clean_up_after_the_dead(&self) {
        self.node.try_cleanup_dead_nodes();
    }
}

fn directory_error(path: &StdPath, problem: String) -> IpcError {
    IpcError::Directory { path: path.display().to_string(), problem }
}

/// Makes the directory for the owner only, or checks that it is so.
fn make_private(directory: &StdPath) -> Result<(), IpcError> {
    let fail = |problem: String| directory_error(directory, problem);
    match fs::DirBuilder::new().mode(0o700).create(directory) {
        Ok(()) => return Ok(()),
        Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
        Err(e) => return Err(fail(e.to_string())),
    }
    let meta = fs::symlink_metadata(directory).map_err(|e| fail(e.to_string()))?;
    if !meta.is_dir() || meta.uid() != rustix::process::getuid().as_raw() || meta.mode() & 0o077 != 0 {
        return Err(fail("exists, but is not a private directory of this user".into()));
    }
    Ok(())
}

fn check_free_space() -> Result<(), IpcError> {
    let Ok(vfs) = rustix::fs::statvfs(SHM) else { return Ok(()) };
    let free_mib = (vfs.f_bavail * vfs.f_frsize) >> 20;
    if free_mib < NEEDED_MIB {
        return Err(IpcError::SharedMemoryFull { free_mib, needed_mib: NEEDED_MIB });
    }
    Ok(())
}

/// The files of an instance in shared memory.
fn shared_files(directory: &StdPath) -> impl Iterator<Item = PathBuf> {
    let prefix = prefix(directory);
    let entries = fs::read_dir(SHM).into_iter().flatten().flatten();
    entries.filter(move |e| e.file_name().to_string_lossy().starts_with(&prefix)).map(|e| e.path())
}

/// What the paths of an instance's files in shared memory begin with; `None` where it has none.
pub fn shared_memory_prefix(directory: &StdPath) -> Option<PathBuf> {
    let any = shared_files(directory).next().is_some();
    any.then(|| StdPath::new(SHM).join(prefix(directory)))
}

/// iceoryx2 opens its management segment to every user, who could then block new nodes by writing
/// to it. Nobody else has business there. A file of another user cannot be changed and is left.
fn close_to_others(directory: &StdPath) {
    // Other segments are private from the start, and their mode marks whether they are ready.
    for file in shared_files(directory).filter(|f| f.extension().is_some_and(|e| e == "global_mgmt")) {
        let _ = fs::set_permissions(file, fs::Permissions::from_mode(0o600));
    }
}

/// Removes the files of an instance, and with `and_itself` its directory. What cannot be removed
/// is left: the next owner tries again.
fn remove_contents(directory: &StdPath, and_itself: bool) {
    for file in shared_files(directory) {
        let _ = fs::remove_file(file);
    }
    for entry in fs::read_dir(directory).into_iter().flatten().flatten() {
        let path = entry.path();
        let is_dir = entry.file_type().is_ok_and(|t| t.is_dir());
        if is_dir {
            let _ = fs::remove_dir_all(path);
        } else if and_itself || entry.file_name() != "owner.lock" {
            let _ = fs::remove_file(path);
        }
    }
    if and_itself {
        let _ = fs::remove_dir(directory);
    }
}
