//! The tables of a batch's shards: what each says of itself, whether it is whole, and all of them
//! put together, so that every recording of the list has one row or nothing is given out.
//!
//! A table says in its metadata which shard of which list it is and how it was made, and has the
//! digest of its rows. Of shards that agree, the rows in their turn are the list again, and must
//! have its digest.

use crate::batch::Shard;
use crate::listing::digest;
use crate::parquet_read;
use crate::table::Table;
use parquet::file::reader::ChunkReader;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt;

/// Most shards that are reported one by one as missing.
const TOLD: usize = 100;

/// Which part of what a table is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    /// The shard.
    pub shard: Shard,
    /// Recordings in the whole list.
    pub listed: u64,
    /// [`digest`] of the whole list.
    pub list_sha256: String,
    /// How the scores were made: program, version of the score, resimulated or not.
    pub made: String,
}

/// A shard's table that has been read, and holds.
#[derive(Debug, Clone, PartialEq)]
pub struct ShardTable {
    /// What it says of itself.
    pub origin: Origin,
    /// Its rows.
    pub table: Table,
}

/// Why a shard's table is not to be used.
#[derive(Debug, thiserror::Error)]
pub enum ShardError {
    /// It is no whole Parquet file.
    #[error("truncated or damaged: {0}")]
    Damaged(String),
    /// It does not say what it is.
    #[error("expected a shard's table, found no '{0}' in its metadata; vitreo score --out writes one")]
    Note(&'static str),
    /// Rows are missing, or too many.
    #[error("expected {expected} rows of its share, found {found}")]
    Rows {
        /// As its share of the list.
        expected: u64,
        /// As read.
        found: u64,
    },
    /// The rows do not match their digest.
    #[error("damaged: its rows do not match their checksum")]
    Changed,
}

impl Origin {
    /// Notes for the metadata of a table with these rows.
    pub fn notes(&self, table: &Table) -> Vec<(&'static str, String)> {
        vec![
            ("shard", format!("{}/{}", self.shard.index, self.shard.count)),
            ("listed", self.listed.to_string()),
            ("list_sha256", self.list_sha256.clone()),
            ("made", self.made.clone()),
            ("rows_sha256", digest_of(table)),
            ("column_kinds", kinds_of(table)),
        ]
    }

    fn of(notes: &BTreeMap<String, String>) -> Result<Self, ShardError> {
        let note = |key: &'static str| notes.get(key).ok_or(ShardError::Note(key));
        Ok(Origin {
            shard: Shard::of_text(note("shard")?).ok_or(ShardError::Note("shard"))?,
            listed: note("listed")?.parse().map_err(|_| ShardError::Note("listed"))?,
            list_sha256: note("list_sha256")?.clone(),
            made: note("made")?.clone(),
        })
    }

    /// In what it differs from a shard of the same batch; empty where it does not.
    pub fn differs(&self, other: &Origin) -> String {
        let mut all = Vec::new();
        if (self.listed, &self.list_sha256) != (other.listed, &other.list_sha256) {
            let same = if self.listed == other.listed { "other recordings or order, " } else { "" };
            all.push(format!("list ({same}{} recordings, not {})", self.listed, other.listed));
        }
        if self.made != other.made {
            all.push(format!("way of scoring ({}, not {})", self.made, other.made));
        }
        if self.shard.count != other.shard.count {
            all.push(format!("number of shards ({}, not {})", self.shard.count, other.shard.count));
        }
        all.join(" and ")
    }
}

/// SHA-256 of a table's cells, as CSV has them.
fn digest_of(table: &Table) -> String {
    let mut text = Vec::new();
    // Writing into memory cannot fail.
    let _ = table.write_csv(&mut text);
    Sha256::digest(&text).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Kinds of the columns: the rows do not show them where a column is empty.
fn kinds_of(table: &Table) -> String {
    table.columns.iter().map(|column| column.cells.kind()).collect::<Vec<_>>().join(",")
}

/// Reads a shard's table and holds it to what it says of itself.
///
/// # Errors
/// Where it is not whole, was changed, or is no table of a shard.
pub fn read<R: ChunkReader + 'static>(from: R) -> Result<ShardTable, ShardError> {
    let (table, notes) = parquet_read::read(from).map_err(|e| ShardError::Damaged(e.to_string()))?;
    let origin = Origin::of(&notes)?;
    let (expected, found) = (origin.shard.share(origin.listed), table.rows as u64);
    if expected != found {
        return Err(ShardError::Rows { expected, found });
    }
    let digest = notes.get("rows_sha256").ok_or(ShardError::Note("rows_sha256"))?;
    // Tables of earlier builds name no kinds.
    let other_kinds = notes.get("column_kinds").is_some_and(|kinds| *kinds != kinds_of(&table));
    if *digest != digest_of(&table) || other_kinds {
        return Err(ShardError::Changed);
    }
    Ok(ShardTable { origin, table })
}

/// Why shards make no whole: each table that is missing, damaged or of something else, by name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Incomplete(pub Vec<String>);

impl fmt::Display for Incomplete {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        to.write_str(&self.0.join("\n"))
    }
}

impl std::error::Error for Incomplete {}

/// Puts shards together in the order of their list. `found` is what lies in a place: names of
/// tables ([`Shard::of_file_name`]) and what reading each gave.
///
/// # Errors
/// Where a shard is missing, not whole, or of another batch than the first that is whole; every one
/// is reported.
pub fn gather(found: Vec<(Shard, Result<ShardTable, ShardError>)>) -> Result<ShardTable, Incomplete> {
    let mut problems = Vec::new();
    let mut whole: BTreeMap<u32, ShardTable> = BTreeMap::new();
    let counts: BTreeMap<u32, usize> = found.iter().fold(BTreeMap::new(), |mut counts, (shard, _)| {
        *counts.entry(shard.count).or_default() += 1;
        counts
    });
    let Some((&count, _)) = counts.first_key_value() else {
        return Err(Incomplete(vec!["expected tables of shards (scores-*.parquet), found none".into()]));
    };
    if counts.len() > 1 {
        let each = counts.iter().map(|(count, tables)| format!("{tables} of {count} shards"));
        let each = each.collect::<Vec<_>>().join(", ");
        let wanted = "tables of batches with different numbers of shards lie together";
        return Err(Incomplete(vec![format!("{wanted} ({each}); give each batch a folder of its own")]));
    }
    let mut named = Vec::new();
    for (shard, read) in found {
        named.push(shard.index);
        match read {
            Ok(table) if table.origin.shard == shard => drop(whole.insert(shard.index, table)),
            Ok(table) => {
                let Shard { index, count } = table.origin.shard;
                problems.push(format!("{}: is the table of shard {index}/{count}", shard.file_name()));
            }
            Err(problem) => problems.push(format!("{}: {problem}", shard.file_name())),
        }
    }
    let missing = (0..count).filter(|index| !named.contains(index));
    problems.extend(
        missing.clone().take(TOLD).map(|i| format!("{}: missing", Shard { index: i, count }.file_name())),
    );
    let more = count as usize - named.len().min(count as usize);
    if more > TOLD {
        problems.push(format!("and {} more that are missing", more - TOLD));
    }
    problems.extend(strangers(&whole));
    if problems.is_empty() { put_together(whole) } else { Err(Incomplete(problems)) }
}

/// Shards that belong to another batch than the first.
fn strangers(whole: &BTreeMap<u32, ShardTable>) -> Vec<String> {
    let Some(first) = whole.values().next() else { return Vec::new() };
    let differing = whole.values().filter_map(|other| {
        let how = other.origin.differs(&first.origin);
        let (own, its) = (other.origin.shard.file_name(), first.origin.shard.file_name());
        (!how.is_empty()).then(|| format!("{own}: another {how} than {its}"))
    });
    differing.collect()
}

fn put_together(whole: BTreeMap<u32, ShardTable>) -> Result<ShardTable, Incomplete> {
    let parts: Vec<&Table> = whole.values().map(|part| &part.table).collect();
    let refused = |problem: &str| Incomplete(vec![problem.to_owned()]);
    let mut table = Table::interleaved(&parts).ok_or_else(|| refused("the tables' columns differ"))?;
    let origin = whole.into_values().next().map(|part| part.origin);
    let origin = origin.ok_or_else(|| refused("expected tables of shards, found none"))?;
    let names = table.texts("file").iter().map(|file| file.as_deref().unwrap_or_default());
    if digest(names) != origin.list_sha256 {
        return Err(refused("the recordings of all tables together are not those of their list"));
    }
    table.name_same();
    Ok(ShardTable { origin: Origin { shard: Shard::WHOLE, ..origin }, table })
}

#[cfg(test)]
mod tests;
