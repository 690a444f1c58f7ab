//! `vitreo score`: the score of recordings, without simulating again.

use crate::children::command;
use crate::cli::REPLAY;
use crate::exit::{DIFFERS, LOSS};
use crate::objects::{Local, Store};
use crate::score_batch::{self, BatchArgs};
use anyhow::{Context, anyhow, bail};
use ipc::logging::{arguments, is_json, warn};
use outputs::{STDOUT, print, println};
use recording::{Item, Recording, states_incomparable};
use scene::SceneFile;
use serde::Serialize;
use std::io::Write as _;
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};
use std::process::{Child, ExitCode, Stdio};
use training::score::recording::{LiveScore, Reader, Verdict};
use training::score::table::{Category, METRICS, PENALTIES};

/// Arguments of `vitreo score`.
#[derive(Debug, clap::Args)]
pub struct ScoreArgs {
    /// The recordings; of a folder every *.mcap in it and below. Also in an object store:
    /// s3://BUCKET/KEY.mcap, or all below s3://BUCKET/PREFIX/.
    #[arg(value_name = "FILE.mcap|DIR", required_unless_present_any = ["doc", "manifest", "gather"])]
    pub files: Vec<PathBuf>,
    /// What only batches have.
    #[command(flatten)]
    pub batch: BatchArgs,
    /// Let the simulation do every step again from the recorded poses and handles, and score what
    /// comes of it.
    #[arg(long)]
    pub resimulate: bool,
    /// One line of JSON for each recording.
    #[arg(long, conflicts_with_all = ["out", "csv", "parquet", "gather", "doc"])]
    pub json: bool,
    /// Print docs/score.md, which is made from the table of metrics.
    #[arg(long, conflicts_with = "files")]
    pub doc: bool,
}

/// An attempt as programs read it.
#[derive(Debug, Clone, Serialize)]
pub struct Attempt {
    /// The recording.
    pub file: String,
    /// Module of its scene.
    pub module: String,
    /// Level.
    pub level: u32,
    /// The attempt ended in the recording; else it is scored as far as it went.
    pub ended: bool,
    /// Time that passes in the recording, s.
    pub seconds: f64,
    /// Steps whose poses the recording misses.
    pub unmatched: u64,
    /// The score that the live run published, if it did.
    pub live_total: Option<f64>,
    /// Whether that is the same to the bit; `None` where the run published none, or by another
    /// version of the score.
    pub agrees: Option<bool>,
    /// Version of the recording's state hashes where it is not this build's, so that states could
    /// not be compared; only where it was resimulated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub other_state_hash_version: Option<u32>,
    /// What the recording's damage is, if it has some; the score is that of what comes before, or
    /// where it was resimulated of all that could be.
    pub damage: Option<String>,
    /// The score.
    #[serde(flatten)]
    pub score: training::score::Score,
}

/// Gives a recording's item to the score.
fn take(reader: &mut Reader, item: Item) {
    match item {
        Item::Poses(frame) => reader.take_poses(frame),
        Item::Event(event) => reader.take_event(event),
        Item::Step(step) => reader.take_step(&step),
        _ => {}
    }
}

/// Scores a recording. Damage ends it early and is reported; a recording without a task is an
/// error.
///
/// # Errors
/// Where the file is no recording, or holds no task.
pub fn score_file(file: &Path) -> anyhow::Result<Attempt> {
    let recording = Recording::open(file)?;
    let name = file.display().to_string();
    let scene = SceneFile::parse(&recording.provenance().scene_toml, &name).context("its scene")?;
    let Some((mut reader, task)) = Reader::new(&scene).zip(scene.task) else {
        bail!("{name}: its scene '{}' has no task: nothing to score", recording.provenance().scene_name);
    };
    let (mut damage, mut span) = (None, [u64::MAX, 0]);
    for item in recording.items_of(&Reader::TOPICS) {
        match item {
            Ok((at, item)) => {
                span = [span[0].min(at), span[1].max(at)];
                take(&mut reader, item);
            }
            Err(problem) => {
                damage = Some(problem.to_string());
                break;
            }
        }
    }
    let verdict: Verdict = reader.finish();
    Ok(Attempt {
        file: name,
        module: task.module,
        level: task.level,
        ended: verdict.ended,
        seconds: span[1].saturating_sub(span[0]) as f64 * 1e-9,
        unmatched: verdict.unmatched,
        live_total: verdict.live.total.map(|(points, _)| points),
        agrees: verdict.agrees(),
        other_state_hash_version: None,
        damage,
        score: verdict.score,
    })
}

/// Scores what the simulation makes of a recording's poses, handles and pedal when it does every
/// step again.
///
/// # Errors
/// Where the simulation refuses the recording, or it holds no task.
pub fn score_resimulated(file: &Path) -> anyhow::Result<Attempt> {
    // A file without a name, which nobody can leave behind.
    let again = tempfile::tempfile().context("a temporary file")?;
    let place = format!("/proc/self/fd/{}", again.as_raw_fd());
    let told = command(REPLAY)?
        .args(arguments())
        .arg("resimulate")
        .args([file, Path::new(STDOUT)])
        .stdout(again.try_clone().context("a temporary file")?)
        .stderr(Stdio::piped())
        .spawn()
        .and_then(Child::wait_with_output)
        .context("start vitreo-replay")?;
    let gaps = told.status.code() == Some(LOSS.into());
    let done = told.status.success() || gaps;
    if !done && is_json() {
        pass_on(&told.stderr);
        bail!("{}: not simulated again ({})", file.display(), told.status);
    }
    if !done {
        let why = String::from_utf8_lossy(&told.stderr);
        let why = why.lines().last().unwrap_or("it ended without a word");
        bail!("{}: not simulated again: {}", file.display(), why.trim_start_matches("vitreo-replay: "));
    }
    pass_on(&told.stderr);
    // The score of the live run stands in the recording; the copy holds that of the new steps.
    let (told, scored) = (score_file(file)?, score_file(Path::new(&place))?);
    let agrees = agrees_again(&told, scored.score.total);
    let other_state_hash_version = Recording::open(file)?.provenance().other_state_hash_version();
    Ok(Attempt {
        file: told.file,
        other_state_hash_version,
        seconds: told.seconds,
        live_total: told.live_total,
        agrees,
        damage: told
            .damage
            .or_else(|| gaps.then(|| format!("{}: inputs of steps are missing", file.display()))),
        ..scored
    })
}

/// Scores a recording wherever it lies; messages name it as it was named.
///
/// # Errors
/// As [`score_file`] and [`score_resimulated`].
pub fn score_local(local: &Local, resimulate: bool) -> anyhow::Result<Attempt> {
    let scored = if resimulate { score_resimulated(local.path()) } else { score_file(local.path()) };
    let Some(address) = local.address() else { return scored };
    match scored {
        Ok(scored) => {
            let damage = scored.damage.map(|damage| local.named(&damage));
            Ok(Attempt { file: address, damage, ..scored })
        }
        Err(problem) => Err(anyhow!(local.named(&format!("{problem:#}")))),
    }
}

/// Whether new steps lead to the score that the live run published; `None` where that is of another
/// version of the score, or there is none.
fn agrees_again(told: &Attempt, total: f64) -> Option<bool> {
    told.agrees.and(told.live_total).map(|live| live.to_bits() == total.to_bits())
}

/// Shows what another program wrote to standard error. A closed one is no reason to fail.
fn pass_on(text: &[u8]) {
    let _ = std::io::stderr().write_all(text);
}

/// Runs it. Exit code 3 where a recording could not be scored whole or resimulated states
/// not compared, 5 where a score differs from that of the run.
///
/// # Errors
/// Where a recording cannot be read or holds no task.
pub fn run(args: &ScoreArgs) -> anyhow::Result<ExitCode> {
    if args.doc {
        print!("{}", training::score::doc::page());
        return Ok(ExitCode::SUCCESS);
    }
    if args.batch.wanted(&args.files) {
        return score_batch::run(args);
    }
    let (mut code, alone, store) = (0, args.files.len() == 1, Store::new());
    for file in &args.files {
        let local = Local::of(file, &store);
        match local.map_err(Into::into).and_then(|local| score_local(&local, args.resimulate)) {
            Ok(attempt) => {
                code = code.max(code_of(&attempt));
                if args.json {
                    println!("{}", serde_json::to_string(&attempt)?);
                } else {
                    print!("{}", text(&attempt));
                }
            }
            Err(problem) if alone => return Err(problem),
            Err(problem) => {
                warn(&format!("not scored: {problem:#}"));
                code = code.max(LOSS);
            }
        }
    }
    Ok(ExitCode::from(code))
}

fn code_of(attempt: &Attempt) -> u8 {
    if let Some(damage) = &attempt.damage {
        warn(&format!("not scored whole: {damage}"));
    }
    if attempt.unmatched > 0 {
        warn(&format!("{}: {} steps have no poses and are not scored", attempt.file, attempt.unmatched));
    }
    if let Some(version) = attempt.other_state_hash_version {
        warn(&format!("{}: {}", attempt.file, states_incomparable(version)));
    }
    match (attempt.agrees, attempt.damage.is_some() || attempt.unmatched > 0) {
        (_, true) => LOSS,
        (Some(false), false) => DIFFERS,
        _ if attempt.other_state_hash_version.is_some() => LOSS,
        _ => 0,
    }
}

/// The attempt as a table.
fn text(attempt: &Attempt) -> String {
    use std::fmt::Write;
    let score = &attempt.score;
    let mut out = format!("{}\n", attempt.file);
    let end = match (attempt.ended, score.finished) {
        (true, true) => "finished",
        (true, false) => "time over",
        (false, _) => "not ended: scored as far as it goes",
    };
    let live = match (attempt.agrees, attempt.live_total) {
        (Some(true), _) => "the live score, to the bit".into(),
        (_, Some(live)) => format!("the run told {live:.3}"),
        (_, None) => "the run told none".into(),
    };
    // Writing into a string cannot fail.
    let end = score.failed.map_or(end.into(), |injury| format!("{end}, failed by {injury},"));
    let _ = writeln!(out, "  {} level {}: {end} after {:.2} s", attempt.module, attempt.level, score.took_s);
    let _ = writeln!(
        out,
        "  score {:.2} ± {:.2} of 100 (version {}; {live})",
        score.total, score.sigma, score.version
    );
    for category in Category::ALL {
        let points = score.categories[category as usize];
        let _ = writeln!(out, "  {:<22} {points:>7.2} of {:>5.1}", category.name(), category.points());
        let own = METRICS.iter().zip(&score.metrics).filter(|(m, _)| m.category == category);
        for (metric, reading) in own {
            let Some(value) = reading.value else { continue };
            let (points, of) = (reading.points, reading.of);
            let _ = writeln!(
                out,
                "    {:<32} {value:>9.3} {:<20} {points:>7.2} of {of:>5.1}",
                metric.name, metric.unit
            );
        }
    }
    for (penalty, count) in PENALTIES.iter().zip(score.injuries).filter(|(_, n)| *n > 0) {
        let serious = if penalty.serious { " (serious)" } else { "" };
        let _ = writeln!(out, "    {count} × {}{serious}", penalty.name);
    }
    out
}

/// The score of the live run, in words; empty where there was no task or no end of it.
pub fn live_text(live: &LiveScore) -> String {
    use std::fmt::Write;
    let Some((total, sigma)) = live.total else { return String::new() };
    let mut out = format!("score {total:.2} ± {sigma:.2} of 100 (version {})\n", live.version);
    for category in Category::ALL {
        if let Some(points) = live.categories[category as usize] {
            let _ = writeln!(out, "  {:<22} {points:>7.2} of {:>5.1}", category.name(), category.points());
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_score_of_another_version_neither_agrees_nor_differs() {
        let scene = surgeon::load("navigation").unwrap().level_scene(1).unwrap();
        let scorer = training::score::Scorer::of(&scene).unwrap();
        let score = scorer.score(&scorer.start());
        let told = |agrees| Attempt {
            file: String::new(),
            module: String::new(),
            level: 1,
            ended: true,
            seconds: 1.0,
            unmatched: 0,
            live_total: Some(97.5),
            agrees,
            other_state_hash_version: None,
            damage: None,
            score: score.clone(),
        };
        assert_eq!(agrees_again(&told(Some(true)), 97.5), Some(true));
        assert_eq!(agrees_again(&told(Some(true)), 97.4), Some(false));
        assert_eq!(agrees_again(&told(None), 97.4), None);
    }
}
