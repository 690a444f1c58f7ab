//! Reading attempts, and whether they are what was kept.
//!
//! A checksum covers everything that is given out of an attempt; SQLite's own check covers what holds the
//! attempts together, so that none is missing without a word.

use super::{Filter, Store, StoreError};
use crate::attempt::{Attempt, Points, Stored};
use rusqlite::{Connection, Row, Statement, params};
use sha2::{Digest, Sha256};

/// What was found of the attempts that were asked for.
#[derive(Debug)]
pub struct Reading {
    /// Those that are as they were kept, in the order in which they were made.
    pub attempts: Vec<Stored>,
    /// What is damaged: the store as a whole, or attempts of it, which are left out.
    pub damage: Vec<StoreError>,
}

/// Columns of an attempt, in the order of [`stored`] and [`points_of`].
const COLUMNS: &str = "attempts.id, pseudonym, strftime('%Y-%m-%dT%H:%M:%SZ', at_s, 'unixepoch'), at_s, module, level,
     surgeon, program, score_version, seed, total, attempts.sigma, finished, took_s, recording, recording_sha256,
     broken_off, failed, checksum
     FROM attempts LEFT JOIN trainees ON attempts.trainee = trainees.id";

/// Points of an attempt, of one kind.
const POINTS: &str =
    "SELECT key, value, sigma, points, of FROM points WHERE attempt = ?1 AND kind = ?2 ORDER BY place";

impl Store {
    /// Attempts in the order in which they were made. One that is damaged is left out and named; the
    /// others are given all the same.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn read(&self, filter: &Filter) -> Result<Reading, StoreError> {
        self.query(filter).map_err(|e| self.store_error(e))
    }

    /// As [`Store::read`], for those who need all of them.
    ///
    /// # Errors
    /// If the store cannot be read, or something in it is damaged.
    pub fn attempts(&self, filter: &Filter) -> Result<Vec<Stored>, StoreError> {
        let Reading { attempts, damage } = self.read(filter)?;
        damage.into_iter().next().map_or(Ok(attempts), Err)
    }

    fn query(&self, filter: &Filter) -> rusqlite::Result<Reading> {
        let file = self.path.display().to_string();
        let whole = |problem: &String| StoreError::Damaged { file: file.clone(), problem: problem.clone() };
        let mut reading = Reading { attempts: Vec::new(), damage: self.damage.iter().map(whole).collect() };
        let mut statement = self.connection.prepare(&format!(
            "SELECT {COLUMNS}
             WHERE (?1 IS NULL OR pseudonym = ?1) AND (?2 IS NULL OR module = ?2) AND (?3 IS NULL OR level = ?3)
             ORDER BY at_s, attempts.id"
        ))?;
        let mut rows = statement.query(params![filter.trainee, filter.module, filter.level])?;
        let mut points = self.connection.prepare(POINTS)?;
        while let Some(row) = rows.next()? {
            match checked(&mut points, row) {
                Ok(attempt) => reading.attempts.push(attempt),
                Err(problem) => reading.damage.push(StoreError::Attempt {
                    file: file.clone(),
                    id: row.get::<_, i64>(0).map_or("?".into(), |id| id.to_string()),
                    trainee: row.get::<_, String>(1).unwrap_or_else(|_| "?".into()),
                    problem,
                }),
            }
        }
        Ok(reading)
    }
}

/// What is wrong with a database as a whole, in SQLite's words.
pub(super) fn damage(connection: &Connection) -> rusqlite::Result<Option<String>> {
    let found: String = connection.pragma_query_value(None, "integrity_check", |row| row.get(0))?;
    Ok((found != "ok").then(|| found.replace('\n', " ")))
}

/// Gives an attempt its checksum, or every attempt that has none; returns how many those were.
pub(super) fn seal(connection: &Connection, only: Option<i64>) -> rusqlite::Result<usize> {
    let mut statement = connection
        .prepare(&format!("SELECT {COLUMNS} WHERE checksum IS NULL AND (?1 IS NULL OR attempts.id = ?1)"))?;
    let (mut rows, mut points) = (statement.query([only])?, connection.prepare(POINTS)?);
    let mut sums = Vec::new();
    while let Some(row) = rows.next()? {
        let attempt = whole(&mut points, row)?;
        sums.push((attempt.id, checksum(&attempt)));
    }
    let mut write = connection.prepare("UPDATE attempts SET checksum = ?2 WHERE id = ?1")?;
    sums.iter().try_for_each(|(id, sum)| write.execute(params![id, sum]).map(drop))?;
    Ok(sums.len())
}

/// The attempt of a row, if it is what was kept.
fn checked(points: &mut Statement, row: &Row) -> Result<Stored, String> {
    let found = whole(points, row).map_err(|e| e.to_string())?;
    let kept: Option<String> = row.get(18).map_err(|e| e.to_string())?;
    if kept.as_ref() == Some(&checksum(&found)) {
        Ok(found)
    } else {
        Err("its checksum does not match".into())
    }
}

/// The attempt of a row with its points.
fn whole(points: &mut Statement, row: &Row) -> rusqlite::Result<Stored> {
    let mut found = stored(row)?;
    let Stored { id, attempt, .. } = &mut found;
    for (kind, into) in [("category", &mut attempt.categories), ("metric", &mut attempt.metrics)] {
        let rows = points.query_map(params![*id, kind], |row| {
            let (key, value, sigma) = (row.get(0)?, row.get(1)?, row.get(2)?);
            Ok(Points { key, value, sigma, points: row.get(3)?, of: row.get(4)? })
        })?;
        *into = rows.collect::<rusqlite::Result<_>>()?;
    }
    Ok(found)
}

/// SHA-256 of all that is given out of an attempt, in hexadecimal digits.
fn checksum(stored: &Stored) -> String {
    let Stored { id, trainee, at: _, attempt: a } = stored;
    let mut sum = Sum(Sha256::new());
    sum.number(*id as u64);
    sum.text(Some(trainee));
    sum.number(a.at_s as u64);
    for text in [Some(&a.module), a.surgeon.as_ref(), Some(&a.program)] {
        sum.text(text);
    }
    for text in [a.recording.as_ref(), a.recording_sha256.as_ref(), a.failed.as_ref()] {
        sum.text(text);
    }
    for n in [a.level, a.score_version, a.finished.into(), a.broken_off.into(), a.seed.is_some().into()] {
        sum.number(n.into());
    }
    sum.number(a.seed.unwrap_or(0));
    for x in [a.total, a.sigma, a.took_s] {
        sum.real(Some(x));
    }
    for points in [&a.categories, &a.metrics] {
        sum.number(points.len() as u64);
        for p in points {
            sum.text(Some(&p.key));
            for x in [p.value, p.sigma, Some(p.points), Some(p.of)] {
                sum.real(x);
            }
        }
    }
    sum.0.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A sum of fields, each with its length or presence before it.
struct Sum(Sha256);

impl Sum {
    fn number(&mut self, n: u64) {
        self.0.update(n.to_le_bytes());
    }

    fn text(&mut self, text: Option<&String>) {
        self.number(text.map_or(u64::MAX, |text| text.len() as u64));
        self.0.update(text.map_or("", |text| text));
    }

    fn real(&mut self, x: Option<f64>) {
        self.number(x.is_some().into());
        self.number(x.map_or(0, f64::to_bits));
    }
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
