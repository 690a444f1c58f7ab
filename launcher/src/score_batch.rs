//! `vitreo score` over many recordings: in parallel, in shards, into tables.

use crate::exit::{DIFFERS, LOSS};
use crate::progress::files_bar;
use crate::replay::states_incomparable;
use crate::results::{attempt_of, keys, write_parquet, write_tables};
use crate::runtime::{StopSignal, block_on};
use crate::score::{self, ScoreArgs, score_file};
use anyhow::bail;
use ipc::logging::{inform, warn};
use outputs::{Force, Outputs, println};
use recording::Recording;
use results::batch::{Row, Shard, list, work};
use results::table::Table;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// Arguments of a batch.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct BatchArgs {
    /// Score the recordings that a file lists, one path a line, from the file's folder on.
    #[arg(long, value_name = "FILE")]
    pub manifest: Option<PathBuf>,
    /// Score only this machine's share: part I of N, counted from 0.
    #[arg(long, value_name = "I/N")]
    pub shard: Option<Shard>,
    /// Write the scores as Parquet into this folder, one file for each shard.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write the scores as comma-separated values; - is standard output.
    #[arg(long, value_name = "FILE.csv")]
    pub csv: Option<PathBuf>,
    /// Recordings scored at the same time [default: as many as there are processors].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub jobs: Option<u32>,
    /// Whether tables that exist are written over.
    #[command(flatten)]
    pub force: Force,
}

impl BatchArgs {
    /// Whether it is a batch: several recordings or a folder are named, or something is asked for
    /// that only batches have.
    pub fn wanted(&self, named: &[PathBuf]) -> bool {
        let asked =
            self.manifest.is_some() || self.shard.is_some() || self.out.is_some() || self.csv.is_some();
        asked || named.iter().any(|path| path.is_dir())
    }
}

/// Scores them. Exit code 3 where a recording could not be scored whole, 5 where a score differs
/// from that of the run.
///
/// # Errors
/// Where a list or folder cannot be read, a table cannot be written, or a signal stops it.
pub fn run(args: &ScoreArgs) -> anyhow::Result<ExitCode> {
    block_on(async { score_all(args, &StopSignal::install()?.flag()) })
}

fn score_all(asked: &ScoreArgs, stop: &AtomicBool) -> anyhow::Result<ExitCode> {
    let args = &asked.batch;
    let shard = args.shard.unwrap_or(Shard::WHOLE);
    let all = list(&asked.files, args.manifest.as_deref())?;
    let own = shard.of(&all);
    let file = args.out.as_ref().map(|folder| folder.join(shard.file_name()));
    let mut outputs = Outputs::new(args.force.force).reading_all(&own).reading_all(&args.manifest);
    for file in args.csv.iter().chain(&file) {
        outputs.claim(file)?;
    }
    let begun = Instant::now();
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let jobs = args.jobs.map_or(processors, |n| n as usize);
    let bar = files_bar(own.len() as u64, "score");
    let done = work(&own, jobs, stop, |path| score_one(path, asked.resimulate), |_| bar.inc(1));
    bar.finish_and_clear();
    let (rows, scored): (Vec<Row>, Vec<Option<score::Attempt>>) = done.into_iter().unzip();
    // What a shard that was stopped leaves would be taken for the whole of it.
    if rows.len() < own.len() {
        bail!("stopped after {} of {} recordings; nothing was written", rows.len(), own.len());
    }
    let table = Table::of_batch(&rows, &keys());
    if asked.json {
        for (row, scored) in rows.iter().zip(&scored) {
            println!("{}", json(row, scored)?);
        }
    } else if args.csv.is_none() && args.out.is_none() {
        rows.iter().for_each(|row| println!("{}", line(row)));
    }
    write_tables(&table, &mut outputs, args.csv.as_deref(), None)?;
    if let Some(file) = &file {
        let share = format!("{}/{}", shard.index, shard.count);
        let listed = all.len().to_string();
        write_parquet(&table, &mut outputs, file, &[("shard", share.as_str()), ("listed", listed.as_str())])?;
        inform(&file.display().to_string());
    }
    Ok(ExitCode::from(summary(&rows, begun.elapsed().as_secs_f64())))
}

/// Scores one recording; what is wrong with it stands in the row.
fn score_one(path: &Path, resimulate: bool) -> (Row, Option<score::Attempt>) {
    let scored = if resimulate { score::score_resimulated(path) } else { score_file(path) };
    let whole = scored.and_then(|scored| {
        Ok((row(path, attempt_of(&Recording::open(path)?, &scored), &scored), Some(scored)))
    });
    whole.unwrap_or_else(|problem| {
        // The row names the file already.
        let (told, name) = (format!("{problem:#}"), format!("{}: ", path.display()));
        let problem = told.strip_prefix(&name).unwrap_or(&told).to_owned();
        (Row { file: path.into(), problem: Some(problem), ..Row::default() }, None)
    })
}

/// A line for programs: that of a single recording, or what is wrong with one that has no score.
fn json(row: &Row, scored: &Option<score::Attempt>) -> serde_json::Result<String> {
    match scored {
        Some(attempt) => serde_json::to_string(attempt),
        None => serde_json::to_string(&serde_json::json!({ "file": row.file, "problem": row.problem })),
    }
}

fn row(path: &Path, attempt: results::Attempt, scored: &score::Attempt) -> Row {
    Row {
        file: path.into(),
        problem: problem(scored),
        seconds: scored.seconds,
        ended: scored.ended,
        agrees: scored.agrees,
        attempt: Some(attempt),
    }
}

fn problem(scored: &score::Attempt) -> Option<String> {
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

/// Tells what went wrong and how fast it was; returns the exit code.
fn summary(rows: &[Row], wall_s: f64) -> u8 {
    for row in rows {
        if let Some(problem) = &row.problem {
            let how = if row.attempt.is_some() { "scored in part" } else { "not scored" };
            warn(&format!("{how}: {}: {problem}", row.file.display()));
        }
        if row.agrees == Some(false) {
            warn(&format!("differs from the score of the run: {}", row.file.display()));
        }
    }
    let seconds: f64 = rows.iter().map(|r| r.seconds).sum();
    let damaged = rows.iter().filter(|r| r.problem.is_some()).count();
    let differing = rows.iter().filter(|r| r.agrees == Some(false)).count();
    inform(&format!(
        "{} recordings, {damaged} with problems, {differing} differing; {seconds:.1} s in {wall_s:.2} s ({:.0} times real time)",
        rows.len(),
        seconds / wall_s.max(1e-9)
    ));
    match (differing, damaged) {
        (1.., _) => DIFFERS,
        (0, 1..) => LOSS,
        (0, 0) => 0,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use recording::{Provenance, Writer};
    use surgeon::skill::EXPERT;

    /// A recording of an attempt that was broken off before anything happened.
    pub(crate) fn broken_off(file: &Path) {
        let scene = surgeon::compose(&surgeon::load("navigation").unwrap(), 1, &EXPERT, 1).unwrap();
        let mut provenance = Provenance { scene_toml: scene.to_toml(), ..Provenance::default() };
        provenance.rig_json = protocol::rig::Rig::load_or_shipped(None).unwrap().to_json();
        provenance.seeds.insert("cameras".into(), "42".into());
        provenance.config.insert(crate::results::BEGAN.into(), "1032942600".into());
        Writer::create(file, &provenance).unwrap().finish().unwrap();
    }

    #[test]
    fn a_batch_scores_what_it_can_and_writes_its_shards() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("in")).unwrap();
        for name in ["a", "b", "c", "d"] {
            broken_off(&at("in").join(format!("{name}.mcap")));
        }
        std::fs::write(at("in/c.mcap"), "torn").unwrap();
        std::fs::write(at("list.txt"), "in/a.mcap\nin/b.mcap\nin/c.mcap\nin/d.mcap\n").unwrap();
        let shard = |index| {
            let batch = BatchArgs {
                force: Force { force: true },
                manifest: Some(at("list.txt")),
                shard: Some(Shard { index, count: 2 }),
                out: Some(at("out")),
                csv: Some(at(&format!("{index}.csv"))),
                jobs: Some(2),
            };
            let args = ScoreArgs { files: vec![], batch, resimulate: false, json: false, doc: false };
            let code = run(&args).unwrap();
            (format!("{code:?}"), std::fs::read_to_string(at(&format!("{index}.csv"))).unwrap())
        };
        let ((damaged, first), (whole, second)) = (shard(0), shard(1));
        assert_eq!([damaged, whole], [LOSS, 0].map(|code| format!("{:?}", ExitCode::from(code))));
        let rows: Vec<&str> = first.lines().skip(1).chain(second.lines().skip(1)).collect();
        let names: Vec<&str> = rows.iter().map(|r| &r[r.find(".mcap").unwrap() - 1..][..1]).collect();
        assert_eq!(names, ["a", "c", "b", "d"], "every second one");
        assert!(
            rows[0].contains(",navigation,1,") && rows[0].contains(",42,") && !rows[1].contains("navigation")
        );
        assert!(
            rows[1].contains("c.mcap") && rows[1].contains("does not begin as an MCAP file"),
            "{}",
            rows[1]
        );
        assert!(
            at("out/scores-00000-of-00002.parquet").is_file()
                && at("out/scores-00001-of-00002.parquet").is_file()
        );
    }

    #[test]
    fn what_cannot_be_scored_is_a_row_with_its_reason() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.mcap");
        std::fs::write(&file, "torn").unwrap();
        let told = |(row, scored): &(Row, Option<score::Attempt>)| -> serde_json::Value {
            serde_json::from_str(&json(row, scored).unwrap()).unwrap()
        };
        let one = score_one(&file, false);
        let (damaged, told_of_damaged) = (one.0.clone(), told(&one));
        assert_eq!(told_of_damaged["file"], file.display().to_string());
        assert!(told_of_damaged["problem"].as_str().is_some_and(|p| !p.is_empty()), "{told_of_damaged}");
        broken_off(&folder.path().join("b.mcap"));
        let whole = told(&score_one(&folder.path().join("b.mcap"), false));
        assert_eq!((whole["module"].as_str(), whole["ended"].as_bool()), (Some("navigation"), Some(false)));
        assert!(damaged.attempt.is_none() && damaged.problem.as_ref().is_some_and(|p| !p.contains("a.mcap")));
        let good = Row { attempt: Some(results::Attempt::default()), ended: true, ..Row::default() };
        let differing = Row { agrees: Some(false), ..good.clone() };
        assert_eq!(summary(std::slice::from_ref(&good), 1.0), 0);
        assert_eq!(summary(&[good.clone(), damaged.clone()], 1.0), LOSS);
        assert_eq!(summary(&[damaged, differing.clone(), good], 1.0), DIFFERS);
        assert!(line(&differing).contains("differs"));
    }
}
