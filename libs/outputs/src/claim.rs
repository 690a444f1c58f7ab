//! Checks all inputs and outputs of a command together before anything is written.

use super::{GrowingFile, OutputError, OutputFile, STDOUT};
use rustix::fs::{FlockOperation, flock};
use std::fs::{self, File, Metadata};
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};

/// File names that a command writes into a folder, as pairs of prefix and suffix.
pub type Names = &'static [[&'static str; 2]];
/// Still pictures of a run.
pub const STILLS: Names = &[["frame-", ".png"], ["last", ".png"]];
/// Still pictures of a film, named by their timestamps.
pub const FILM_STILLS: Names = &[["still-", ".png"], ["still-", ".jpg"]];

/// The inputs and outputs of a command.
#[derive(Debug, Clone, Default)]
pub struct Outputs {
    force: bool,
    inputs: Vec<PathBuf>,
    /// Resolved path of each output, and whether writing has begun.
    outputs: Vec<(PathBuf, bool)>,
}

impl Outputs {
    /// Creates an empty set. With `force`, existing files are overwritten.
    pub fn new(force: bool) -> Self {
        Outputs { force, ..Outputs::default() }
    }

    /// Adds an input: a file, or a folder whose files are read. Missing inputs are ignored.
    pub fn reading(mut self, input: impl AsRef<Path>) -> Self {
        self.add_input(input);
        self
    }

    /// Adds an input, as [`Outputs::reading`] does, to an existing set.
    pub fn add_input(&mut self, input: impl AsRef<Path>) {
        self.inputs.push(input.as_ref().to_path_buf());
    }

    /// Adds several inputs, as [`Outputs::reading`] does.
    pub fn reading_all<P: AsRef<Path>>(self, inputs: impl IntoIterator<Item = P>) -> Self {
        inputs.into_iter().fold(self, Outputs::reading)
    }

    /// True if existing files are overwritten.
    pub fn is_forced(&self) -> bool {
        self.force
    }

    /// Checks that `path` may be written, and reserves its name for [`Outputs::create`] or [`Outputs::grow`].
    /// The file system is not changed.
    ///
    /// # Errors
    /// If the file exists (without `force`) or is being written by another program, is a folder, an input or
    /// another output, or if no file can be created in its folder.
    pub fn claim(&mut self, path: &Path) -> Result<(), OutputError> {
        self.note(path)?;
        if path == Path::new(STDOUT) {
            return Ok(());
        }
        let shown = || path.display().to_string();
        self.check_inputs(path)?;
        match path.metadata() {
            Ok(found) if found.is_dir() => {
                Err(OutputError::Kind { path: shown(), expected: "a file, found a folder" })
            }
            Ok(found) if is_device(&found) => Ok(()),
            Ok(_) if !self.force => Err(OutputError::Exists { path: shown() }),
            Ok(_) if is_being_written(path) => Err(OutputError::InUse { path: shown() }),
            // A dangling symlink occupies the name.
            Err(_) if path.symlink_metadata().is_ok() && !self.force => {
                Err(OutputError::Exists { path: shown() })
            }
            _ => check_takes_files(
                path,
                path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")),
            ),
        }
    }

    /// Checks that the files of `names` may be written into the folder `path`, and reserves the folder. Files
    /// of other names may be in it.
    ///
    /// # Errors
    /// If the folder contains files of `names` (without `force`) or an input or another output of such a name, if `path` is a file, an input or another
    /// output, or if no file can be created in it.
    pub fn claim_folder(&mut self, path: &Path, names: Names) -> Result<(), OutputError> {
        self.note(path)?;
        let shown = || path.display().to_string();
        if let Some(input) = self.inputs.iter().find(|i| same_file(i, path) && !(self.force && i.is_dir())) {
            return Err(OutputError::Input { path: shown(), input: input.display().to_string() });
        }
        self.check_entries(path, names)?;
        match path.metadata() {
            Ok(found) if !found.is_dir() => {
                Err(OutputError::Kind { path: shown(), expected: "a folder, found a file" })
            }
            Ok(_) if !self.force => {
                let taken = |found: PathBuf| Err(OutputError::Exists { path: found.display().to_string() });
                entry_of(path, names).map_or_else(|| check_takes_files(path, path), taken)
            }
            _ => check_takes_files(path, path),
        }
    }

    /// Begins a file that gets its name, complete, with [`OutputFile::finish`].
    ///
    /// # Errors
    /// The errors of [`Outputs::claim`], and [`OutputError::Io`] if the file cannot be created.
    pub fn create(&mut self, path: &Path) -> Result<OutputFile, OutputError> {
        self.begin(path)?;
        OutputFile::begin(path, self.force)
    }

    /// Begins a file that gets its name with [`GrowingFile::appear`] and is written further under it.
    ///
    /// # Errors
    /// The errors of [`Outputs::claim`], and [`OutputError::Io`] if the file cannot be created.
    pub fn grow(&mut self, path: &Path) -> Result<GrowingFile, OutputError> {
        self.begin(path)?;
        GrowingFile::begin(path, self.force)
    }

    /// Writes a file in one piece.
    ///
    /// # Errors
    /// The errors of [`Outputs::create`], and [`OutputError::Io`] if the file cannot be written.
    pub fn write(&mut self, path: &Path, contents: impl AsRef<[u8]>) -> Result<(), OutputError> {
        let mut file = self.create(path)?;
        let written = io_write(&mut file, contents.as_ref());
        written.map_err(|problem| OutputError::io(path, problem))?;
        file.finish()
    }

    /// Reserves an output's name; refuses a name that is already reserved.
    fn note(&mut self, path: &Path) -> Result<(), OutputError> {
        let name = resolved(path);
        if self.outputs.iter().any(|(other, _)| *other == name || same_file(other, &name)) {
            return Err(OutputError::Twice { path: path.display().to_string() });
        }
        self.outputs.push((name, false));
        Ok(())
    }

    fn begin(&mut self, path: &Path) -> Result<(), OutputError> {
        let name = resolved(path);
        match self.outputs.iter_mut().find(|(claimed, _)| *claimed == name) {
            Some((_, true)) => Err(OutputError::Twice { path: path.display().to_string() }),
            Some((_, begun)) => {
                *begun = true;
                Ok(())
            }
            None => {
                self.claim(path)?;
                self.outputs.iter_mut().filter(|(claimed, _)| *claimed == name).for_each(|o| o.1 = true);
                Ok(())
            }
        }
    }

    /// Refuses a folder in which a file of `names` is an input, under any name, or another output.
    fn check_entries(&self, folder: &Path, names: Names) -> Result<(), OutputError> {
        for entry in entries_of(folder, names) {
            if let Some(input) = self.inputs.iter().find(|input| same_file(input, &entry)) {
                let [path, input] = [&entry, input].map(|p| p.display().to_string());
                return Err(OutputError::Input { path, input });
            }
        }
        let folder = resolved(&folder.join("entry"));
        let is_named = |path: &&PathBuf| {
            path.parent() == folder.parent()
                && path.file_name().and_then(|n| n.to_str()).is_some_and(|n| is_of(n, names))
        };
        match self.outputs.iter().map(|(path, _)| path).find(is_named) {
            Some(twice) => Err(OutputError::Twice { path: twice.display().to_string() }),
            None => Ok(()),
        }
    }

    fn check_inputs(&self, path: &Path) -> Result<(), OutputError> {
        let refused = |input: &Path| OutputError::Input {
            path: path.display().to_string(),
            input: input.display().to_string(),
        };
        for input in &self.inputs {
            if same_file(input, path) {
                return Err(refused(input));
            }
            // A folder stands for the files directly in it.
            let files = fs::read_dir(input).into_iter().flatten().flatten().map(|e| e.path());
            if let Some(within) = files.filter(|f| f.is_file()).find(|f| same_file(f, path)) {
                return Err(refused(&within));
            }
        }
        Ok(())
    }
}

fn io_write(file: &mut OutputFile, contents: &[u8]) -> std::io::Result<()> {
    std::io::Write::write_all(file, contents)
}

/// True for a pipe, a socket or a character device (a terminal, `/dev/null`), which are written without being
/// replaced.
pub(super) fn is_device(found: &Metadata) -> bool {
    let kind = found.file_type();
    kind.is_fifo() || kind.is_char_device() || kind.is_socket()
}

/// True if both paths exist and lead to the same file. Pipes and devices are never the same: writing to them
/// overwrites nothing.
fn same_file(a: &Path, b: &Path) -> bool {
    let (Ok(a), Ok(b)) = (a.metadata(), b.metadata()) else { return false };
    !is_device(&a) && (a.dev(), a.ino()) == (b.dev(), b.ino())
}

/// True if another program holds the lock of a growing file.
pub(super) fn is_being_written(path: &Path) -> bool {
    let Ok(file) = File::open(path) else { return false };
    flock(&file, FlockOperation::NonBlockingLockShared).is_err_and(|e| e == rustix::io::Errno::WOULDBLOCK)
}

/// The path with its folder resolved, so that two paths of one file are equal.
fn resolved(path: &Path) -> PathBuf {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    match (folder.canonicalize(), path.file_name()) {
        (Ok(folder), Some(name)) => folder.join(name),
        _ => path.to_path_buf(),
    }
}

/// True if a file name matches one of `names`.
fn is_of(name: &str, names: Names) -> bool {
    names.iter().any(|[begin, end]| name.starts_with(begin) && name.ends_with(end))
}

/// The files of a folder whose names match one of `names`.
fn entries_of(folder: &Path, names: Names) -> impl Iterator<Item = PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .filter(move |entry| entry.file_name().to_str().is_some_and(|name| is_of(name, names)))
        .map(|entry| entry.path())
}

/// The first file of a folder whose name matches one of `names`.
fn entry_of(folder: &Path, names: Names) -> Option<PathBuf> {
    entries_of(folder, names).min()
}

/// Checks that a file can be created in `folder` or, if it does not exist yet, in its nearest existing
/// ancestor. `path` is the output that errors name.
fn check_takes_files(path: &Path, folder: &Path) -> Result<(), OutputError> {
    let absolute = std::path::absolute(folder).map_err(|e| OutputError::io(path, e))?;
    let Some(folder) = absolute.ancestors().find(|f| f.symlink_metadata().is_ok()) else {
        return Ok(());
    };
    if !folder.is_dir() {
        return Err(OutputError::io(path, rustix::io::Errno::NOTDIR.into()));
    }
    // Permissions are not sufficient: some file systems refuse files from every user.
    tempfile::tempfile_in(folder).map(drop).map_err(|e| OutputError::io(path, e.kind().into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(result: Result<(), OutputError>) -> String {
        result.unwrap_err().to_string()
    }

    #[test]
    fn an_input_is_no_output_under_any_name() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("a"), "a").unwrap();
        fs::hard_link(at("a"), at("hard")).unwrap();
        std::os::unix::fs::symlink(at("a"), at("soft")).unwrap();
        for force in [false, true] {
            for name in ["a", "hard", "soft", "./a"] {
                let error = text(Outputs::new(force).reading(at("a")).claim(&at(name)));
                assert!(error.contains("is an input of the command"), "{error}");
            }
            // A file of an input folder.
            let error = text(Outputs::new(force).reading(folder.path()).claim(&at("a")));
            assert!(error.contains("is an input of the command"), "{error}");
        }
        Outputs::new(false).reading(at("a")).claim(&at("b")).unwrap();
    }

    #[test]
    fn what_exists_is_refused_without_force() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("a"), "a").unwrap();
        std::os::unix::fs::symlink(at("nowhere"), at("link")).unwrap();
        for name in ["a", "link"] {
            assert!(text(Outputs::new(false).claim(&at(name))).contains("--force"));
            Outputs::new(true).claim(&at(name)).unwrap();
        }
        assert!(text(Outputs::new(true).claim(folder.path())).contains("found a folder"));
        assert!(text(Outputs::new(true).claim_folder(&at("a"), STILLS)).contains("found a file"));
        Outputs::new(true).claim_folder(folder.path(), STILLS).unwrap();
        Outputs::new(false).claim_folder(&at("new"), STILLS).unwrap();
        assert!(!at("new").exists(), "a claim changes nothing");
    }

    #[test]
    fn a_folder_for_stills_is_refused_where_a_name_is_taken_only() {
        let folder = tempfile::tempdir().unwrap();
        for (name, taken) in
            [("run.log", false), ("still-0001.png", false), ("frame-000100.png", true), ("last.png", true)]
        {
            let file = folder.path().join(name);
            fs::write(&file, "").unwrap();
            let claimed = Outputs::new(false).claim_folder(folder.path(), STILLS);
            match taken {
                true => assert!(text(claimed).contains(&format!("{name}: already exists; use --force"))),
                false => claimed.unwrap(),
            }
            Outputs::new(true).claim_folder(folder.path(), STILLS).unwrap();
            fs::remove_file(file).unwrap();
        }
    }

    #[test]
    fn an_input_in_a_folder_of_outputs_is_kept_if_its_name_is_one_of_theirs() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["a.png", "last.png"] {
            fs::write(at(name), "").unwrap();
        }
        for force in [false, true] {
            let error = text(Outputs::new(force).reading(at("last.png")).claim_folder(folder.path(), STILLS));
            assert!(error.contains("last.png: is an input of the command"), "{error}");
        }
        Outputs::new(true).reading(at("a.png")).claim_folder(folder.path(), STILLS).unwrap();
        // Under another name.
        std::os::unix::fs::symlink(at("a.png"), at("frame-1.png")).unwrap();
        let error = text(Outputs::new(true).reading(at("a.png")).claim_folder(folder.path(), STILLS));
        assert!(error.contains("frame-1.png: is an input"), "{error}");
        // An output of such a name beside the folder's own.
        let mut outputs = Outputs::new(true);
        outputs.claim(&at("frame-2.png")).unwrap();
        assert!(text(outputs.claim_folder(folder.path(), STILLS)).contains("two outputs"));
    }

    #[test]
    fn one_name_is_one_output() {
        let folder = tempfile::tempdir().unwrap();
        let mut outputs = Outputs::new(true);
        outputs.claim(&folder.path().join("a")).unwrap();
        assert!(text(outputs.claim(&folder.path().join("./a"))).contains("two outputs"));
        let file = outputs.create(&folder.path().join("a")).unwrap();
        assert!(outputs.create(&folder.path().join("a")).is_err());
        file.finish().unwrap();
    }

    #[test]
    fn devices_and_standard_output_are_written_as_they_are() {
        let mut outputs = Outputs::new(false).reading("/dev/null");
        outputs.claim(Path::new("/dev/null")).unwrap();
        outputs.claim(Path::new("-")).unwrap();
        assert!(text(outputs.claim(Path::new("-"))).contains("two outputs"));
    }

    #[test]
    fn a_folder_that_refuses_is_told_before_anything_is_done() {
        assert!(text(Outputs::new(false).claim(Path::new("/proc/version/a"))).contains("is a file"));
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("f"), "").unwrap();
        let within = folder.path().join("f/g/h");
        assert!(text(Outputs::new(false).claim(&within)).contains("a part of its path is a file"));
        // Root has all permissions there, and still no file can be created.
        assert!(text(Outputs::new(false).claim(Path::new("/sys/a"))).contains("cannot be written"));
        assert!(
            text(Outputs::new(false).claim_folder(Path::new("/sys/a"), STILLS)).contains("cannot be written")
        );
    }
}
