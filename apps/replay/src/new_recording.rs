//! A recording that a command writes: a file, or parts. It appears when it is whole.

use outputs::{GrowingFile, Outputs};
use protocol::time::Nanos;
use recording::{
    Item, Limit, Packing, PartFiles, PartsWriter, Provenance, RecordingError, Writer, part_file, parts_of,
};
use settings::commands::{Split, WritingArgs};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Where a new recording goes.
#[derive(Debug)]
pub struct NewRecording {
    /// What was asked for: the file, or what the parts are named after.
    name: PathBuf,
    packing: Packing,
    limit: Option<Limit>,
    force: bool,
    /// The file, or the parts so far.
    files: Files,
}

/// Files that have no name yet.
type Files = Arc<Mutex<Vec<GrowingFile>>>;

/// What writes it.
pub enum ItemWriter {
    /// One file.
    One(Box<Writer>),
    /// Parts.
    Parts(Box<PartsWriter>),
}

impl ItemWriter {
    /// Appends an item by the instant by which it is filed, ns.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn write(&mut self, at: Nanos, item: &Item) -> Result<(), RecordingError> {
        match self {
            ItemWriter::One(writer) => writer.write(at, item),
            ItemWriter::Parts(writer) => {
                writer.write(at, item)?;
                // No real-time process waits for the disk here.
                let Some(problem) = writer.take_warning() else { return Ok(()) };
                Err(RecordingError::Part { file: writer.recording().display().to_string(), problem })
            }
        }
    }

    /// Ends the file, or the last part.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn finish(self) -> Result<(), RecordingError> {
        match self {
            ItemWriter::One(writer) => writer.finish(),
            ItemWriter::Parts(writer) => writer.finish(),
        }
    }
}

/// Checks that a recording may be written, without beginning it.
///
/// # Errors
/// Where it, or a part of it, exists or is read.
pub fn claim(name: &Path, writing: &WritingArgs, outputs: &mut Outputs) -> anyhow::Result<()> {
    outputs.claim(name)?;
    if writing.split.is_some() {
        let first = part_file(name, 1);
        let others = parts_of(name).into_iter().filter(|part| *part != first);
        std::iter::once(first.clone()).chain(others).try_for_each(|part| outputs.claim(&part))?;
    }
    Ok(())
}

impl NewRecording {
    /// Begins the file, or the first part.
    ///
    /// # Errors
    /// Where it exists, is read, or cannot be made.
    pub fn begin(name: &Path, writing: &WritingArgs, outputs: &mut Outputs) -> anyhow::Result<Self> {
        let limit = writing.split.map(|split| match split {
            Split::Seconds(seconds) => Limit::Time((seconds * 1e9) as u64),
            Split::Bytes(bytes) => Limit::Bytes(bytes),
        });
        let file = outputs.grow(&if limit.is_some() { part_file(name, 1) } else { name.into() })?;
        let packing = Packing::named(&writing.compress).unwrap_or_default();
        let files = Arc::new(Mutex::new(vec![file]));
        Ok(NewRecording { name: name.into(), packing, limit, force: outputs.is_forced(), files })
    }

    /// Its writer, of which there is one.
    ///
    /// # Errors
    /// Where the first file cannot be written.
    pub fn writer(&self, provenance: &Provenance) -> anyhow::Result<ItemWriter> {
        let (handle, path) = {
            let files = self.files.lock().unwrap_or_else(PoisonError::into_inner);
            (files[0].handle()?, files[0].path().to_path_buf())
        };
        let Some(limit) = self.limit else {
            let writer = Writer::packed(handle, &path, provenance, self.packing)?;
            return Ok(ItemWriter::One(Box::new(writer)));
        };
        let files = Box::new(Further { force: self.force, files: Arc::clone(&self.files) });
        let writer = PartsWriter::begin(&self.name, handle, provenance, self.packing, limit, files)?;
        Ok(ItemWriter::Parts(Box::new(writer)))
    }

    /// Gives all files their names, and returns these. Parts of a recording of that name, which is written
    /// over, are removed: they would be taken for parts of this one.
    ///
    /// # Errors
    /// Where a name was taken meanwhile, or an old part cannot be removed.
    pub fn appear(self) -> anyhow::Result<Vec<PathBuf>> {
        let mut files = std::mem::take(&mut *self.files.lock().unwrap_or_else(PoisonError::into_inner));
        let names: Vec<PathBuf> = files.iter().map(|file| file.path().to_path_buf()).collect();
        if self.force && self.limit.is_some() {
            let old = parts_of(&self.name).into_iter().filter(|part| !names.contains(part));
            let whole = self.name.is_file().then(|| self.name.clone());
            old.chain(whole).try_for_each(fs::remove_file)?;
        }
        files.iter_mut().try_for_each(GrowingFile::appear)?;
        Ok(names)
    }
}

/// Makes the further parts.
struct Further {
    force: bool,
    files: Files,
}

impl PartFiles for Further {
    fn begin(&mut self, path: &Path) -> Result<File, RecordingError> {
        let begun = Outputs::new(self.force).grow(path).and_then(|file| Ok((file.handle()?, file)));
        let (handle, file) = begun.map_err(|problem| RecordingError::Write {
            file: path.display().to_string(),
            problem: problem.to_string(),
        })?;
        self.files.lock().unwrap_or_else(PoisonError::into_inner).push(file);
        Ok(handle)
    }

    /// All appear together, once the recording is whole.
    fn appear(&mut self, _: &Path) -> Result<(), RecordingError> {
        Ok(())
    }
}
