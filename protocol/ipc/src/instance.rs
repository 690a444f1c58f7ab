//! The private directory of one simulator, and the node of this process in it.

use super::open_limit::OpenLimit;
use super::port::{Channel, Ports, ReceivePort, SendPort, Service};
use super::segments::{SHM, Segments, owner_of};
use super::wake::Listener;
use super::{IpcError, transport};
use iceoryx2::prelude::*;
use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path as StdPath, PathBuf};

/// Longest instance name; longer root paths fail inside iceoryx2.
const MAX_NAME: usize = 18;
/// File in the directory that holds the token by which the instance's segments are called.
pub(super) const TOKEN: &str = "token";
/// File in the directory that its owner holds locked.
pub(super) const LOCK: &str = "owner.lock";

/// This process's place in a simulator.
pub struct Instance {
    name: String,
    directory: PathBuf,
    segments: Segments,
    node: Box<dyn Ports>,
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

impl Instance {
    /// Joins the instance `name`, making its directory where it does not exist.
    ///
    /// # Errors
    /// Where the name or the directory is refused, or shared memory is full.
    pub fn join(name: &str) -> Result<Self, IpcError> {
        let directory = instance_directory(name)?;
        make_private(&directory)?;
        let segments = Segments::new(&token(&directory)?);
        Self::open(name, directory, segments, None)
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
        let io = |e: std::io::Error| refused_by_system(&directory, &e);
        let lock = fs::File::create(directory.join(LOCK)).map_err(io)?;
        super::outside::lock_for_owner(&lock).map_err(|_| IpcError::InUse(name.into()))?;
        remove_contents(&directory, false);
        let segments = Segments::new(&token(&directory)?);
        segments.check_free_space()?;
        let ownership = Ownership { directory: directory.clone(), _lock: lock };
        Self::open(name, directory, segments, Some(ownership))
    }

    fn open(
        name: &str,
        directory: PathBuf,
        segments: Segments,
        ownership: Option<Ownership>,
    ) -> Result<Self, IpcError> {
        segments.check()?;
        let _limit = OpenLimit::start("node", &directory);
        set_log_level(LogLevel::Fatal);
        let mut config = Config::default();
        let path = directory.as_os_str().as_encoded_bytes();
        config.global.set_root_path(&Path::new(path).map_err(transport("node", "open"))?);
        let prefix = FileName::new(segments.prefix().as_bytes());
        config.global.prefix = prefix.map_err(transport("node", "open"))?;
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Service>()
            .map_err(transport("node", "open"))?;
        segments.close_to_others();
        Ok(Self { name: name.into(), directory, segments, node: Box::new(node), _ownership: ownership })
    }

    /// Opens the sending side of a channel of at most `capacity` bytes a block.
    pub(super) fn open_sender(
        &self,
        channel: &Channel,
        capacity: usize,
    ) -> Result<Box<dyn SendPort>, IpcError> {
        let _limit = OpenLimit::start(channel.name, &self.directory);
        // A port may wait long for what somebody else left, and end by a signal where there is no
        // room.
        self.segments.check()?;
        let port = self.node.sender(channel, capacity)?;
        // None of its memory can be missing later.
        self.segments.reserve()?;
        Ok(port)
    }

    /// Opens the receiving side, which keeps `depth` blocks, with what wakes it.
    pub(super) fn open_receiver(
        &self,
        channel: &Channel,
        depth: usize,
    ) -> Result<(Box<dyn ReceivePort>, Listener), IpcError> {
        let _limit = OpenLimit::start(channel.name, &self.directory);
        self.segments.check()?;
        let port = self.node.receiver(channel, depth)?;
        let listener = self.node.listener(channel.name)?;
        self.segments.reserve()?;
        Ok((port, listener))
    }

    #[cfg(test)]
    pub(super) fn ports(&self) -> &dyn Ports {
        &*self.node
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
        self.node.clean_up_after_the_dead();
    }
}

fn directory_error(path: &StdPath, problem: String) -> IpcError {
    IpcError::Directory { path: path.display().to_string(), problem }
}

/// The system's answer; where shared memory is full, with how much is needed.
fn refused_by_system(path: &StdPath, problem: &io::Error) -> IpcError {
    if problem.kind() == ErrorKind::StorageFull {
        let needed_mib = super::segments::NEEDED_MIB;
        return IpcError::SharedMemoryFull { free_mib: 0, needed_mib };
    }
    directory_error(path, problem.to_string())
}

/// Makes the directory for the owner only, or checks that it is so.
fn make_private(directory: &StdPath) -> Result<(), IpcError> {
    let fail = |problem: String| directory_error(directory, problem);
    match fs::DirBuilder::new().mode(0o700).create(directory) {
        Ok(()) => return Ok(()),
        Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
        Err(e) => return Err(refused_by_system(directory, &e)),
    }
    let meta = fs::symlink_metadata(directory).map_err(|e| refused_by_system(directory, &e))?;
    if meta.uid() != rustix::process::getuid().as_raw() {
        return Err(fail(format!("belongs to {}; choose another --instance NAME", owner_of(&meta))));
    }
    if !meta.is_dir() || meta.mode() & 0o077 != 0 {
        return Err(fail("exists, but is not a private directory of this user".into()));
    }
    Ok(())
}

/// The token of the instance, which no other user can guess: drawn by the first process, and kept in
/// the private directory for those who join.
fn token(directory: &StdPath) -> Result<String, IpcError> {
    let file = directory.join(TOKEN);
    let drawn = directory.join(format!("{TOKEN}-{}", std::process::id()));
    let draw = || -> io::Result<String> {
        if !file.exists() {
            let mut bytes = [0; 8];
            fs::File::open("/dev/urandom")?.read_exact(&mut bytes)?;
            let mut out =
                fs::File::options().write(true).create(true).truncate(true).mode(0o600).open(&drawn)?;
            write!(out, "{:016x}", u64::from_ne_bytes(bytes))?;
            // Whole or not at all; another's that came first stays.
            let linked = fs::hard_link(&drawn, &file);
            fs::remove_file(&drawn)?;
            linked.or_else(|e| if e.kind() == ErrorKind::AlreadyExists { Ok(()) } else { Err(e) })?;
        }
        fs::read_to_string(&file)
    };
    let text = draw().map_err(|e| refused_by_system(directory, &e))?;
    let is_token = text.len() == 16 && text.bytes().all(|b| b.is_ascii_hexdigit());
    is_token.then_some(text).ok_or_else(|| directory_error(&file, "holds no token".into()))
}

/// What the paths of an instance's files in shared memory begin with; `None` where it has none.
pub fn shared_memory_prefix(directory: &StdPath) -> Option<PathBuf> {
    let token = fs::read_to_string(directory.join(TOKEN)).ok()?;
    Segments::new(&token).common_path()
}

/// Removes the files of an instance, and with `and_itself` its directory. What cannot be removed
/// is left: the next owner tries again.
fn remove_contents(directory: &StdPath, and_itself: bool) {
    if let Ok(token) = fs::read_to_string(directory.join(TOKEN)) {
        Segments::new(&token).remove();
    }
    for entry in fs::read_dir(directory).into_iter().flatten().flatten() {
        let path = entry.path();
        let is_dir = entry.file_type().is_ok_and(|t| t.is_dir());
        if is_dir {
            let _ = fs::remove_dir_all(path);
        } else if and_itself || entry.file_name() != LOCK {
            let _ = fs::remove_file(path);
        }
    }
    if and_itself {
        let _ = fs::remove_dir(directory);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_shared_memory_is_told_with_figures_wherever_it_is_noticed() {
        let full = refused_by_system(StdPath::new("/dev/shm/x"), &ErrorKind::StorageFull.into()).to_string();
        assert!(full.contains("MiB are needed") && full.contains("remount"), "{full}");
        let other = refused_by_system(StdPath::new("/dev/shm/x"), &ErrorKind::PermissionDenied.into());
        assert!(other.to_string().starts_with("shared memory directory /dev/shm/x"), "{other}");
    }

    fn name(what: &str) -> String {
        format!("{what}{}", std::process::id() % 1_000_000)
    }

    #[test]
    fn the_prefix_is_drawn_anew_by_every_owner_and_found_by_those_who_join() {
        let name = name("tok");
        let prefix = |instance: &Instance| instance.segments.prefix().to_owned();
        let owner = Instance::own(&name).unwrap();
        let first = prefix(&owner);
        assert_eq!(prefix(&Instance::join(&name).unwrap()), first);
        drop(owner);
        let second = prefix(&Instance::own(&name).unwrap());
        assert_ne!(first, second, "nobody can know it beforehand");
    }

    #[test]
    fn who_joins_before_an_owner_and_after_each_other_meet() {
        let name = name("pre");
        let (one, two) = (Instance::join(&name).unwrap(), Instance::join(&name).unwrap());
        assert_eq!(one.segments.prefix(), two.segments.prefix());
        drop((one, two));
        drop(Instance::own(&name).unwrap());
        assert!(!instance_directory(&name).unwrap().exists());
    }

    #[test]
    fn the_directory_of_somebody_else_is_refused_at_once_by_its_owner() {
        let directory = instance_directory(&name("oth")).unwrap();
        fs::create_dir(&directory).unwrap();
        if std::os::unix::fs::chown(&directory, Some(65534), None).is_err() {
            fs::remove_dir(&directory).unwrap();
            return skips::skip(&"only root can give a directory away");
        }
        let told = Instance::own(&name("oth")).err().unwrap().to_string();
        fs::remove_dir(&directory).unwrap();
        assert!(told.contains("belongs to nobody") || told.contains("belongs to user 65534"), "{told}");
        assert!(told.contains(&directory.display().to_string()), "{told}");
    }

    #[test]
    fn a_segment_of_somebody_else_is_refused_at_once_by_its_owner() {
        let instance = Instance::own(&name("seg")).unwrap();
        let file = StdPath::new(SHM).join(format!("{}x.data", instance.segments.prefix()));
        fs::write(&file, "").unwrap();
        if std::os::unix::fs::chown(&file, Some(65534), None).is_err() {
            fs::remove_file(&file).unwrap();
            return skips::skip(&"only root can give a file away");
        }
        let told = instance.sender::<protocol::control::Request>().err().unwrap().to_string();
        fs::remove_file(&file).unwrap();
        assert!(told.contains(&file.display().to_string()) && told.contains("belongs to"), "{told}");
    }
}
