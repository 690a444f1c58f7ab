//! Where the tables of a batch's shards lie, a folder or an object store, and putting them together
//! (`vitreo score --gather`).

use super::objects::{Address, ObjectError, Store};
use anyhow::{Context, bail};
use ipc::logging::warn;
use outputs::exit::WrongUse;
use outputs::{OutputError, Outputs, save};
use results::batch::Shard;
use results::listing::is_address;
use results::parquet_file;
use results::shards::{self, Origin, ShardError, ShardTable};
use results::table::Table;
use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// A place for tables of shards.
#[derive(Debug)]
pub struct Place<'s> {
    at: At,
    store: &'s Store,
}

#[derive(Debug)]
enum At {
    Folder(PathBuf),
    Below(Address),
}

/// What became of a table that was to be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Written {
    /// It is there now.
    Now,
    /// Another was there first.
    Before,
}

impl<'s> Place<'s> {
    /// A folder, or what lies below an address.
    ///
    /// # Errors
    /// For an address that is none, or that of a recording.
    pub fn of(place: &Path, store: &'s Store) -> Result<Self, ObjectError> {
        let at = if is_address(place) { At::Below(Address::parse(place)?) } else { At::Folder(place.into()) };
        Ok(Place { at, store })
    }

    /// Name of a shard's table here, for messages.
    pub fn name(&self, shard: Shard) -> String {
        match &self.at {
            At::Folder(folder) => folder.join(shard.file_name()).display().to_string(),
            At::Below(address) => address.below(&shard.file_name()).to_string(),
        }
    }

    /// Reads a shard's table; `None` where there is none.
    ///
    /// # Errors
    /// Where it cannot be looked at; what is wrong with it is no error.
    pub fn read(&self, shard: Shard) -> anyhow::Result<Option<Result<ShardTable, ShardError>>> {
        let file = match &self.at {
            At::Folder(folder) => match File::open(folder.join(shard.file_name())) {
                Err(problem) if problem.kind() == ErrorKind::NotFound => return Ok(None),
                opened => opened.with_context(|| self.name(shard))?,
            },
            At::Below(address) => match self.store.fetch(&address.below(&shard.file_name())) {
                Err(ObjectError::Absent(_) | ObjectError::Gone(_)) => return Ok(None),
                fetched => fetched?,
            },
        };
        Ok(Some(shards::read(file)))
    }

    /// Refuses a table that may not be written: before anything is done, where that is known.
    ///
    /// # Errors
    /// Where there is one and `outputs` is not forced, or the place refuses.
    pub fn claim(&self, shard: Shard, outputs: &mut Outputs) -> anyhow::Result<()> {
        match &self.at {
            At::Folder(folder) => Ok(outputs.claim(&folder.join(shard.file_name()))?),
            At::Below(address) => {
                let address = address.below(&shard.file_name());
                if self.store.exists(&address)? && !outputs.is_forced() {
                    return Err(ObjectError::Exists(address.to_string()).into());
                }
                Ok(())
            }
        }
    }

    /// Writes a shard's table, whole or not at all.
    ///
    /// # Errors
    /// Where the place refuses.
    pub fn write(&self, origin: &Origin, table: &Table, outputs: &mut Outputs) -> anyhow::Result<Written> {
        let notes = origin.notes(table);
        let notes: Vec<(&str, &str)> = notes.iter().map(|(key, value)| (*key, value.as_str())).collect();
        let write = |name: &str, to: &mut dyn WriteSend| -> anyhow::Result<()> {
            parquet_file::write(table, to, &notes).with_context(|| name.to_owned())
        };
        let name = self.name(origin.shard);
        match &self.at {
            At::Folder(folder) => {
                let file = outputs.create(&folder.join(origin.shard.file_name()));
                let file = file.map_err(anyhow::Error::from);
                let written = file.and_then(|file| save(file, |out| write(&name, out)));
                let taken = |e: &anyhow::Error| matches!(e.downcast_ref(), Some(OutputError::Exists { .. }));
                written_or_taken(written, taken)
            }
            At::Below(address) => {
                let mut bytes = Vec::new();
                write(&name, &mut bytes)?;
                let put =
                    self.store.put(&address.below(&origin.shard.file_name()), bytes, outputs.is_forced());
                let taken = |e: &anyhow::Error| matches!(e.downcast_ref(), Some(ObjectError::Exists(_)));
                written_or_taken(put.map_err(Into::into), taken)
            }
        }
    }

    /// Shards whose tables lie here, by number.
    ///
    /// # Errors
    /// Where the place cannot be read.
    pub fn shards(&self) -> anyhow::Result<Vec<Shard>> {
        let mut names = Vec::new();
        match &self.at {
            At::Folder(folder) => {
                let named = || folder.display().to_string();
                for entry in std::fs::read_dir(folder).with_context(named)? {
                    names.push(entry.with_context(named)?.file_name().to_string_lossy().into_owned());
                }
            }
            At::Below(address) => {
                // One directly below, not deeper.
                for object in self.store.list(address)? {
                    let name = object.key.rsplit('/').next().unwrap_or_default();
                    if address.below(name) == object {
                        names.push(name.to_owned());
                    }
                }
            }
        }
        let mut shards: Vec<Shard> = names.iter().filter_map(|name| Shard::of_file_name(name)).collect();
        shards.sort_by_key(|shard| (shard.count, shard.index));
        Ok(shards)
    }
}

/// A writer that may go to another thread, as the Parquet library wants it.
trait WriteSend: std::io::Write + Send {}
impl<W: std::io::Write + Send> WriteSend for W {}

fn written_or_taken(
    written: anyhow::Result<()>,
    taken: impl Fn(&anyhow::Error) -> bool,
) -> anyhow::Result<Written> {
    match written {
        Ok(()) => Ok(Written::Now),
        Err(problem) if taken(&problem) => Ok(Written::Before),
        Err(problem) => Err(problem),
    }
}

/// Refuses an address where only a path will do.
///
/// # Errors
/// For an address.
pub fn only_path(option: &str, path: Option<&Path>) -> Result<(), WrongUse> {
    match path.filter(|path| is_address(path)) {
        Some(address) => Err(WrongUse(format!(
            "{option} {}: expected a path; addresses are for recordings, --manifest, --out and --gather",
            address.display()
        ))),
        None => Ok(()),
    }
}

/// Reads every shard's table in a place and puts them together.
///
/// # Errors
/// Where the place cannot be read, or the shards are not the whole of one list; every one that is
/// missing or damaged is reported by name before.
pub fn gather(place: &Place<'_>) -> anyhow::Result<ShardTable> {
    let mut found = Vec::new();
    for shard in place.shards()? {
        // One that vanishes meanwhile is missing.
        if let Some(read) = place.read(shard)? {
            found.push((shard, read));
        }
    }
    match shards::gather(found) {
        Ok(whole) => Ok(whole),
        Err(problems) => {
            problems.0.iter().for_each(|problem| warn(problem));
            let place = match &place.at {
                At::Folder(folder) => folder.display().to_string(),
                At::Below(address) => address.to_string(),
            };
            bail!("{place}: incomplete batch ({} problems, above); nothing was written", problems.0.len())
        }
    }
}
