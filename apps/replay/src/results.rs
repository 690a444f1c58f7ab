//! `vitreo results`: what trainees achieved, from the results store.

use anyhow::{Context, bail};
use ipc::logging::{inform, warn, with_causes};
use outputs::exit::LOSS;
use outputs::{Outputs, print, println, save};
use recording::files_of;
use results::attempt::sha256_of;
use results::keeping::{self, ending, keys};
use results::store::{Filter, NamedRecording, Reading};
use results::table::Table;
use results::{Store, Stored, curve, parquet_file, plot, terminal};
use settings::commands::{ResultsArgs, ResultsCommand, StoreArgs, TERMINAL};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Trainees that a refusal names at most.
const NAMED: usize = 12;

/// Opens the store, or makes one where `make` says so; says what that has changed.
fn open(place: &StoreArgs, make: bool) -> anyhow::Result<Store> {
    let (store, notices) = keeping::open(place.store.as_deref(), make)?;
    notices.iter().for_each(|notice| inform(notice));
    Ok(store)
}

/// Adds a recording's attempt to the store; the outcome goes to standard error. The store is made when the first
/// recording has proved to hold an attempt.
fn keep(place: &StoreArgs, store: &mut Option<Store>, trainee: &str, file: &Path) -> anyhow::Result<()> {
    let attempt = keeping::scored_attempt(file)?;
    let store = match store {
        Some(store) => store,
        none => none.insert(open(place, true)?),
    };
    let kept = keeping::keep_attempt(store, trainee, file, attempt)?;
    kept.warnings.iter().for_each(|text| warn(text));
    if kept.is_new {
        inform(&kept.text)
    } else {
        warn(&kept.text)
    }
    Ok(())
}

/// Runs it.
///
/// # Errors
/// Where the store cannot be used, a filter is refused, or a file cannot be written.
pub fn run(args: &ResultsArgs) -> anyhow::Result<ExitCode> {
    match &args.what {
        None => show(args),
        Some(ResultsCommand::Add { place, trainee, files }) => add(place, trainee, files),
        Some(ResultsCommand::Delete { place, trainee, attempt, recordings }) => {
            delete(place, trainee, *attempt, *recordings)
        }
        Some(ResultsCommand::Trainees { place }) => {
            for (name, attempts) in open(place, false)?.trainees()? {
                println!("{name:<24} {attempts:>6} attempts");
            }
            Ok(ExitCode::SUCCESS)
        }
    }
}

fn add(place: &StoreArgs, trainee: &str, files: &[PathBuf]) -> anyhow::Result<ExitCode> {
    results::store::check_name(trainee)?;
    let (mut store, mut code) = (None, 0);
    for file in files {
        if let Err(problem) = keep(place, &mut store, trainee, file) {
            if files.len() == 1 {
                return Err(problem);
            }
            warn(&format!("not added: {}", with_causes(problem.as_ref())));
            code = LOSS;
        }
    }
    Ok(ExitCode::from(code))
}

fn delete(
    place: &StoreArgs,
    trainee: &str,
    attempt: Option<i64>,
    with_recordings: bool,
) -> anyhow::Result<ExitCode> {
    let path = keeping::place(place.store.as_deref())?;
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
    let is_there = |r: &&NamedRecording| files_of(Path::new(&r.path)).iter().any(|file| file.exists());
    for recording in recordings.iter().filter(is_there) {
        let path = &recording.path;
        match with_recordings.then(|| delete_recording(recording)) {
            None => println!("recording kept (delete it yourself, or use --recordings next time): {path}"),
            Some(Ok(())) => println!("deleted: {path}"),
            Some(Err(problem)) => {
                warn(&format!("not deleted: {path}: {}", with_causes(problem.as_ref())));
                code = ExitCode::from(LOSS);
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
    let there =
        if names.is_empty() { "no trainee is".into() } else { format!("{}{more} are", names.join(", ")) };
    bail!("{}: no trainee '{trainee}'; {there} in it", path.display())
}

/// Removes a recording if it still is that of the attempt, and of no other attempt.
fn delete_recording(recording: &NamedRecording) -> anyhow::Result<()> {
    let path = Path::new(&recording.path);
    if recording.shared {
        bail!("another attempt in the store refers to it");
    }
    if recording.sha256.as_ref().is_none_or(|known| sha256_of(path).is_ok_and(|found| found != *known)) {
        bail!("the file of that name is not the attempt's recording");
    }
    // All parts of one that was written in parts.
    Ok(files_of(path).iter().try_for_each(std::fs::remove_file)?)
}

fn show(args: &ResultsArgs) -> anyhow::Result<ExitCode> {
    let (trainee, module) = (args.trainee.clone(), args.module.clone());
    let place = keeping::place(args.place.store.as_deref())?;
    let mut outputs = Outputs::new(args.force.force).reading(&place);
    let plot = args.plot.as_deref().filter(|file| *file != Path::new(TERMINAL));
    for file in plot.into_iter().chain(args.csv.as_deref()).chain(args.parquet.as_deref()) {
        outputs.claim(file)?;
    }
    let store = open(&args.place, false)?;
    trainee.as_deref().map_or(Ok(()), |name| check_trainee(&store, &place, name))?;
    let Reading { attempts, damage } = store.read(&Filter { trainee, module, level: args.level })?;
    let writes_file = [args.plot.is_some(), args.csv.is_some(), args.parquet.is_some()].contains(&true);
    if !writes_file {
        print!("{}", list(&attempts));
    }
    if let Some(file) = &args.plot {
        draw(&attempts, &mut outputs, file)?;
    }
    if args.csv.is_some() || args.parquet.is_some() {
        let table = Table::of_store(&attempts, keys());
        write_tables(&table, &mut outputs, args.csv.as_deref(), args.parquet.as_deref())?;
    }
    damage.iter().for_each(|damaged| warn(&format!("omitted: {damaged}")));
    Ok(if damage.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(LOSS) })
}

fn draw(attempts: &[Stored], outputs: &mut Outputs, file: &Path) -> anyhow::Result<()> {
    let (curves, left_out) = curve::curves(attempts);
    if left_out > 0 {
        warn(&format!("{left_out} attempts are omitted: aborted, or scored by an older version"));
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
