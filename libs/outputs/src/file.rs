//! Output files under a temporary name, which get their own name when complete ([`OutputFile`]) or when the
//! run has begun ([`GrowingFile`]).

use super::claim::{is_being_written, is_device};
use super::{OutputError, STDOUT};
use rustix::fs::{FlockOperation, Mode, OFlags, flock};
use rustix::io::Errno;
use std::fs::{self, File, OpenOptions, Permissions};
use std::io::{self, BufWriter, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use tempfile::{Builder, NamedTempFile, PersistError, TempPath};

/// Size of the write buffer, bytes.
const BUFFER: usize = 64 << 10;
/// Timeout for a reader of a named pipe, and the interval of the attempts to open it.
const READER_PATIENCE: Duration = Duration::from_secs(5);
const READER_POLL: Duration = Duration::from_millis(20);

/// A file that gets its name, complete, with [`OutputFile::finish`]; dropping it before leaves no file.
/// Standard output, pipes and devices are written directly.
#[derive(Debug)]
pub struct OutputFile {
    to: BufWriter<Target>,
    path: PathBuf,
}

#[derive(Debug)]
enum Target {
    /// Standard output, a pipe or a device, written directly.
    Direct(File),
    /// A temporary file, renamed to `place` at the end.
    Unnamed { file: NamedTempFile, place: Place },
}

/// Final path of a file.
#[derive(Debug, Clone)]
struct Place {
    /// The path, with links resolved if the file is overwritten.
    path: PathBuf,
    force: bool,
}

impl OutputFile {
    pub(super) fn begin(path: &Path, force: bool) -> Result<Self, OutputError> {
        let target = match direct(path)? {
            Some(file) => Target::Direct(file),
            None => {
                let place = Place::of(path, force);
                Target::Unnamed { file: place.temporary()?, place }
            }
        };
        Ok(OutputFile { to: BufWriter::with_capacity(BUFFER, target), path: path.into() })
    }

    /// Writes the buffered rest and gives the file its name.
    ///
    /// # Errors
    /// If the file cannot be written, or a file of its name was created in the meantime.
    pub fn finish(self) -> Result<(), OutputError> {
        let OutputFile { to, path } = self;
        let target = to.into_inner().map_err(|e| OutputError::io(&path, e.into_error()))?;
        let Target::Unnamed { file, place } = target else { return Ok(()) };
        file.as_file().sync_all().map_err(|e| OutputError::io(&path, e))?;
        let named = if place.force { file.persist(&place.path) } else { file.persist_noclobber(&place.path) };
        named.map_err(|PersistError { error, .. }| place.refused(error))?;
        place.sync_folder();
        Ok(())
    }
}

impl Write for Target {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Target::Direct(file) => file.write(bytes),
            // The writer of `NamedTempFile` would put the temporary name into errors.
            Target::Unnamed { file, .. } => file.as_file_mut().write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.to.write(bytes).map_err(|problem| named(&self.path, problem))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.to.flush().map_err(|problem| named(&self.path, problem))
    }
}

impl io::Seek for OutputFile {
    fn seek(&mut self, to: io::SeekFrom) -> io::Result<u64> {
        self.to.flush()?;
        match self.to.get_mut() {
            Target::Direct(file) => file.seek(to),
            Target::Unnamed { file, .. } => file.as_file_mut().seek(to),
        }
    }
}

/// Lets `write` write the file, then finishes it.
///
/// # Errors
/// The errors of `write` and of [`OutputFile::finish`].
pub fn save<E: From<OutputError>>(
    mut file: OutputFile,
    write: impl FnOnce(&mut OutputFile) -> Result<(), E>,
) -> Result<(), E> {
    write(&mut file)?;
    Ok(file.finish()?)
}

/// A file that is written during a run. It gets its name with [`GrowingFile::appear`]; dropping it before
/// leaves no file. While it is open it is locked, and other commands do not overwrite it.
#[derive(Debug)]
pub struct GrowingFile {
    file: File,
    /// Temporary path and final path, until the file gets its name; `None` afterwards, and for pipes and
    /// devices.
    unnamed: Option<(TempPath, Place)>,
    path: PathBuf,
}

impl GrowingFile {
    pub(super) fn begin(path: &Path, force: bool) -> Result<Self, OutputError> {
        if let Some(file) = direct(path)? {
            return Ok(GrowingFile { file, unnamed: None, path: path.into() });
        }
        let place = Place::of(path, force);
        let (file, temporary) = place.temporary()?.into_parts();
        // On file systems without locks the file is unprotected.
        let _ = flock(&file, FlockOperation::NonBlockingLockExclusive);
        Ok(GrowingFile { file, unnamed: Some((temporary, place)), path: path.into() })
    }

    /// The file's final path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Makes the file readable only by its owner, because trainees' attempts are private.
    ///
    /// # Errors
    /// If the system refuses the permissions.
    pub fn make_private(&self) -> Result<(), OutputError> {
        let Some((_, place)) = &self.unnamed else { return Ok(()) };
        self.file.set_permissions(Permissions::from_mode(0o600)).map_err(|e| place.refused(e))
    }

    /// A handle for writing, at the file's current position. The file stays locked as long as one handle is
    /// open.
    ///
    /// # Errors
    /// If no further handle can be opened.
    pub fn handle(&self) -> Result<File, OutputError> {
        self.file.try_clone().map_err(|e| OutputError::io(&self.path, e))
    }

    /// Gives the file its name, once the run has begun. Later calls do nothing.
    ///
    /// # Errors
    /// If a file of its name was created in the meantime, or another program is writing the file to be
    /// overwritten.
    pub fn appear(&mut self) -> Result<(), OutputError> {
        let Some((temporary, place)) = self.unnamed.take() else { return Ok(()) };
        if place.force && is_being_written(&place.path) {
            return Err(OutputError::InUse { path: self.path.display().to_string() });
        }
        let named = if place.force {
            temporary.persist(&place.path)
        } else {
            temporary.persist_noclobber(&place.path)
        };
        named.map_err(|e| place.refused(e.error))?;
        place.sync_folder();
        Ok(())
    }
}

/// Temporary files of this program. Any left over belong to unfinished files.
static TEMPORARY: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Removes temporary files without a final name, and scratch folders. To be called before the program exits
/// without unwinding.
pub fn remove_unfinished() {
    super::scratch::remove_all();
    let names = TEMPORARY.lock().unwrap_or_else(PoisonError::into_inner);
    names.iter().for_each(|name| drop(fs::remove_file(name)));
}

impl Place {
    fn of(path: &Path, force: bool) -> Self {
        // With `force` the target of a symlink is overwritten, not the link.
        let resolved = if force { path.canonicalize().ok() } else { None };
        Place { path: resolved.unwrap_or_else(|| path.into()), force }
    }

    /// Temporary file beside the destination, whose folder is created if missing.
    fn temporary(&self) -> Result<NamedTempFile, OutputError> {
        let refused = |problem| OutputError::io(&self.path, problem);
        fs::create_dir_all(self.folder()).map_err(refused)?;
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        let mut builder = Builder::new();
        let (prefix, mode) = (format!(".{name}."), Permissions::from_mode(0o666));
        builder.prefix(&prefix).suffix(".part").permissions(mode);
        let file = builder.tempfile_in(self.folder()).map_err(refused)?;
        TEMPORARY.lock().unwrap_or_else(PoisonError::into_inner).push(file.path().into());
        Ok(file)
    }

    fn folder(&self) -> &Path {
        self.path.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."))
    }

    /// Writes the folder entry to disk, where the file system supports it.
    fn sync_folder(&self) {
        let _ = File::open(self.folder()).and_then(|folder| folder.sync_all());
    }

    fn refused(&self, problem: io::Error) -> OutputError {
        match problem.kind() {
            io::ErrorKind::AlreadyExists => OutputError::Exists { path: self.path.display().to_string() },
            _ => OutputError::io(&self.path, problem),
        }
    }
}

/// Adds the file name to a system error, because the callers of [`Write`] do not know it.
fn named(path: &Path, problem: io::Error) -> io::Error {
    io::Error::new(problem.kind(), OutputError::io(path, problem))
}

/// Opens an output that is written without a temporary file: standard output, a pipe, a device. `None` for a
/// regular file.
fn direct(path: &Path) -> Result<Option<File>, OutputError> {
    let refused = |problem| OutputError::io(path, problem);
    if path == Path::new(STDOUT) {
        let descriptor = io::stdout().as_fd().try_clone_to_owned().map_err(refused)?;
        return Ok(Some(descriptor.into()));
    }
    match path.metadata() {
        Ok(found) if found.file_type().is_fifo() => pipe(path).map(Some).map_err(refused),
        Ok(found) if is_device(&found) => {
            OpenOptions::new().write(true).open(path).map(Some).map_err(refused)
        }
        _ => Ok(None),
    }
}

/// Opens a named pipe once a reader has opened it. A blocking `open` would wait for the reader without limit,
/// and could not be interrupted.
fn pipe(path: &Path) -> io::Result<File> {
    let until = Instant::now() + READER_PATIENCE;
    loop {
        let flags = OFlags::WRONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        match rustix::fs::open(path, flags, Mode::empty()) {
            Ok(opened) => {
                rustix::fs::fcntl_setfl(&opened, OFlags::empty())?;
                return Ok(opened.into());
            }
            Err(Errno::NXIO) if Instant::now() < until => std::thread::sleep(READER_POLL),
            Err(Errno::NXIO) => {
                let patience = READER_PATIENCE.as_secs();
                return Err(io::Error::other(format!("a pipe that no program has read for {patience} s")));
            }
            Err(other) => return Err(other.into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Outputs;
    use super::*;

    #[test]
    fn a_pipe_without_a_reader_is_refused_and_one_with_a_reader_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pipe");
        rustix::fs::mknodat(rustix::fs::CWD, &path, rustix::fs::FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)
            .unwrap();
        let told = Outputs::new(false).write(&path, "x").unwrap_err().to_string();
        assert!(told.contains("no program has read"), "{told}");
        let reader = std::thread::spawn({
            let path = path.clone();
            move || fs::read_to_string(path).unwrap()
        });
        Outputs::new(false).write(&path, "whole").unwrap();
        assert_eq!(reader.join().unwrap(), "whole");
    }

    #[test]
    fn a_private_file_is_its_owners_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut file = Outputs::new(false).grow(&path).unwrap();
        file.make_private().unwrap();
        file.appear().unwrap();
        assert_eq!(path.metadata().unwrap().permissions().mode() & 0o777, 0o600);
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap().flatten();
        let mut names: Vec<String> = entries.map(|e| e.file_name().to_string_lossy().into()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_appears_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/folder/a.csv");
        let mut file = Outputs::new(false).create(&path).unwrap();
        file.write_all(b"half").unwrap();
        file.flush().unwrap();
        assert!(!path.exists());
        drop(file);
        assert!(names(path.parent().unwrap()).is_empty(), "nothing is left over");
        Outputs::new(false).write(&path, "whole").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "whole");
        assert_eq!(names(path.parent().unwrap()), ["a.csv"]);
        let umask = rustix::process::umask(rustix::fs::Mode::empty());
        rustix::process::umask(umask);
        assert_eq!(path.metadata().unwrap().permissions().mode() & 0o777, 0o666 & !umask.bits());
    }

    #[test]
    fn a_name_that_was_taken_meanwhile_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let file = Outputs::new(false).create(&path).unwrap();
        let mut grown = Outputs::new(false).grow(&path).unwrap();
        fs::write(&path, "theirs").unwrap();
        assert!(matches!(file.finish(), Err(OutputError::Exists { .. })));
        assert!(matches!(grown.appear(), Err(OutputError::Exists { .. })));
        drop(grown);
        assert_eq!((fs::read_to_string(&path).unwrap().as_str(), names(folder.path()).len()), ("theirs", 1));
    }

    #[test]
    fn force_replaces_what_a_link_leads_to_and_never_a_file_that_grows() {
        let folder = tempfile::tempdir().unwrap();
        let (path, link) = (folder.path().join("a"), folder.path().join("link"));
        let mut grown = Outputs::new(false).grow(&path).unwrap();
        grown.appear().unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        let in_use = Outputs::new(true).create(&link).unwrap_err();
        assert!(matches!(in_use, OutputError::InUse { .. }), "{in_use}");
        drop(grown);
        Outputs::new(true).write(&link, "new").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
        assert!(link.symlink_metadata().unwrap().is_symlink());
    }

    #[test]
    fn a_growing_file_has_no_name_before_it_appears() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        fs::write(&path, "earlier").unwrap();
        let mut grown = Outputs::new(true).grow(&path).unwrap();
        grown.handle().unwrap().write_all(b"later").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "earlier");
        grown.appear().unwrap();
        grown.appear().unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "later");
        grown.handle().unwrap().write_all(b", longer").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "later, longer");
        // A file dropped before it has got its name.
        drop(Outputs::new(false).grow(&folder.path().join("b")).unwrap());
        assert_eq!(names(folder.path()), ["a.mcap"]);
    }

    #[test]
    fn a_full_device_is_told() {
        let full = Outputs::new(false).write(Path::new("/dev/full"), "x").unwrap_err().to_string();
        assert!(full.contains("/dev/full") && full.contains("the disk is full"), "{full}");
    }
}
