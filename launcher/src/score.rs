//! `vitreo score`: the score of recordings, without simulating again.

use crate::exit::{DIFFERS, LOSS};
use anyhow::{Context, bail};
use modules::score::recording::{Live, Reader, Verdict};
use modules::score::table::{Category, METRICS, PENALTIES};
use protocol::recording::Recording;
use protocol::scene_file::SceneFile;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Arguments of `vitreo score`.
#[derive(Debug, clap::Args)]
pub struct ScoreArgs {
    /// The recordings.
    #[arg(value_name = "FILE.mcap", required_unless_present = "doc")]
    pub files: Vec<PathBuf>,
    /// One line of JSON for each recording.
    #[arg(long)]
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
    /// Steps whose poses the recording misses.
    pub unmatched: u64,
    /// What the live run told, if it did.
    pub live_total: Option<f64>,
    /// Whether that is the same to the bit; `None` where the run told none, or by another version of the score.
    pub agrees: Option<bool>,
    /// What the recording's damage is, if it has some; the score is that of what comes before.
    pub damage: Option<String>,
    /// The score.
    #[serde(flatten)]
    pub score: modules::score::Score,
}

/// Scores a recording. Damage ends it early and is told; a recording without a task is an error.
pub fn score_file(file: &Path) -> anyhow::Result<Attempt> {
    let recording = Recording::open(file)?;
    let name = file.display().to_string();
    let scene = SceneFile::parse(&recording.provenance().scene_toml, &name).context("its scene")?;
    let Some((mut reader, task)) = Reader::new(&scene).zip(scene.task) else {
        bail!("{name}: its scene '{}' has no task: nothing to score", recording.provenance().scene_name);
    };
    let mut damage = None;
    for item in recording.items_of(&Reader::TOPICS) {
        match item {
            Ok((_, item)) => reader.take(item),
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
        unmatched: verdict.unmatched,
        live_total: verdict.live.total.map(|(points, _)| points),
        agrees: verdict.agrees(),
        damage,
        score: verdict.score,
    })
}

/// Runs it. Exit code 3 where a recording could not be scored whole, 5 where a score differs from what the run told.
pub fn run(args: &ScoreArgs) -> anyhow::Result<ExitCode> {
    if args.doc {
        print!("{}", modules::score::doc::page());
        return Ok(ExitCode::SUCCESS);
    }
    let (mut code, alone) = (0, args.files.len() == 1);
    for file in &args.files {
        match score_file(file) {
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
                eprintln!("vitreo: not scored: {problem:#}");
                code = code.max(LOSS);
            }
        }
    }
    Ok(ExitCode::from(code))
}

fn code_of(attempt: &Attempt) -> u8 {
    if let Some(damage) = &attempt.damage {
        eprintln!("vitreo: scored up to the damage: {damage}");
    }
    if attempt.unmatched > 0 {
        eprintln!("vitreo: {}: {} steps have no poses and are not scored", attempt.file, attempt.unmatched);
    }
    match (attempt.agrees, attempt.damage.is_some() || attempt.unmatched > 0) {
        (_, true) => LOSS,
        (Some(false), false) => DIFFERS,
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
        let _ = writeln!(out, "    {count} × {}", penalty.name);
    }
    out
}

/// What the live run told, in words; empty where there was no task or no end of it.
pub fn live_text(live: &Live) -> String {
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
