//! `vitreo results`: what trainees achieved, from the results store.

use crate::score;
use anyhow::{Context, bail};
use ipc::logging::{inform, warn};
use outputs::{Force, Outputs, print, println, save};
use recording::Recording;
use results::attempt::sha256_of;
use results::store::{Filter, NamedRecording, Reading, default_place};
use results::table::{Keys, Table};
use results::{Attempt, Points, Store, Stored, curve, parquet_file, plot, terminal};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{SystemTime, UNIX_EPOCH};
use training::score::table::{Category, METRICS};

/// Key of a recording's configuration: the beginning of the run, seconds since 1970.
pub const BEGAN: &str = "began-s";
/// Key of the same: the level of skill of the scripted surgeon.
pub const SURGEON: &str = "surgeon";
pub use recording::DESK;
/// Trainees that a refusal names at most.
const NAMED: usize = 12;
/// Value of `--plot` without a file.
const TERMINAL: &str = "terminal";

/// Arguments of `vitreo results`.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct ResultsArgs {
    #[command(subcommand)]
    what: Option<What>,
    #[command(flatten)]
    place: Place,
    /// Only this trainee's attempts.
    #[arg(long, value_name = "NAME")]
    trainee: Option<String>,
    /// Only attempts at this module.
    #[arg(long, value_name = "NAME")]
    module: Option<String>,
    /// Only attempts at this level.
    #[arg(long, value_name = "N")]
    level: Option<u32>,
    /// Draw the learning curve, here or into a picture.
    #[arg(long, value_name = "FILE.png", num_args = 0..=1, default_missing_value = TERMINAL)]
    plot: Option<PathBuf>,
    /// Write every figure as comma-separated values; - is standard output.
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
    /// Write every figure as Parquet.
    #[arg(long, value_name = "FILE.parquet")]
    parquet: Option<PathBuf>,
    #[command(flatten)]
    force: Force,
}

/// Where the store lies.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Place {
    /// The results store [default: vitreo/results.sqlite in $XDG_DATA_HOME or ~/.local/share].
    #[arg(long, value_name = "FILE")]
    pub store: Option<PathBuf>,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Add the attempts in recordings.
    Add {
        #[command(flatten)]
        place: Place,
        /// Pseudonym of who made them.
        trainee: String,
        /// The recordings.
        #[arg(value_name = "FILE.mcap", required = true)]
        files: Vec<PathBuf>,
    },
    /// Delete one attempt of a trainee, or a trainee with every attempt.
    Delete {
        #[command(flatten)]
        place: Place,
        /// The pseudonym.
        trainee: String,
        /// Delete only this attempt, by its number in `vitreo results`.
        #[arg(long, value_name = "N")]
        attempt: Option<i64>,
        /// Delete the recordings too.
        #[arg(long)]
        recordings: bool,
    },
    /// List the trainees.
    Trainees {
        #[command(flatten)]
        place: Place,
    },
}

impl Place {
    /// The file.
    ///
    /// # Errors
    /// Where neither an option nor the home folder gives a place.
    pub fn path(&self) -> anyhow::Result<PathBuf> {
        let variable = |name: &str| std::env::var_os(name).map(PathBuf::from);
        let (data, home) = (variable("XDG_DATA_HOME"), variable("HOME"));
        let chosen = self.store.clone().or_else(|| default_place(data.as_deref(), home.as_deref()));
        chosen.context("neither --store nor HOME says where the results store lies")
    }
}

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
pub fn attempt_of(recording: &Recording, scored: &score::Attempt) -> Attempt {
    let provenance = recording.provenance();
    let began = provenance.config.get(BEGAN).and_then(|s| s.parse().ok());
    // Older recordings do not say when they were made; the file does, nearly.
    let written = || std::fs::metadata(recording.path()).and_then(|m| m.modified()).ok();
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
        recording: Some(own.canonicalize().unwrap_or_else(|_| own.to_path_buf()).display().to_string()),
        recording_sha256: None,
    }
}

/// Scores a recording and adds it to the store; the outcome goes to standard error.
///
/// # Errors
/// Where the recording cannot be scored, or the store not be written.
pub fn keep(store: &mut Store, trainee: &str, file: &Path) -> anyhow::Result<()> {
    let scored = score::score_file(file)?;
    if let Some(damage) = &scored.damage {
        bail!("{damage}; an attempt that cannot be read to its end is not kept");
    }
    if !scored.ended && scored.score.took_s == 0.0 {
        bail!("{}: the attempt was not begun and is not kept", file.display());
    }
    let mut attempt = attempt_of(&Recording::open(file)?, &scored);
    let sha256 = sha256_of(file).with_context(|| file.display().to_string())?;
    check_holders(&store.holders(&sha256)?, trainee, &attempt, file)?;
    attempt.recording_sha256 = Some(sha256);
    match store.add(trainee, &attempt)? {
        Some(id) => {
            let end = ending(&attempt).map_or(String::new(), |end| format!(", {end}"));
            inform(&format!("kept as attempt {id} of {trainee}: {:.2} points{end}", attempt.total));
        }
        None => warn(&format!("{}: {trainee} has this attempt already; nothing was added", file.display())),
    }
    Ok(())
}

/// Refuses a recording that is another trainee's attempt: nobody else made it. One that the trainee has
/// with an older score is kept anew, and that is said.
fn check_holders(
    holders: &[(String, i64, u32)],
    trainee: &str,
    attempt: &Attempt,
    file: &Path,
) -> anyhow::Result<()> {
    let file = file.display();
    if let Some((other, id, _)) = holders.iter().find(|(holder, ..)| holder != trainee) {
        bail!(
            "{file}: this recording is attempt {id} of {other}; vitreo results delete {other} --attempt {id} takes it from there"
        );
    }
    for (_, id, version) in holders.iter().filter(|(.., version)| *version != attempt.score_version) {
        warn(&format!("{file}: is attempt {id} of {trainee} by version {version} of the score, too"));
    }
    Ok(())
}

/// Opens a store, or makes one where `make` says so; says what that has changed. The default folder is
/// the store's alone, and is closed to other users with it.
///
/// # Errors
/// Where there is no such store, or it cannot be used.
pub fn open(place: &Place, make: bool) -> anyhow::Result<Store> {
    let path = place.path()?;
    let store = if make { Store::open_or_create(&path)? } else { Store::open(&path)? };
    store.notices().iter().for_each(|notice| inform(notice));
    if place.store.is_none() {
        path.parent().and_then(results::store::mend_folder).iter().for_each(|notice| inform(notice));
    }
    Ok(store)
}

/// How an attempt ended, where it did not end well.
fn ending(attempt: &Attempt) -> Option<String> {
    match (&attempt.failed, attempt.broken_off, attempt.finished) {
        (Some(injury), broken_off, _) => {
            Some(format!("failed: {injury}{}", if broken_off { ", broken off" } else { "" }))
        }
        (None, true, _) => Some("broken off".into()),
        (None, false, false) => Some("not finished".into()),
        (None, false, true) => None,
    }
}

/// Runs it.
///
/// # Errors
/// Where the store cannot be used, a filter is refused, or a file cannot be written.
pub fn run(args: &ResultsArgs) -> anyhow::Result<ExitCode> {
    match &args.what {
        None => show(args),
        Some(What::Add { place, trainee, files }) => add(place, trainee, files),
        Some(What::Delete { place, trainee, attempt, recordings }) => {
            delete(place, trainee, *attempt, *recordings)
        }
        Some(What::Trainees { place }) => {
            for (name, attempts) in open(place, false)?.trainees()? {
                println!("{name:<24} {attempts:>6} attempts");
            }
            Ok(ExitCode::SUCCESS)
        }
    }
}

fn add(place: &Place, trainee: &str, files: &[PathBuf]) -> anyhow::Result<ExitCode> {
    results::store::check_name(trainee)?;
    let mut store = open(place, true)?;
    let mut code = 0;
    for file in files {
        if let Err(problem) = keep(&mut store, trainee, file) {
            if files.len() == 1 {
                return Err(problem);
            }
            warn(&format!("not kept: {problem:#}"));
            code = crate::exit::LOSS;
        }
    }
    Ok(ExitCode::from(code))
}

fn delete(
    place: &Place,
    trainee: &str,
    attempt: Option<i64>,
    with_recordings: bool,
) -> anyhow::Result<ExitCode> {
    let path = place.path()?;
    let mut store = open(place, false)?;
    check_trainee(&store, &path, trainee)?;
    let recordings = match attempt {
        Some(id) => {
            let Some(recordings) = store.delete_attempt(trainee, id)? else {
                bail!(
                    "{}: {trainee} has no attempt {id}; vitreo results --trainee {trainee} lists them",
                    path.display()
                );
            };
            println!("attempt {id} of {trainee} deleted");
            recordings
        }
        None => {
            let (attempts, recordings) = store.delete(trainee)?.unwrap_or_default();
            println!("{trainee} and {attempts} attempts deleted");
            recordings
        }
    };
    let mut code = ExitCode::SUCCESS;
    for recording in recordings.iter().filter(|r| Path::new(&r.path).exists()) {
        let path = &recording.path;
        match with_recordings.then(|| delete_recording(recording)) {
            None => println!("left in place (--recordings deletes it): {path}"),
            Some(Ok(())) => println!("deleted: {path}"),
            Some(Err(problem)) => {
                warn(&format!("not deleted: {path}: {problem:#}"));
                code = ExitCode::from(crate::exit::LOSS);
            }
        }
    }
    Ok(code)
}

/// Refuses a pseudonym that the store does not know, and names those it does.
fn check_trainee(store: &Store, path: &Path, trainee: &str) -> anyhow::Result<()> {
    let known = store.trainees()?;
    if known.iter().any(|(name, _)| name == trainee) {
        return Ok(());
    }
    let names: Vec<&str> = known.iter().take(NAMED).map(|(name, _)| name.as_str()).collect();
    let more = if known.len() > NAMED { ", …" } else { "" };
    let there = if names.is_empty() { "nobody is".into() } else { format!("{}{more} are", names.join(", ")) };
    bail!("{}: no trainee '{trainee}'; {there} in it", path.display())
}

/// Removes a recording if it is that of the attempt still, and nobody else's.
fn delete_recording(recording: &NamedRecording) -> anyhow::Result<()> {
    let path = Path::new(&recording.path);
    if recording.shared {
        bail!("another attempt in the store names it");
    }
    if recording.sha256.as_ref().is_none_or(|known| sha256_of(path).is_ok_and(|found| found != *known)) {
        bail!("the file of that name is another one than the attempt's recording");
    }
    Ok(std::fs::remove_file(path)?)
}

fn show(args: &ResultsArgs) -> anyhow::Result<ExitCode> {
    let (trainee, module) = (args.trainee.clone(), args.module.clone());
    let place = args.place.path()?;
    let mut outputs = Outputs::new(args.force.force).reading(&place);
    let plot = args.plot.as_deref().filter(|file| *file != Path::new(TERMINAL));
    for file in plot.into_iter().chain(args.csv.as_deref()).chain(args.parquet.as_deref()) {
        outputs.claim(file)?;
    }
    let store = open(&args.place, false)?;
    trainee.as_deref().map_or(Ok(()), |name| check_trainee(&store, &place, name))?;
    let Reading { attempts, damage } = store.read(&Filter { trainee, module, level: args.level })?;
    let told = [args.plot.is_some(), args.csv.is_some(), args.parquet.is_some()].contains(&true);
    if !told {
        print!("{}", list(&attempts));
    }
    if let Some(file) = &args.plot {
        draw(&attempts, &mut outputs, file)?;
    }
    if args.csv.is_some() || args.parquet.is_some() {
        let table = Table::of_store(&attempts, keys());
        write_tables(&table, &mut outputs, args.csv.as_deref(), args.parquet.as_deref())?;
    }
    damage.iter().for_each(|damaged| warn(&format!("left out: {damaged}")));
    Ok(if damage.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(crate::exit::LOSS) })
}

fn draw(attempts: &[Stored], outputs: &mut Outputs, file: &Path) -> anyhow::Result<()> {
    let (curves, left_out) = curve::curves(attempts);
    if left_out > 0 {
        warn(&format!("{left_out} attempts are left out: broken off, or with a score of an older version"));
    }
    if file == Path::new(TERMINAL) {
        print!("{}", terminal::plot(&curves));
        return Ok(());
    }
    Ok(outputs.write(file, plot::png(&curves)?)?)
}

/// Writes a table into the files that are asked for.
///
/// # Errors
/// Where a file cannot be written.
pub fn write_tables(
    table: &Table,
    outputs: &mut Outputs,
    csv: Option<&Path>,
    parquet: Option<&Path>,
) -> anyhow::Result<()> {
    if let Some(file) = csv {
        save(outputs.create(file)?, |out| table.write_csv(out).with_context(|| file.display().to_string()))?;
    }
    if let Some(file) = parquet {
        write_parquet(table, outputs, file, &[])?;
    }
    Ok(())
}

/// Writes a table as a Parquet file with notes.
///
/// # Errors
/// Where the file cannot be written.
pub fn write_parquet(
    table: &Table,
    outputs: &mut Outputs,
    file: &Path,
    notes: &[(&str, &str)],
) -> anyhow::Result<()> {
    save(outputs.create(file)?, |out| {
        parquet_file::write(table, out, notes).with_context(|| file.display().to_string())
    })
}

/// The attempts, a line each.
fn list(attempts: &[Stored]) -> String {
    use std::fmt::Write;
    let mut text = String::new();
    if !attempts.is_empty() {
        let heads = ["attempt", "when", "trainee", "module", "level", "score", "time"];
        let [id, at, trainee, module, level, score, took] = heads;
        // Writing into a string cannot fail.
        let _ =
            writeln!(text, "{id:>7}  {at:<20}  {trainee:<16} {module:<14} {level:>5} {score:>15} {took:>8}");
    }
    for Stored { id, trainee, at, attempt: a } in attempts {
        let score = format!("{:.2} ± {:.2}", a.total, a.sigma);
        let end = ending(a).map_or(String::new(), |end| format!("  {end}"));
        let script = a.surgeon.as_ref().map_or(String::new(), |who| format!("  (script: {who})"));
        let _ = writeln!(
            text,
            "{id:>7}  {at:<20}  {trainee:<16} {:<14} {:>5} {score:>15} {:>6.1} s{end}{script}",
            a.module, a.level, a.took_s
        );
    }
    let _ = writeln!(text, "{} attempts", attempts.len());
    text
}

#[cfg(test)]
mod tests;
