//! Attempts in recordings, into the store.

use crate::attempt::sha256_of;
use crate::scored::{ScoredRecording, score_file};
use crate::store::{Store, StoreError, default_place, mend_folder};
use crate::table::Keys;
use crate::{Attempt, Points};
use anyhow::{Context, bail};
use recording::Recording;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};
use training::score::table::{Category, METRICS};

/// Key of a recording's configuration: the beginning of the run, seconds since 1970.
pub const BEGAN: &str = "began-s";
/// Key of the same: the level of skill of the scripted surgeon.
pub const SURGEON: &str = "surgeon";

/// Columns of the table of scores: those of this build's score.
pub fn keys() -> Keys {
    Keys {
        categories: Category::ALL.iter().map(|c| c.key().to_owned()).collect(),
        metrics: METRICS.iter().map(|m| m.key.to_owned()).collect(),
    }
}

/// Seconds since 1970.
pub fn seconds_since_1970(at: SystemTime) -> i64 {
    at.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs() as i64)
}

/// The attempt in a recording as the store keeps it, without the recording's hash.
pub fn attempt_of(recording: &Recording, scored: &ScoredRecording) -> Attempt {
    let provenance = recording.provenance();
    let began = provenance.config.get(BEGAN).and_then(|s| s.parse().ok());
    // Older recordings do not say when they were made; the file does, nearly.
    let written = || std::fs::metadata(last_file_of(recording)).and_then(|m| m.modified()).ok();
    let (score, own) = (&scored.score, recording.path());
    let category = |(c, points): (&Category, &f64)| Points {
        key: c.key().into(),
        points: *points,
        of: c.points(),
        ..Points::default()
    };
    let metric = |m: &training::score::Reading| Points {
        key: m.key.into(),
        value: m.value,
        sigma: m.value.map(|_| m.sigma),
        points: m.points,
        of: m.of,
    };
    Attempt {
        at_s: began.or_else(|| written().map(seconds_since_1970)).unwrap_or(0),
        module: scored.module.clone(),
        level: scored.level,
        surgeon: provenance.config.get(SURGEON).cloned(),
        program: provenance.versions.get("vitreo").cloned().unwrap_or_default(),
        score_version: score.version,
        seed: provenance.seeds.get("cameras").and_then(|s| s.parse().ok()),
        total: score.total,
        sigma: score.sigma,
        finished: score.finished,
        broken_off: !scored.ended,
        failed: score.failed.map(Into::into),
        took_s: score.took_s,
        categories: Category::ALL.iter().zip(&score.categories).map(category).collect(),
        metrics: score.metrics.iter().map(metric).collect(),
        recording: Some(place_of(own).display().to_string()),
        recording_sha256: None,
    }
}

/// The path of a recording from the root on, whether or not there is a file of its name.
fn place_of(recording: &Path) -> PathBuf {
    let absolute = || std::path::absolute(recording).unwrap_or_else(|_| recording.to_path_buf());
    recording.canonicalize().unwrap_or_else(|_| absolute())
}

/// The file of a recording that was written last.
fn last_file_of(recording: &Recording) -> PathBuf {
    recording::files_of(recording.path()).pop().unwrap_or_else(|| recording.path().into())
}

/// What became of an attempt that was to be kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Kept {
    /// In a sentence.
    pub text: String,
    /// It was not there before.
    pub is_new: bool,
    /// What else is to be known of it.
    pub warnings: Vec<String>,
}

/// Scores a recording and adds it to the store.
///
/// # Errors
/// Where the recording cannot be scored, or the store not be written.
pub fn keep(store: &mut Store, trainee: &str, file: &Path) -> anyhow::Result<Kept> {
    keep_attempt(store, trainee, file, scored_attempt(file)?)
}

/// Scores a recording.
///
/// # Errors
/// If it cannot be read to its end, or its attempt was never started.
pub fn scored_attempt(file: &Path) -> anyhow::Result<Attempt> {
    let scored = score_file(file)?;
    if let Some(damage) = &scored.damage {
        bail!("{damage}; an attempt that cannot be read to its end is not added");
    }
    if !scored.ended && scored.score.took_s == 0.0 {
        bail!("{}: the attempt was never started and is not added", file.display());
    }
    let mut attempt = attempt_of(&Recording::open(file)?, &scored);
    let sha256 = sha256_of(file).with_context(|| file.display().to_string())?;
    attempt.recording_sha256 = Some(sha256);
    Ok(attempt)
}

/// Adds the attempt of a recording to the store.
///
/// # Errors
/// If the store cannot be written, or another trainee has that attempt.
pub fn keep_attempt(store: &mut Store, trainee: &str, file: &Path, attempt: Attempt) -> anyhow::Result<Kept> {
    let sha256 = attempt.recording_sha256.as_deref().unwrap_or_default();
    let warnings = check_holders(&store.holders(sha256)?, trainee, &attempt, file)?;
    let id = store.add(trainee, &attempt)?;
    let text = match id {
        Some(id) => {
            let end = ending(&attempt).map_or(String::new(), |end| format!(", {end}"));
            format!("added as attempt {id} of {trainee}: {:.2} points{end}", attempt.total)
        }
        None => format!("{}: {trainee} has this attempt already; nothing was added", file.display()),
    };
    Ok(Kept { text, is_new: id.is_some(), warnings })
}

/// Refuses a recording that is another trainee's attempt. A recording that the trainee already
/// has with an older score is kept again; the returned sentences say so.
fn check_holders(
    holders: &[(String, i64, u32)],
    trainee: &str,
    attempt: &Attempt,
    file: &Path,
) -> anyhow::Result<Vec<String>> {
    let file = file.display();
    if let Some((other, id, _)) = holders.iter().find(|(holder, ..)| holder != trainee) {
        bail!(
            "{file}: this recording is attempt {id} of {other}; vitreo results delete {other} --attempt \
             {id} removes it there"
        );
    }
    let older = holders.iter().filter(|(.., version)| *version != attempt.score_version);
    let text = |version: &u32, id: &i64| {
        format!("{file}: is also attempt {id} of {trainee}, with score version {version}")
    };
    Ok(older.map(|(_, id, version)| text(version, id)).collect())
}

/// How an attempt ended, where it did not end well.
pub fn ending(attempt: &Attempt) -> Option<String> {
    match (&attempt.failed, attempt.broken_off, attempt.finished) {
        (Some(injury), broken_off, _) => {
            Some(format!("failed: {injury}{}", if broken_off { ", aborted" } else { "" }))
        }
        (None, true, _) => Some("aborted".into()),
        (None, false, false) => Some("not finished".into()),
        (None, false, true) => None,
    }
}

/// Where the store lies: the file that was named, or the user's own.
///
/// # Errors
/// Where neither an option nor the home folder gives a place.
pub fn place(named: Option<&Path>) -> anyhow::Result<PathBuf> {
    let variable = |name: &str| std::env::var_os(name).map(PathBuf::from);
    let (data, home) = (variable("XDG_DATA_HOME"), variable("HOME"));
    let chosen = named.map(Into::into).or_else(|| default_place(data.as_deref(), home.as_deref()));
    chosen.context("no path for the results store: give --store FILE or set HOME")
}

/// Opens a store, or makes one where `make` says so; with what that has changed. The default folder is
/// the store's alone, and is closed to other users with it.
///
/// # Errors
/// Where there is no such store, or it cannot be used.
pub fn open(named: Option<&Path>, make: bool) -> anyhow::Result<(Store, Vec<String>)> {
    let path = place(named)?;
    let store = if make { Store::open_or_create(&path)? } else { Store::open(&path)? };
    let folder = path.parent().filter(|_| named.is_none()).and_then(mend_folder);
    let notices = store.notices().iter().cloned().chain(folder).collect();
    Ok((store, notices))
}

/// Whether an error is a name that no trainee can have, not a failure of the store; `None` for errors of
/// another kind.
pub fn is_wrong_use(cause: &(dyn Error + 'static)) -> Option<bool> {
    cause.downcast_ref().map(|error| matches!(error, StoreError::Value { field: "trainee", .. }))
}

#[cfg(test)]
mod tests;
