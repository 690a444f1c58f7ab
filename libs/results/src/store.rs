//! The store: one SQLite file. Every change is one transaction, so that a crash leaves it as it was
//! before. Every attempt carries a checksum, which is compared whenever it is read.

mod error;
mod private;
mod read;

pub use error::StoreError;
pub use private::mend_folder;
pub use read::Reading;

use crate::attempt::Attempt;
use crate::schema::{APPLICATION_ID, STEPS, VERSION};
use error::store_error;
use protocol::file::read_bytes;
use rusqlite::{Connection, OptionalExtension, Transaction, TransactionBehavior, params};
use std::fs::DirBuilder;
use std::io::ErrorKind;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How long somebody else's change is waited for before the store counts as locked.
pub const PATIENCE: Duration = Duration::from_secs(5);
/// Bytes of the smallest database, a page, and those with which every one begins.
const SMALLEST: u64 = 512;
const MAGIC: &[u8] = b"SQLite format 3\0";
/// Longest pseudonym, letters.
const MAX_NAME: usize = 64;

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
    /// What is wrong with the file as a whole.
    damage: Option<String>,
    notices: Vec<String>,
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
        let file = path.display().to_string();
        match read_bytes(path, SMALLEST) {
            Err(e) if e.kind() == ErrorKind::NotFound => Err(StoreError::Missing { file }),
            // SQLite takes it for a database without tables; whoever made it has lost what was in it.
            Ok(bytes)
                if bytes.len() < SMALLEST as usize
                    && MAGIC.starts_with(&bytes[..bytes.len().min(MAGIC.len())]) =>
            {
                let problem = format!("it ends after {} bytes", bytes.len());
                Err(StoreError::Damaged { file, problem })
            }
            _ => Self::open_with(path, PATIENCE),
        }
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
        let mut store = Store { path: path.into(), connection, patience, damage: None, notices: Vec::new() };
        store.migrate()?;
        store.notices.extend(private::mend_file(path));
        Ok(store)
    }

    /// What opening the store has changed in it, a sentence each, for its user.
    pub fn notices(&self) -> &[String] {
        &self.notices
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
        if is_empty {
            // It has just been made, with the mode that the user's mask leaves.
            private::mend_file(&self.path);
        }
        let known = usize::try_from(found).ok().filter(|&v| v <= VERSION);
        let Some(known) = known else { return Err(StoreError::Newer { file, newest: VERSION, found }) };
        self.damage = read::damage(&self.connection).map_err(|e| self.store_error(e))?;
        if known == VERSION {
            return Ok(());
        }
        let sealed = self.change(|change| {
            // Somebody else may have been quicker.
            let now: i64 = change.pragma_query_value(None, "user_version", |row| row.get(0))?;
            for step in STEPS.get(now as usize..).unwrap_or(&[]) {
                change.execute_batch(step)?;
            }
            change.pragma_update(None, "application_id", APPLICATION_ID)?;
            change.pragma_update(None, "user_version", VERSION as i64)?;
            read::seal(change, None)
        })?;
        if sealed > 0 {
            self.notices.push(format!("results store {file}: {sealed} attempts were given a checksum each"));
        }
        let recordings = self.recordings()?;
        self.notices.extend(private::mend_recordings(&self.path, &recordings));
        Ok(())
    }

    /// Paths of all recordings that attempts name.
    fn recordings(&self) -> Result<Vec<PathBuf>, StoreError> {
        let query = || {
            let named = "SELECT DISTINCT recording FROM attempts WHERE recording IS NOT NULL";
            let mut statement = self.connection.prepare(named)?;
            let rows = statement.query_map([], |row| row.get::<_, String>(0).map(PathBuf::from))?;
            rows.collect::<rusqlite::Result<Vec<_>>>()
        };
        query().map_err(|e| self.store_error(e))
    }

    /// All of `what` or nothing.
    fn change<T>(&mut self, what: impl FnOnce(&Transaction) -> rusqlite::Result<T>) -> Result<T, StoreError> {
        let Store { path, connection, patience, damage, .. } = self;
        if let Some(problem) = damage {
            return Err(StoreError::Damaged { file: path.display().to_string(), problem: problem.clone() });
        }
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
            read::seal(change, Some(id))?;
            Ok(Some(id))
        })
    }

    /// Who has a recording of these contents (SHA-256, hexadecimal) already: pseudonym, number of the
    /// attempt and version of its score.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn holders(&self, sha256: &str) -> Result<Vec<(String, i64, u32)>, StoreError> {
        let query = || {
            let mut statement = self.connection.prepare(
                "SELECT pseudonym, attempts.id, score_version FROM attempts JOIN trainees ON trainee = trainees.id
                 WHERE recording_sha256 = ?1 ORDER BY attempts.id",
            )?;
            let rows = statement.query_map([sha256], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))?;
            rows.collect::<rusqlite::Result<Vec<_>>>()
        };
        query().map_err(|e| self.store_error(e))
    }

    /// Deletes a trainee with every attempt; returns how many those were and which recordings they
    /// name. `None` if there is no such trainee.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn delete(&mut self, trainee: &str) -> Result<Option<(usize, Vec<NamedRecording>)>, StoreError> {
        let attempts = self.named_by(trainee, None)?;
        let deleted =
            self.change(|change| change.execute("DELETE FROM trainees WHERE pseudonym = ?1", [trainee]))?;
        let count = attempts.len();
        let recordings = self.still_named(attempts)?;
        Ok((deleted > 0).then_some((count, recordings)))
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
        let attempts = self.named_by(trainee, Some(id))?;
        if attempts.is_empty() {
            return Ok(None);
        }
        self.change(|change| change.execute("DELETE FROM attempts WHERE id = ?1", [id]))?;
        self.still_named(attempts).map(Some)
    }

    /// Path and hash of the recording of each attempt of a trainee, or of one of them; of damaged ones too.
    fn named_by(&self, trainee: &str, id: Option<i64>) -> Result<Vec<[Option<String>; 2]>, StoreError> {
        let query = || {
            let mut statement = self.connection.prepare(
                "SELECT recording, recording_sha256 FROM attempts JOIN trainees ON trainee = trainees.id
                 WHERE pseudonym = ?1 AND (?2 IS NULL OR attempts.id = ?2)",
            )?;
            let rows = statement.query_map(params![trainee, id], |row| Ok([row.get(0)?, row.get(1)?]))?;
            rows.collect::<rusqlite::Result<Vec<_>>>()
        };
        query().map_err(|e| self.store_error(e))
    }

    /// The recordings that deleted attempts name, each once.
    fn still_named(&self, deleted: Vec<[Option<String>; 2]>) -> Result<Vec<NamedRecording>, StoreError> {
        let named = deleted.into_iter().filter_map(|[path, sha256]| Some((path?, sha256)));
        let mut recordings = named
            .map(|(path, sha256)| {
                let shared = self.names(&path, &sha256).map_err(|e| self.store_error(e))?;
                Ok(NamedRecording { path, sha256, shared })
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

#[cfg(test)]
mod tests;
