//! `vitreo score`: the score of recordings, of what they hold or of what comes of their steps when
//! these are done again.
//!
//! - `resimulated`: every step again, and the score of that
//! - `batch`, `shards`: many recordings, into tables
//! - `objects`: recordings and tables in an object store

mod batch;
pub mod objects;
mod resimulated;
mod shards;

use anyhow::anyhow;
use ipc::logging::{warn, with_causes};
use objects::{Local, Store};
use outputs::exit::{DIFFERS, LOSS};
use outputs::{print, println};
use recording::states_incomparable;
use results::scored::{ScoredRecording, score_file};
use settings::commands::ScoreArgs;
use std::process::ExitCode;
use training::score::table::{Category, METRICS, PENALTIES};

/// Scores a recording wherever it lies; messages name it as it was named.
///
/// # Errors
/// Where it cannot be read, holds no task or cannot be simulated.
fn score_local(local: &Local, resimulate: bool) -> anyhow::Result<ScoredRecording> {
    let scored = if resimulate { resimulated::score(local.path()) } else { score_file(local.path()) };
    let Some(address) = local.address() else { return scored };
    match scored {
        Ok(scored) => {
            let damage = scored.damage.map(|damage| local.named(&damage));
            Ok(ScoredRecording { file: address, damage, ..scored })
        }
        Err(problem) => Err(anyhow!(local.named(&with_causes(problem.as_ref())))),
    }
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
    if batch::is_wanted(args) {
        return batch::run(args);
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
                warn(&format!("not scored: {}", with_causes(problem.as_ref())));
                code = code.max(LOSS);
            }
        }
    }
    Ok(ExitCode::from(code))
}

fn code_of(attempt: &ScoredRecording) -> u8 {
    if let Some(damage) = &attempt.damage {
        warn(&format!("only partly scored: {damage}"));
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
fn text(attempt: &ScoredRecording) -> String {
    use std::fmt::Write;
    let score = &attempt.score;
    let mut out = format!("{}\n", attempt.file);
    let end = match (attempt.ended, score.finished) {
        (true, true) => "finished",
        (true, false) => "time over",
        (false, _) => "not finished: scored up to its end",
    };
    let live = match (attempt.agrees, attempt.live_total) {
        (Some(true), _) => "identical to the live score".into(),
        (_, Some(live)) => format!("the run published {live:.3}"),
        (_, None) => "the run published none".into(),
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
