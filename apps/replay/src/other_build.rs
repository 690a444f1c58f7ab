//! `vitreo replay FILE --with OTHER_VITREO`: one recording through two builds, and what they make of it
//! compared.
//!
//! Each build writes what it makes as a recording of its own (`replay FILE -o OUT`), from the same blobs, handles
//! and pedal, frame for frame; the other in a process of its own ([`program`]), at the same time. Both lie
//! in a folder that goes with the command.

pub mod program;

use crate::diff::comparison::Comparison;
use crate::diff::{self, text};
use crate::new_recording::NewRecording;
use crate::pace::Stopped;
use crate::stop::StopSignal;
use crate::what_if;
use anyhow::{Context, bail};
use ipc::logging::{inform, warn};
use outputs::exit::DIFFERS;
use outputs::{Outputs, Scratch, print, println};
use program::{Build, Ended};
use recording::{Provenance, Recording};
use settings::commands::{ReplayArgs, WhatIfArgs, WritingArgs};
use std::path::Path;
use std::process::ExitCode;

/// Runs it. Exit code 5 where the builds differ.
///
/// # Errors
/// Where the recording is refused, `program` is no vitreo, cannot record a replay, or fails, or a signal came.
pub fn run(args: &ReplayArgs, program: &Path) -> anyhow::Result<ExitCode> {
    let stop = StopSignal::install().context("signals")?;
    let mut outputs = Outputs::new(args.force.force).reading_all(recording::files_of(&args.file));
    args.report.iter().try_for_each(|report| outputs.claim(report))?;
    let recording = Recording::open(&args.file)?;
    let other = Build::ask(program, &stop)?;
    let scratch = Scratch::new()?;
    let [theirs, ours] = ["other.mcap", "this.mcap"].map(|name| scratch.path().join(name));
    run_both(&recording, &other, [&theirs, &ours], &stop)?;
    let [a, b] = diff::read(&theirs, &ours, true).with_context(|| format!("the result of {other}"))?;
    if stop.is_raised() {
        bail!(Stopped);
    }
    let versions = [&a.provenance, &b.provenance].map(versions);
    // What is shown is which build it is, not a name that is gone by then.
    let names =
        [format!("{}: {}", other.program.display(), versions[0]), format!("this build: {}", versions[1])];
    let mut comparison = Comparison::recorded(&a, &b, 0.0);
    [comparison.a, comparison.b] = names;
    println!("{} through two builds; {}", args.file.display(), difference(&versions));
    print!("{}", text::recorded(&comparison));
    diff::find_causes(&mut comparison, &a, &b);
    print!("{}", text::causes(&comparison));
    if let Some(report) = &args.report {
        outputs.write(report, serde_json::to_string_pretty(&comparison)? + "\n")?;
    }
    Ok(if comparison.same { ExitCode::SUCCESS } else { ExitCode::from(DIFFERS) })
}

/// Runs a recording through both builds at the same time.
fn run_both(
    recording: &Recording,
    other: &Build,
    [theirs, ours]: [&Path; 2],
    stop: &StopSignal,
) -> anyhow::Result<()> {
    let setting = what_if::setting(recording, &WhatIfArgs::default())?;
    let running = other.replay(recording.path(), theirs)?;
    let output = NewRecording::begin(ours, &WritingArgs::default(), &mut Outputs::new(false))?;
    let done = what_if::write(recording, &setting, &output, || stop.is_raised())?;
    output.appear()?;
    inform(&format!("this build: {} frames, {} steps; waiting for {other}", done.frames, done.steps));
    let ended = running.finish(stop)?;
    if let Some(lost) = done.lost {
        warn(&format!("{}: has gaps; the first: {lost}", recording.path().display()));
    } else if ended == Ended::WithLoss {
        warn(&format!("{other} reports gaps in {}; this build finds none", recording.path().display()));
    }
    Ok(())
}

/// Versions that a recording was made with, in words.
fn versions(provenance: &Provenance) -> String {
    let of = |key: &str| provenance.versions.get(key).map_or("unknown", String::as_str).to_owned();
    let tracker = match provenance.config.contains_key(recording::DESK) {
        true => String::new(),
        false => format!("tracker {}, ", of(recording::TRACKER)),
    };
    format!("vitreo {} ({tracker}states {})", of("vitreo"), of(recording::STATE_HASH))
}

/// How the versions differ, in words.
fn difference([a, b]: &[String; 2]) -> String {
    match a == b {
        true => format!("versions: both {a}"),
        false => format!("versions: {a} → {b}"),
    }
}
