//! `vitreo diff`: two recordings beside each other, from their inputs to what came of them, and the cause
//! of what differs.
//!
//! - [`side`]: what is read of each; [`inputs`], [`poses`], [`events`], [`outcome`], [`provenance`]: what
//!   differs, stage by stage; [`spectrum`]: pose differences in bands of frequency
//! - [`causes`]: the catalogue of causes; `from_provenance` reads them from rig, scene and settings,
//!   `from_inputs` and `exchanged` from presence, stamps and blobs ([`blobs`] matches them, [`models`] says what each cause
//!   does to them)
//! - [`comparison`]: all of it together; `text` and [`page`]: for people; [`instant`], `pictures`: where
//!   the difference is largest, drawn

pub mod blobs;
pub mod causes;
pub mod comparison;
pub mod events;
mod exchanged;
mod from_inputs;
mod from_provenance;
pub mod inputs;
pub mod instant;
pub mod models;
pub mod outcome;
pub mod page;
mod pictures;
pub mod poses;
pub mod provenance;
pub mod side;
pub mod spectrum;
pub mod text;

use anyhow::Context;
use comparison::Comparison;
use ipc::logging::warn;
use outputs::exit::DIFFERS;
use outputs::progress::counter;
use outputs::{Outputs, STDOUT, print};
use plots::{Format, bytes};
use settings::commands::DiffArgs;
use side::Side;
use std::path::Path;
use std::process::ExitCode;

/// Runs it. Exit code 5 where the recordings differ by more than the tolerance.
///
/// # Errors
/// Where a file is no recording, or an output cannot be written.
pub fn run(args: &DiffArgs) -> anyhow::Result<ExitCode> {
    let mut outputs = Outputs::new(args.force.force)
        .reading_all([&args.a, &args.b].into_iter().flat_map(|file| recording::files_of(file)));
    for path in [&args.json, &args.plot, &args.html].into_iter().flatten() {
        outputs.claim(path)?;
    }
    let [a, b] = read(&args.a, &args.b, !args.quick)?;
    let mut comparison = Comparison::recorded(&a, &b, args.tolerance);
    for (side, name) in [(&a, "A"), (&b, "B")] {
        side.losses.iter().take(1).for_each(|loss| warn(&format!("{name} is incomplete: {loss}")));
    }
    let shows = args.json.as_deref() != Some(Path::new(STDOUT));
    if shows {
        print!("{}", text::recorded(&comparison));
    }
    find_causes(&mut comparison, &a, &b);
    if shows {
        print!("{}", text::causes(&comparison));
    }
    if let Some(path) = &args.plot {
        outputs.write(path, bytes(&page::plot(&comparison), Format::of(path)?)?)?;
    }
    if let Some(path) = &args.html {
        let instant = instant::of(&comparison, &a, &b);
        let pictures = instant.as_ref().map(|at| pictures::both(&args.a, &args.b, at));
        outputs.write(path, page::html(&comparison, instant.as_ref().zip(pictures.as_ref()))?)?;
    }
    if let Some(path) = &args.json {
        outputs.write(path, serde_json::to_string_pretty(&comparison)? + "\n")?;
    }
    Ok(if comparison.same { ExitCode::SUCCESS } else { ExitCode::from(DIFFERS) })
}

/// Finds the causes, and shows how far the search is.
pub fn find_causes(comparison: &mut Comparison, a: &Side, b: &Side) {
    let bar = counter("steps of the search for causes");
    comparison.find_causes(a, b, &|| bar.inc(1));
    bar.finish_and_clear();
}

/// Reads both recordings at the same time.
///
/// # Errors
/// Where one of them is no recording.
pub fn read(a: &Path, b: &Path, with_score: bool) -> anyhow::Result<[Side; 2]> {
    let bar = counter("items read");
    let read = |file: &Path| Side::read(file, with_score, |items| bar.inc(items));
    let [a, b] = std::thread::scope(|scope| {
        let other = scope.spawn(|| read(b));
        [read(a), other.join().expect("reading does not panic")]
    });
    bar.finish_and_clear();
    Ok([a.context("A")?, b.context("B")?])
}

#[cfg(test)]
mod tests;
