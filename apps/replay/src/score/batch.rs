//! `vitreo score` over many recordings: in parallel, in shards, into tables.

use super::objects::{Address, Local, ObjectError, Store};
use super::score_local;
use super::shards::{Place, Written, gather, only_path};
use crate::results::write_tables;
use crate::stop::StopSignal;
use anyhow::{Context, bail, ensure};
use ipc::logging::{inform, warn, with_causes};
use outputs::exit::{DIFFERS, LOSS};
use outputs::progress::files_bar;
use outputs::{Outputs, println};
use protocol::file::{MAX_TABLE_BYTES, read_text};
use recording::{Recording, files_of, states_incomparable};
use results::attempt::sha256_of;
use results::batch::{Row, Shard, work};
use results::keeping::{attempt_of, keys};
use results::listing::{self, List, is_address};
use results::scored::ScoredRecording;
use results::shards::Origin;
use results::table::{Cells, Table};
use settings::commands::ScoreArgs;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Whether it is a batch: several recordings or a folder are named, or something is asked for that
/// only batches have.
pub fn is_wanted(args: &ScoreArgs) -> bool {
    let batch = &args.batch;
    let places = [&batch.manifest, &batch.out, &batch.gather, &batch.csv, &batch.parquet];
    let asked = batch.shard.is_some() || places.iter().any(|place| place.is_some());
    let many = |path: &PathBuf| path.is_dir() || Address::parse(path).is_ok_and(|a| !a.is_recording());
    asked || args.files.iter().any(many)
}

/// Scores them. Exit code 3 where a recording could not be scored whole, 5 where a score differs
/// from that of the run.
///
/// # Errors
/// Where a list or folder cannot be read, a table cannot be written, an object store cannot be
/// reached, shards to be put together are not whole, or a signal stops it.
pub fn run(args: &ScoreArgs) -> anyhow::Result<ExitCode> {
    only_path("--csv", args.batch.csv.as_deref())?;
    only_path("--parquet", args.batch.parquet.as_deref())?;
    let store = Store::new();
    match &args.batch.gather {
        Some(place) => put_together(args, &Place::of(place, &store)?, &store),
        None => score_all(args, &store, StopSignal::install().context("signals")?.flag()),
    }
}

fn put_together(asked: &ScoreArgs, place: &Place<'_>, store: &Store) -> anyhow::Result<ExitCode> {
    let args = &asked.batch;
    let mut outputs = Outputs::new(args.force.force).reading_all(&args.gather).reading_all(&args.manifest);
    for file in args.csv.iter().chain(&args.parquet) {
        outputs.claim(file)?;
    }
    let whole = gather(place)?;
    let mut repeated = 0;
    if args.manifest.is_some() || !asked.files.is_empty() {
        let list = listed(asked, store)?;
        let named = digest_of(&list.recordings());
        repeated = tell_repeated(&list, &list.recordings());
        let listed = whole.origin.listed;
        ensure!(
            named == whole.origin.list_sha256,
            "the tables belong to another list than the one given ({listed} recordings); nothing was written"
        );
    }
    write_tables(&whole.table, &mut outputs, args.csv.as_deref(), args.parquet.as_deref())?;
    Ok(ExitCode::from(summary(&whole.table, repeated, None)))
}

/// The recordings that are asked for.
fn listed(asked: &ScoreArgs, store: &Store) -> anyhow::Result<List> {
    let mut list = List::default();
    for named in &asked.files {
        if !is_address(named) {
            list.add_path(named)?;
            continue;
        }
        let address = Address::parse(named)?;
        if address.is_recording() {
            list.add(named.clone());
            continue;
        }
        let recordings: Vec<_> = store.list(&address)?.into_iter().filter(Address::is_recording).collect();
        ensure!(!recordings.is_empty(), "{address}: expected recordings (*.mcap) below it, found none");
        recordings.into_iter().for_each(|recording| list.add(recording.to_string().into()));
    }
    if let Some(manifest) = &asked.batch.manifest {
        let (text, folder) = if is_address(manifest) {
            let address = Address::parse(manifest)?;
            (store.text(&address, MAX_TABLE_BYTES)?, address.folder())
        } else {
            let text =
                read_text(manifest, MAX_TABLE_BYTES).with_context(|| manifest.display().to_string())?;
            (text, manifest.parent().unwrap_or(Path::new("")).into())
        };
        listing::lines(&text, &folder).into_iter().for_each(|recording| list.add(recording));
    }
    Ok(list)
}

fn digest_of(recordings: &[PathBuf]) -> String {
    let names: Vec<String> = recordings.iter().map(|file| file.display().to_string()).collect();
    listing::digest(names.iter().map(String::as_str))
}

fn score_all(asked: &ScoreArgs, store: &Store, stop: &AtomicBool) -> anyhow::Result<ExitCode> {
    let args = &asked.batch;
    let shard = args.shard.and_then(|[index, count]| Shard::new(index, count)).unwrap_or(Shard::WHOLE);
    let list = listed(asked, store)?;
    let all = list.recordings();
    let own = shard.of(&all);
    let (listed, list_sha256) = (all.len() as u64, digest_of(&all));
    let origin = Origin { shard, listed, list_sha256, made: made(asked.resimulate) };
    let place = args.out.as_ref().map(|out| Place::of(out, store)).transpose()?;
    let found = place.as_ref().filter(|_| args.resume).map(|place| found(place, &origin)).transpose()?;
    let repeated = tell_repeated(&list, &own);
    let files: Vec<PathBuf> = own.iter().flat_map(|file| files_of(file)).collect();
    let inputs = || files.iter().chain(&args.manifest);
    let mut outputs = Outputs::new(args.force.force).reading_all(inputs());
    for file in args.csv.iter().chain(&args.parquet) {
        outputs.claim(file)?;
    }
    if let Some(Found::Whole(table)) = found {
        write_tables(&table, &mut outputs, args.csv.as_deref(), args.parquet.as_deref())?;
        return Ok(ExitCode::from(summary(&table, repeated, None)));
    }
    let replace = args.force.force || matches!(found, Some(Found::Damaged));
    let mut shards = Outputs::new(replace).reading_all(inputs());
    if let Some(place) = &place {
        place.claim(shard, &mut shards)?;
    }
    let begun = Instant::now();
    let (rows, scored) = score_each(asked, store, &own, stop)?;
    let table = Table::of_batch(&rows, &keys());
    show(asked, &rows, &scored)?;
    write_tables(&table, &mut outputs, args.csv.as_deref(), args.parquet.as_deref())?;
    if let Some(place) = &place {
        write_shard(place, &origin, &table, &mut shards, args.resume)?;
    }
    Ok(ExitCode::from(summary(&table, repeated, Some(begun.elapsed().as_secs_f64()))))
}

/// Prints the rows, where they go nowhere else.
fn show(asked: &ScoreArgs, rows: &[Row], scored: &[Option<ScoredRecording>]) -> anyhow::Result<()> {
    let args = &asked.batch;
    if asked.json {
        for (row, scored) in rows.iter().zip(scored) {
            println!("{}", json(row, scored)?);
        }
    } else if args.csv.is_none() && args.out.is_none() && args.parquet.is_none() {
        rows.iter().for_each(|row| println!("{}", line(row)));
    }
    Ok(())
}

/// How scores are computed; shards are compared by it.
fn made(resimulate: bool) -> String {
    let how = if resimulate { ", resimulated" } else { "" };
    format!("vitreo {}, score version {}{how}", env!("CARGO_PKG_VERSION"), training::score::table::VERSION)
}

/// What an earlier try left in the place of a shard's table.
enum Found {
    Nothing,
    /// Not whole: to be written over.
    Damaged,
    Whole(Table),
}

/// Looks whether a shard is done.
fn found(place: &Place<'_>, origin: &Origin) -> anyhow::Result<Found> {
    let name = place.name(origin.shard);
    match place.read(origin.shard)? {
        None => Ok(Found::Nothing),
        Some(Err(problem)) => {
            warn(&format!("{name}: {problem}; scored again"));
            Ok(Found::Damaged)
        }
        Some(Ok(done)) => {
            let how = done.origin.differs(origin);
            ensure!(
                how.is_empty(),
                "{name}: already exists and belongs to another {how}; use another folder for this batch"
            );
            inform(&format!("{name}: complete, skipped"));
            Ok(Found::Whole(done.table))
        }
    }
}

fn write_shard(
    place: &Place<'_>,
    origin: &Origin,
    table: &Table,
    outputs: &mut Outputs,
    resume: bool,
) -> anyhow::Result<()> {
    let name = place.name(origin.shard);
    match place.write(origin, table, outputs)? {
        Written::Now => inform(&name),
        // Two of the same shard, of which one was taken for dead: either table will do.
        Written::Before if resume && matches!(found(place, origin)?, Found::Whole(_)) => {}
        Written::Before => bail!("{name}: already exists; use --force to overwrite it"),
    }
    Ok(())
}

/// Reports the shard's recordings that the list names more than once; returns the number of repetitions.
fn tell_repeated(list: &List, own: &[PathBuf]) -> u64 {
    let own: HashSet<&PathBuf> = own.iter().collect();
    let repeated = list.repeated().into_iter().filter(|repeated| own.contains(&repeated.file));
    repeated.fold(0, |more, repeated| {
        warn(&format!("named {} times, scored once: {}", repeated.times, repeated.file.display()));
        more + repeated.times - 1
    })
}

type Scored = (Row, Option<ScoredRecording>);

/// Scores a shard's recordings, all or none.
fn score_each(
    asked: &ScoreArgs,
    store: &Store,
    own: &[PathBuf],
    stop: &AtomicBool,
) -> anyhow::Result<(Vec<Row>, Vec<Option<ScoredRecording>>)> {
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let jobs = asked.batch.jobs.map_or(processors, |n| n as usize);
    let bar = files_bar(own.len() as u64, "score");
    let failed: Mutex<Option<ObjectError>> = Mutex::new(None);
    let refused = AtomicUsize::new(0);
    let each = |path: &Path| match score_one(path, store, asked.resimulate, &refused) {
        Ok(scored) => Some(scored),
        Err(problem) => {
            failed.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(problem);
            stop.store(true, Ordering::Relaxed);
            None
        }
    };
    let done = work(own, jobs, stop, each, |_| bar.inc(1));
    bar.finish_and_clear();
    let (rows, scored): (Vec<Row>, Vec<_>) = done.into_iter().flatten().unzip();
    let stopped = || format!("stopped after {} of {} recordings; nothing was written", rows.len(), own.len());
    if let Some(problem) = failed.into_inner().unwrap_or_else(PoisonError::into_inner) {
        return Err(anyhow::Error::new(problem).context(stopped()));
    }
    // What a shard that was stopped leaves would be taken for the whole of it.
    ensure!(rows.len() == own.len(), stopped());
    // One that is refused is a finding; all of them are wrong credentials.
    if let Some(first) = rows.first().filter(|_| refused.load(Ordering::Relaxed) == rows.len()) {
        let why = first.problem.as_deref().unwrap_or_default();
        bail!("{}: {why}; so are all {} recordings; nothing was written", first.file.display(), rows.len());
    }
    Ok((rows, scored))
}

/// Scores one recording; what is wrong with it stands in the row. Counts those that the object store
/// refuses.
///
/// # Errors
/// Where the object store fails, which says nothing of the recording.
fn score_one(
    path: &Path,
    store: &Store,
    resimulate: bool,
    refused: &AtomicUsize,
) -> Result<Scored, ObjectError> {
    let local = match Local::of(path, store) {
        Ok(local) => local,
        Err(problem) if problem.is_of_object() => {
            refused.fetch_add(matches!(problem, ObjectError::Refused { .. }).into(), Ordering::Relaxed);
            return Ok((unscored(path, None, &problem.to_string()), None));
        }
        Err(problem) => return Err(problem),
    };
    let sha256 = sha256_of(local.path()).ok();
    let scored = score_local(&local, resimulate).and_then(|scored| {
        let attempt = attempt_of(&Recording::open(local.path())?, &scored);
        Ok((local.address().map_or(attempt.clone(), |address| named(attempt, address)), scored))
    });
    Ok(match scored {
        Ok((attempt, scored)) => (row(path, sha256, attempt, &scored), Some(scored)),
        Err(problem) => (unscored(path, sha256, &local.named(&with_causes(problem.as_ref()))), None),
    })
}

fn named(attempt: results::Attempt, address: String) -> results::Attempt {
    results::Attempt { recording: Some(address), ..attempt }
}

/// The row of a recording without a score.
fn unscored(path: &Path, sha256: Option<String>, message: &str) -> Row {
    // The row names the file already.
    let problem = message.strip_prefix(&format!("{}: ", path.display())).unwrap_or(message).to_owned();
    Row { file: path.into(), problem: Some(problem), sha256, ..Row::default() }
}

/// A line for programs: that of a single recording, or what is wrong with one that has no score.
fn json(row: &Row, scored: &Option<ScoredRecording>) -> serde_json::Result<String> {
    match scored {
        Some(attempt) => serde_json::to_string(attempt),
        // A name may be no UTF-8, which JSON has no way to write.
        None => {
            let file = row.file.display().to_string();
            serde_json::to_string(&serde_json::json!({ "file": file, "problem": row.problem }))
        }
    }
}

fn row(path: &Path, sha256: Option<String>, attempt: results::Attempt, scored: &ScoredRecording) -> Row {
    Row {
        file: path.into(),
        problem: problem(scored),
        seconds: scored.seconds,
        ended: scored.ended,
        agrees: scored.agrees,
        attempt: Some(attempt),
        sha256,
    }
}

fn problem(scored: &ScoredRecording) -> Option<String> {
    let unmatched = (scored.unmatched > 0).then(|| format!("{} steps have no poses", scored.unmatched));
    let incomparable = scored.other_state_hash_version.map(states_incomparable);
    scored.damage.clone().or(unmatched).or(incomparable)
}

/// A row for people.
fn line(row: &Row) -> String {
    let score = row.attempt.as_ref().map_or_else(
        || "not scored".into(),
        |a| format!("{:>6.2} ± {:<5.2} {} {}", a.total, a.sigma, a.module, a.level),
    );
    let note = match (row.attempt.is_some(), row.ended, row.agrees) {
        (true, _, Some(false)) => ", differs from the score of the run",
        (true, false, _) => ", not ended",
        _ => "",
    };
    format!("{score}{note}  {}", row.file.display())
}

/// Reports what failed, by name and in numbers, and the speed; returns the exit code.
fn summary(table: &Table, repeated: u64, wall_s: Option<f64>) -> u8 {
    let scored = |row: usize| table.texts("module").get(row).is_some_and(Option::is_some);
    let agrees = if let Some(Cells::Truth(cells)) = table.column("agrees") { cells.as_slice() } else { &[] };
    let (problems, same) = (table.texts("problem"), table.texts("same_as"));
    for (row, file) in table.texts("file").iter().enumerate() {
        let file = file.as_deref().unwrap_or_default();
        if let Some(problem) = &problems[row] {
            let how = if scored(row) { "scored in part" } else { "not scored" };
            warn(&format!("{how}: {file}: {problem}"));
        }
        if agrees[row] == Some(false) {
            warn(&format!("differs from the score of the run: {file}"));
        }
        if let Some(first) = &same[row] {
            warn(&format!("same content as {first}: {file}"));
        }
    }
    if table.rows == 0 {
        inform("no recordings to score");
        return 0;
    }
    let there = |cells: &[Option<String>]| cells.iter().flatten().count();
    let (damaged, same) = (there(problems), there(same));
    let differing = agrees.iter().filter(|agrees| **agrees == Some(false)).count();
    let mut text = format!("{} recordings, {damaged} with problems, {differing} differing", table.rows);
    if repeated > 0 {
        text += &format!(", {repeated} named again");
    }
    if same > 0 {
        text += &format!(", {same} of the same content as another");
    }
    if let (Some(wall_s), Some(Cells::Real(seconds))) = (wall_s, table.column("seconds")) {
        let seconds: f64 = seconds.iter().flatten().sum();
        let pace = seconds / wall_s.max(1e-9);
        text += &format!("; {seconds:.1} s in {wall_s:.2} s ({pace:.0} times real time)");
    }
    inform(&text);
    match (differing, damaged) {
        (1.., _) => DIFFERS,
        (0, 1..) => LOSS,
        (0, 0) => 0,
    }
}

#[cfg(test)]
mod tests;
