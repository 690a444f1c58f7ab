//! The store: one SQLite file. Every change is one transaction, so that a crash leaves it as it was
//! before.

use crate::attempt::{Attempt, Points, Stored};
use crate::schema::{APPLICATION_ID, STEPS, VERSION};
use rusqlite::{Connection, ErrorCode, OptionalExtension, Row, Transaction, TransactionBehavior, params};
use std::fs::{DirBuilder, Permissions};
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How long somebody else's change is waited for before the store counts as locked.
pub const PATIENCE: Duration = Duration::from_secs(5);
/// Longest pseudonym, letters.
const MAX_NAME: usize = 64;

/// Why the store could not do it.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Another program holds it.
    #[error(
        "results store {file}: locked by another program for more than {seconds} s; end that program or try later"
    )]
    Locked {
        /// The file.
        file: String,
        /// How long it was waited for, s.
        seconds: u64,
    },
    /// No room is left.
    #[error("results store {file}: the disk is full; nothing was changed")]
    Full {
        /// The file.
        file: String,
    },
    /// It may be read only.
    #[error("results store {file}: not writable")]
    ReadOnly {
        /// The file.
        file: String,
    },
    /// Something else lies there.
    #[error("results store {file}: expected a results store, found {found}")]
    Foreign {
        /// The file.
        file: String,
        /// What it is.
        found: String,
    },
    /// Made by a newer program.
    #[error(
        "results store {file}: expected a schema up to {newest}, found {found}; use the newer vitreo that made it"
    )]
    Newer {
        /// The file.
        file: String,
        /// The newest schema this build knows.
        newest: usize,
        /// The store's.
        found: i64,
    },
    /// There is none.
    #[error("results store {file}: no such file; `vitreo run --module NAME --trainee NAME` makes it")]
    Missing {
        /// The file.
        file: String,
    },
    /// A value makes no sense.
    #[error("{field}: expected {expected}, found {found}")]
    Value {
        /// What was given.
        field: &'static str,
        /// What would be right.
        expected: String,
        /// What it was.
        found: String,
    },
    /// Anything else, in SQLite's words.
    #[error("results store {file}: {problem}")]
    Other {
        /// The file.
        file: String,
        /// Why.
        problem: String,
    },
}

/// Which attempts to give; every condition that is set must hold.
#[derive(Debug, Clone, Default)]
pub struct Filter {
    /// The trainee's pseudonym.
    pub trainee: Option<String>,
    /// The module's name.
    pub module: Option<String>,
    /// The level.
    pub level: Option<u32>,
}

/// A recording that a deleted attempt named.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct NamedRecording {
    /// Where it lay when the attempt was kept.
    pub path: String,
    /// SHA-256 of its contents then, hexadecimal, where it was taken.
    pub sha256: Option<String>,
    /// True if another attempt names it too.
    pub shared: bool,
}

/// The store, open.
#[derive(Debug)]
pub struct Store {
    path: PathBuf,
    connection: Connection,
    patience: Duration,
}

/// Default path of the store, after the XDG base directory specification.
/// `data_home` is the value of `XDG_DATA_HOME`, `home` that of `HOME`.
pub fn default_place(data_home: Option<&Path>, home: Option<&Path>) -> Option<PathBuf> {
    // A relative path is to be passed over, says the specification.
    let data = data_home.filter(|p| p.is_absolute()).map(Path::to_path_buf);
    let data = data.or_else(|| Some(home.filter(|h| h.is_absolute())?.join(".local/share")))?;
    Some(data.join("vitreo/results.sqlite"))
}

/// Checks a pseudonym: short, and nothing that spoils a table or a file name.
///
/// # Errors
/// If the name is empty, longer than 64 characters, or has other than letters, digits and `-_.@`.
pub fn check_name(name: &str) -> Result<(), StoreError> {
    let plain = |c: char| c.is_alphanumeric() || "-_.@".contains(c);
    let good = !name.is_empty()
        && name.chars().count() <= MAX_NAME
        && name.chars().all(plain)
        && !name.starts_with(['-', '.']);
    if good {
        return Ok(());
    }
    let expected = format!(
        "a pseudonym of 1 to {MAX_NAME} letters, digits, '-', '_', '.' or '@', begun with a letter or digit"
    );
    Err(StoreError::Value { field: "trainee", expected, found: format!("'{name}'") })
}

/// Takes from others what they may do with a store; somebody else's, or one on a read-only disk, stays as
/// it is.
fn make_private(path: &Path) {
    let mode = path.metadata().map_or(0, |found| found.permissions().mode());
    if mode & 0o077 != 0 {
        let _ = std::fs::set_permissions(path, Permissions::from_mode(mode & 0o700));
    }
}

impl Store {
    /// Opens a store and brings its schema up to date; makes one where there is none.
    ///
    /// # Errors
    /// If the file cannot be opened, is no store, or is of a later version.
    pub fn open_or_create(path: &Path) -> Result<Self, StoreError> {
        if let Some(folder) = path.parent().filter(|f| !f.as_os_str().is_empty()) {
            let file = path.display().to_string();
            let store_error =
                |e: std::io::Error| StoreError::Other { file, problem: format!("make its folder: {e}") };
            let mut private = DirBuilder::new();
            private.recursive(true).mode(0o700).create(folder).map_err(store_error)?;
        }
        Self::open_with(path, PATIENCE)
    }

    /// Opens a store that is there and brings its schema up to date.
    ///
    /// # Errors
    /// If there is no such file, it is no store, or it is of a later version.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        if !path.exists() {
            return Err(StoreError::Missing { file: path.display().to_string() });
        }
        Self::open_with(path, PATIENCE)
    }

    /// As [`Store::open_or_create`] without making folders, with another patience.
    ///
    /// # Errors
    /// If the file cannot be opened, is no store, is of a later version, or stays locked.
    pub fn open_with(path: &Path, patience: Duration) -> Result<Self, StoreError> {
        let store_error = |e| store_error(path, patience, e);
        let connection = Connection::open(path).map_err(store_error)?;
        connection.busy_timeout(patience).map_err(store_error)?;
        connection.pragma_update(None, "foreign_keys", true).map_err(store_error)?;
        // "Kept" holds after a power failure at the next instant: the removal of the journal is synced too,
        // without which the change would be rolled back.
        connection.pragma_update(None, "synchronous", "EXTRA").map_err(store_error)?;
        // What a trainee has deleted is overwritten, not only forgotten.
        connection.pragma_update(None, "secure_delete", true).map_err(store_error)?;
        let mut store = Store { path: path.into(), connection, patience };
        store.migrate()?;
        make_private(path);
        Ok(store)
    }

    fn store_error(&self, error: rusqlite::Error) -> StoreError {
        store_error(&self.path, self.patience, error)
    }

    /// Version of the schema, owner, and number of tables, at one instant: somebody else may be
    /// making the store.
    fn identity(&self) -> rusqlite::Result<[i64; 3]> {
        let reading = self.connection.unchecked_transaction()?;
        let number = |pragma| reading.pragma_query_value(None, pragma, |row| row.get(0));
        let tables = reading.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))?;
        Ok([number("user_version")?, number("application_id")?, tables])
    }

    /// Brings the schema up to date.
    fn migrate(&mut self) -> Result<(), StoreError> {
        let file = self.path.display().to_string();
        let [found, owner, tables] = self.identity().map_err(|e| self.store_error(e))?;
        let is_empty = [found, owner, tables] == [0; 3];
        if !is_empty && owner != i64::from(APPLICATION_ID) {
            return Err(StoreError::Foreign { file, found: "a database of another program".into() });
        }
        let known = usize::try_from(found).ok().filter(|&v| v <= VERSION);
        let Some(known) = known else { return Err(StoreError::Newer { file, newest: VERSION, found }) };
        if known == VERSION {
            return Ok(());
        }
        self.change(|change| {
            // Somebody else may have been quicker.
            let now: i64 = change.pragma_query_value(None, "user_version", |row| row.get(0))?;
            for step in STEPS.get(now as usize..).unwrap_or(&[]) {
                change.execute_batch(step)?;
            }
            change.pragma_update(None, "application_id", APPLICATION_ID)?;
            change.pragma_update(None, "user_version", VERSION as i64)
        })
    }

    /// All of `what` or nothing.
    fn change<T>(&mut self, what: impl FnOnce(&Transaction) -> rusqlite::Result<T>) -> Result<T, StoreError> {
        let Store { path, connection, patience } = self;
        let all = || {
            let change = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            let done = what(&change)?;
            change.commit()?;
            Ok(done)
        };
        all().map_err(|e| store_error(path, *patience, e))
    }

    /// Adds an attempt of a trainee; a trainee who is not there yet is added too. `None` if the
    /// store holds this recording's score in this version already.
    ///
    /// # Errors
    /// If the name is refused or the store cannot be written.
    pub fn add(&mut self, trainee: &str, attempt: &Attempt) -> Result<Option<i64>, StoreError> {
        check_name(trainee)?;
        self.change(|change| {
            change
                .execute("INSERT INTO trainees (pseudonym) VALUES (?1) ON CONFLICT DO NOTHING", [trainee])?;
            let own: i64 =
                change
                    .query_row("SELECT id FROM trainees WHERE pseudonym = ?1", [trainee], |row| row.get(0))?;
            let Some(id) = insert(change, own, attempt)? else { return Ok(None) };
            for (kind, points) in [("category", &attempt.categories), ("metric", &attempt.metrics)] {
                for (place, p) in points.iter().enumerate() {
                    change.execute(
                        "INSERT INTO points (attempt, kind, place, key, value, sigma, points, of)
                         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)",
                        params![id, kind, place as i64, p.key, p.value, p.sigma, p.points, p.of],
                    )?;
                }
            }
            Ok(Some(id))
        })
    }

    /// Deletes a trainee with every attempt; returns how many those were and which recordings they
    /// name. `None` if there is no such trainee.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn delete(&mut self, trainee: &str) -> Result<Option<(usize, Vec<NamedRecording>)>, StoreError> {
        let filter = Filter { trainee: Some(trainee.into()), ..Filter::default() };
        let attempts = self.attempts(&filter)?;
        let deleted =
            self.change(|change| change.execute("DELETE FROM trainees WHERE pseudonym = ?1", [trainee]))?;
        let recordings = self.recordings_of(&attempts)?;
        Ok((deleted > 0).then_some((attempts.len(), recordings)))
    }

    /// Deletes one attempt of a trainee; returns the recording that it names. `None` if the trainee
    /// has no attempt of that number.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn delete_attempt(
        &mut self,
        trainee: &str,
        id: i64,
    ) -> Result<Option<Vec<NamedRecording>>, StoreError> {
        let filter = Filter { trainee: Some(trainee.into()), ..Filter::default() };
        let mut attempts = self.attempts(&filter)?;
        attempts.retain(|stored| stored.id == id);
        if attempts.is_empty() {
            return Ok(None);
        }
        self.change(|change| change.execute("DELETE FROM attempts WHERE id = ?1", [id]))?;
        self.recordings_of(&attempts).map(Some)
    }

    /// The recordings that deleted attempts name, each once.
    fn recordings_of(&self, deleted: &[Stored]) -> Result<Vec<NamedRecording>, StoreError> {
        let named = deleted.iter().filter_map(|s| Some((s.attempt.recording.as_ref()?, &s.attempt)));
        let mut recordings = named
            .map(|(path, attempt)| {
                let sha256 = attempt.recording_sha256.clone();
                let shared = self.names(path, &sha256).map_err(|e| self.store_error(e))?;
                Ok(NamedRecording { path: path.clone(), sha256, shared })
            })
            .collect::<Result<Vec<_>, StoreError>>()?;
        recordings.sort();
        recordings.dedup();
        Ok(recordings)
    }

    /// True if an attempt has its recording there, or of these contents.
    fn names(&self, path: &str, sha256: &Option<String>) -> rusqlite::Result<bool> {
        let query = "SELECT count(*) FROM attempts WHERE recording = ?1 OR recording_sha256 = ?2";
        self.connection.query_row(query, params![path, sha256], |row| row.get::<_, i64>(0)).map(|n| n > 0)
    }

    /// Pseudonyms and how many attempts each has made, in the order of the alphabet.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn trainees(&self) -> Result<Vec<(String, usize)>, StoreError> {
        let all = "SELECT pseudonym, count(attempts.id) FROM trainees LEFT JOIN attempts ON attempts.trainee = trainees.id
                   GROUP BY trainees.id ORDER BY pseudonym";
        let query = || {
            let mut statement = self.connection.prepare(all)?;
            let rows = statement.query_map([], |row| Ok((row.get(0)?, row.get::<_, i64>(1)? as usize)))?;
            rows.collect::<rusqlite::Result<Vec<_>>>()
        };
        query().map_err(|e| self.store_error(e))
    }

    /// Attempts in the order in which they were made.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn attempts(&self, filter: &Filter) -> Result<Vec<Stored>, StoreError> {
        self.query(filter).map_err(|e| self.store_error(e))
    }

    fn query(&self, filter: &Filter) -> rusqlite::Result<Vec<Stored>> {
        let mut statement = self.connection.prepare(
            "SELECT attempts.id, pseudonym, strftime('%Y-%m-%dT%H:%M:%SZ', at_s, 'unixepoch'), at_s, module, level, surgeon,
                 program, score_version, seed, total, attempts.sigma, finished, took_s, recording, recording_sha256,
                 broken_off, failed
             FROM attempts JOIN trainees ON attempts.trainee = trainees.id
             WHERE (?1 IS NULL OR pseudonym = ?1) AND (?2 IS NULL OR module = ?2) AND (?3 IS NULL OR level = ?3)
             ORDER BY at_s, attempts.id",
        )?;
        let rows = statement.query_map(params![filter.trainee, filter.module, filter.level], stored)?;
        let mut found = rows.collect::<rusqlite::Result<Vec<_>>>()?;
        let mut points = self.connection.prepare(
            "SELECT key, value, sigma, points, of FROM points WHERE attempt = ?1 AND kind = ?2 ORDER BY place",
        )?;
        for Stored { id, attempt, .. } in &mut found {
            for (kind, into) in [("category", &mut attempt.categories), ("metric", &mut attempt.metrics)] {
                let rows = points.query_map(params![*id, kind], |row| {
                    let (key, value, sigma) = (row.get(0)?, row.get(1)?, row.get(2)?);
                    Ok(Points { key, value, sigma, points: row.get(3)?, of: row.get(4)? })
                })?;
                *into = rows.collect::<rusqlite::Result<_>>()?;
            }
        }
        Ok(found)
    }
}

/// The row of an attempt; `None` where the trainee has it already.
fn insert(change: &Transaction, trainee: i64, a: &Attempt) -> rusqlite::Result<Option<i64>> {
    // SQLite's integers have a sign; the seed's bits are what counts.
    let seed = a.seed.map(|seed| seed as i64);
    let row = "INSERT INTO attempts (trainee, at_s, module, level, surgeon, program, score_version, seed, total, sigma, finished,
                   took_s, recording, recording_sha256, broken_off, failed)
               VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16)
               ON CONFLICT (trainee, recording_sha256, score_version) DO NOTHING RETURNING id";
    let values = params![
        trainee,
        a.at_s,
        a.module,
        a.level,
        a.surgeon,
        a.program,
        a.score_version,
        seed,
        a.total,
        a.sigma,
        a.finished,
        a.took_s,
        a.recording,
        a.recording_sha256,
        a.broken_off,
        a.failed
    ];
    change.query_row(row, values, |row| row.get(0)).optional()
}

fn stored(row: &Row) -> rusqlite::Result<Stored> {
    let attempt = Attempt {
        at_s: row.get(3)?,
        module: row.get(4)?,
        level: row.get(5)?,
        surgeon: row.get(6)?,
        program: row.get(7)?,
        score_version: row.get(8)?,
        seed: row.get::<_, Option<i64>>(9)?.map(|seed| seed as u64),
        total: row.get(10)?,
        sigma: row.get(11)?,
        finished: row.get(12)?,
        took_s: row.get(13)?,
        recording: row.get(14)?,
        recording_sha256: row.get(15)?,
        broken_off: row.get(16)?,
        failed: row.get(17)?,
        ..Attempt::default()
    };
    Ok(Stored {
        id: row.get(0)?,
        trainee: row.get(1)?,
        at: row.get::<_, Option<String>>(2)?.unwrap_or_default(),
        attempt,
    })
}

/// SQLite's error in words that say what to do.
fn store_error(path: &Path, patience: Duration, error: rusqlite::Error) -> StoreError {
    let file = path.display().to_string();
    match error.sqlite_error_code() {
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => {
            StoreError::Locked { file, seconds: patience.as_secs() }
        }
        Some(ErrorCode::DiskFull) => StoreError::Full { file },
        Some(ErrorCode::ReadOnly) => StoreError::ReadOnly { file },
        Some(ErrorCode::NotADatabase) => {
            StoreError::Foreign { file, found: "a file that is no database".into() }
        }
        Some(ErrorCode::DatabaseCorrupt) => StoreError::Foreign { file, found: "a damaged database".into() },
        _ => StoreError::Other { file, problem: error.to_string() },
    }
}

#[cfg(test)]
mod tests;
