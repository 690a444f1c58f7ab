//! The files of a recording in progress: a single file, or its parts.

use anyhow::Context;
use outputs::{GrowingFile, Outputs};
use recording::{
    Limit, Packing, PartFiles, PartsWriter, Provenance, RecordingError, Writer, part_file, parts_of,
};
use settings::commands::{Split, WritingArgs};
use std::fs::{self, File};
use std::path::{Path, PathBuf};

/// Files of a recording. Only their owner may read them, because trainees' attempts are private.
pub struct RecordingFiles {
    /// Requested name, which is that of the file, or the stem of the parts' names.
    name: PathBuf,
    /// The single file, or the first part.
    first: GrowingFile,
    packing: Packing,
    limit: Option<Limit>,
    force: bool,
}

/// Checks that a recording may be written, without beginning it.
///
/// # Errors
/// If the recording or a part of it exists (without `--force`) or is an input.
pub fn claim(name: &Path, writing: &WritingArgs, outputs: &mut Outputs) -> anyhow::Result<()> {
    outputs.claim(name)?;
    if writing.split.is_none() {
        return Ok(());
    }
    let first = part_file(name, 1);
    let mut parts = parts_of(name);
    parts.retain(|part| *part != first);
    std::iter::once(first).chain(parts).try_for_each(|part| outputs.claim(&part))?;
    Ok(())
}

impl RecordingFiles {
    /// Begins the file, or the first part. It gets its name with [`RecordingFiles::appear`].
    ///
    /// # Errors
    /// If the file exists (without `--force`), or cannot be created.
    pub fn begin(name: &Path, writing: &WritingArgs, outputs: &mut Outputs) -> anyhow::Result<Self> {
        let limit = writing.split.map(limit_of);
        let first = if limit.is_some() { part_file(name, 1) } else { name.into() };
        let first = outputs.grow(&first)?;
        first.make_private()?;
        let packing = Packing::named(&writing.compress).unwrap_or_default();
        Ok(RecordingFiles { name: name.into(), first, packing, limit, force: outputs.is_forced() })
    }

    /// Requested name.
    pub fn name(&self) -> &Path {
        &self.name
    }

    /// True if the recording is split into parts.
    pub fn is_split(&self) -> bool {
        self.limit.is_some()
    }

    /// Writer of the single file.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn writer(&self, provenance: &Provenance) -> anyhow::Result<Writer> {
        Ok(Writer::packed(self.first.handle()?, self.first.path(), provenance, self.packing)?)
    }

    /// Writer of the parts; `None` for a single file.
    ///
    /// # Errors
    /// If the first part cannot be written.
    pub fn parts_writer(&self, provenance: &Provenance) -> anyhow::Result<Option<PartsWriter>> {
        let Some(limit) = self.limit else { return Ok(None) };
        let files = Box::new(Further { first: self.first.path().into(), force: self.force, file: None });
        let first = self.first.handle()?;
        Ok(Some(PartsWriter::begin(&self.name, first, provenance, self.packing, limit, files)?))
    }

    /// Gives the file its name, once the recorded run has begun. If an older recording of that name is
    /// overwritten, its parts are removed, because they would be taken for parts of the new one.
    ///
    /// # Errors
    /// If a file of that name was created in the meantime, or an old part cannot be removed.
    pub fn appear(&mut self) -> anyhow::Result<()> {
        if self.force && self.is_split() {
            let old = parts_of(&self.name).into_iter().filter(|part| part != self.first.path());
            let whole = self.name.is_file().then(|| self.name.clone());
            for file in old.chain(whole) {
                fs::remove_file(&file).with_context(|| format!("remove {}", file.display()))?;
            }
        }
        Ok(self.first.appear()?)
    }
}

/// Converts length or size of the parts to the writer's type.
fn limit_of(split: Split) -> Limit {
    match split {
        Split::Seconds(seconds) => Limit::Time((seconds * 1e9) as u64),
        Split::Bytes(bytes) => Limit::Bytes(bytes),
    }
}

/// Creates the second and further parts during a run.
struct Further {
    /// Path of the first part, which exists once the run has begun.
    first: PathBuf,
    force: bool,
    /// A part that has not got its name yet.
    file: Option<GrowingFile>,
}

impl Further {
    fn refused(path: &Path, problem: impl ToString) -> RecordingError {
        RecordingError::Write { file: path.display().to_string(), problem: problem.to_string() }
    }
}

impl PartFiles for Further {
    fn begin(&mut self, path: &Path) -> Result<File, RecordingError> {
        if !self.first.exists() {
            return Err(Self::refused(path, "the first part has no name yet"));
        }
        let begun = Outputs::new(self.force).grow(path).and_then(|file| {
            file.make_private()?;
            Ok((file.handle()?, file))
        });
        let (handle, file) = begun.map_err(|problem| Self::refused(path, problem))?;
        self.file = Some(file);
        Ok(handle)
    }

    fn appear(&mut self, path: &Path) -> Result<(), RecordingError> {
        // The file stays locked while the writer has it open.
        let named = self.file.take().map_or(Ok(()), |mut file| file.appear());
        named.map_err(|problem| Self::refused(path, problem))
    }
}
