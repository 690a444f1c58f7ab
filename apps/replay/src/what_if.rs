//! What-if: the blobs, handles and pedal of a recording through tracker and simulation with another rig,
//! another scene or other constants, as a recording of its own.
//!
//! Frames and steps are those of the recording: each frame gets the camera-fields that the recorded one
//! consumed, each step the new poses of the recorded step's frame and the handle and pedal states that it
//! consumed. So what differs comes of the change alone. The new recording says of which one it is, and what
//! was changed ([`changed`]); it verifies to the bit as a live one does.
//!
//! - [`keys`]: what may be set; [`outcome`]: what comes of it, item by item; [`beginning`]: of recordings that were
//!   cut

pub mod beginning;
pub mod keys;
pub mod outcome;

use crate::new_recording::{NewRecording, claim};
use crate::pace::Stopped;
use crate::resimulate::scene_of;
use anyhow::{Context, bail};
use beginning::Beginning;
use ipc::logging::{inform, warn};
use keys::{SCENE, TRACKER, assign, tuning_of};
use outcome::{Outcome, Setting};
use outputs::Outputs;
use outputs::exit::{LOSS, WrongUse};
use outputs::progress::counter;
use protocol::file::{MAX_SETTINGS_BYTES, read_text};
use protocol::steps::STATE_HASH_VERSION;
use recording::{DESK, Provenance, Recording, STATE_HASH, Source, TRACKER_VERSION, files_of};
use rig::Rig;
use scene::SceneFile;
use settings::commands::{ReplayArgs, WhatIfArgs};
use std::path::Path;
use std::process::ExitCode;
use tracker::Tuning;
use tracker::tuning::TUNABLE;

/// Key of the recording that a what-if is of, in its configuration.
pub const OF: &str = "what-if.of";
/// Key of what was changed.
pub const CHANGED: &str = "what-if.changed";

/// Runs it. Exit code 3 where the recording has gaps.
///
/// # Errors
/// Where recording, rig, scene or a setting is refused, or the output cannot be written.
pub fn run(args: &ReplayArgs) -> anyhow::Result<ExitCode> {
    let Some(path) = &args.what_if.output else { bail!("--output is missing") };
    let mut outputs = Outputs::new(args.force.force).reading_all(files_of(&args.file));
    outputs = outputs.reading_all(args.what_if.rig.iter());
    outputs = outputs.reading_all(args.what_if.scene.iter());
    claim(path, &args.writing, &mut outputs)?;
    let recording = Recording::open(&args.file)?;
    let setting = setting(&recording, &args.what_if)?;
    let output = NewRecording::begin(path, &args.writing, &mut outputs)?;
    let done = write(&recording, &setting, &output, || false)?;
    output.appear()?;
    inform(&format!(
        "{}: {} frames, {} steps; changed: {}",
        path.display(),
        done.frames,
        done.steps,
        changed(&setting)
    ));
    Beginning::of(&recording, &setting)?.text().iter().for_each(|text| inform(text));
    if let Some(lost) = &done.lost {
        warn(&format!("{}: has gaps; the first: {lost}", args.file.display()));
    }
    Ok(ExitCode::from(if done.lost.is_some() { LOSS } else { 0 }))
}

/// Writes what comes of a recording, until that is `stopped`.
///
/// # Errors
/// Where nothing can be made of it, the output cannot be written, or it was stopped.
pub fn write(
    recording: &Recording,
    setting: &Setting,
    output: &NewRecording,
    stopped: impl Fn() -> bool,
) -> anyhow::Result<outcome::Done> {
    let bar = counter("steps");
    let mut writer = output.writer(&setting.provenance)?;
    let done = Outcome::new(recording, setting)?.run(|at, item| {
        if matches!(item, recording::Item::Step(_)) {
            bar.inc(1);
        }
        if stopped() {
            bail!(Stopped);
        }
        Ok(writer.write(at, item)?)
    })?;
    writer.finish()?;
    bar.finish_and_clear();
    Ok(done)
}

/// What a recording is run again with.
///
/// # Errors
/// Where rig, scene or a setting is refused, or does not go with the recording.
pub fn setting(recording: &Recording, args: &WhatIfArgs) -> anyhow::Result<Setting> {
    let recorded = recording.provenance();
    let (rig_json, named) = match &args.rig {
        Some(path) => (
            read_text(path, MAX_SETTINGS_BYTES).with_context(|| path.display().to_string())?,
            path.display().to_string(),
        ),
        None => (recorded.rig_json.clone(), "of the recording".into()),
    };
    let rig = Rig::parse(&rig_json, &named)?;
    tracker::rig_check::check(&rig).with_context(|| format!("the rig {named} is not usable"))?;
    let mut scene = match &args.scene {
        Some(name) => SceneFile::load(name)?,
        None => scene_of(recording)?,
    };
    let mut tuning = tuning_of(recorded)?;
    assign(&args.set, &mut tuning, &mut scene)?;
    let tracks = args.rig.is_some() || args.set.iter().any(|set| set.key.starts_with(TRACKER));
    if recorded.config.contains_key(DESK) && tracks {
        let file = recording.path().display();
        bail!(WrongUse(format!(
            "--rig, --set {TRACKER}…: {file} was recorded at a desk, without cameras and tracker"
        )));
    }
    let mut setting = Setting { rig, scene, tuning, provenance: recorded.clone() };
    setting.provenance.rig_json = rig_json;
    setting.provenance.scene_toml = setting.scene.to_toml();
    if let Some(name) = &args.scene {
        setting.provenance.scene_name.clone_from(name);
    }
    complete(&mut setting, recorded, args, recording.path());
    Ok(setting)
}

/// Says in the provenance what it is of, what was changed, and what made it.
fn complete(setting: &mut Setting, recorded: &Provenance, args: &WhatIfArgs, file: &Path) {
    let mut changed = Vec::new();
    if recorded.rig_json != setting.provenance.rig_json {
        changed.extend(args.rig.iter().map(|path| format!("rig {}", path.display())));
    }
    if is_other_scene(recorded, &setting.scene) {
        changed.extend(args.scene.iter().map(|name| format!("scene {name}")));
        let of_scene = args.set.iter().filter(|set| set.key.starts_with(SCENE));
        changed.extend(of_scene.map(|set| format!("{}={}", set.key, set.value)));
    }
    let before = tuning_of(recorded).unwrap_or_default().values();
    let values = setting.tuning.values();
    let config = &mut setting.provenance.config;
    for ((row, value), before) in TUNABLE.iter().zip(values).zip(before) {
        let key = format!("{TRACKER}{}", row.key);
        if value != before {
            changed.push(format!("{key}={value}"));
        }
        // Written so that it is read back to the bit.
        let other = value != row.default;
        if other { drop(config.insert(key, format!("{value:?}"))) } else { drop(config.remove(&key)) }
    }
    config.insert(OF.into(), file.display().to_string());
    config.insert(CHANGED.into(), if changed.is_empty() { "nothing".into() } else { changed.join(", ") });
    let desk = config.contains_key(DESK);
    setting.provenance.source = Source::Live;
    let versions = &mut setting.provenance.versions;
    versions.insert("vitreo".into(), env!("CARGO_PKG_VERSION").into());
    versions.insert(STATE_HASH.into(), STATE_HASH_VERSION.to_string());
    if !desk {
        versions.insert(recording::TRACKER.into(), TRACKER_VERSION.to_string());
    }
}

/// Whether the simulation depends on what differs of two scenes.
fn is_other_scene(recorded: &Provenance, scene: &SceneFile) -> bool {
    let before = SceneFile::parse(&recorded.scene_toml, "recorded");
    !before.is_ok_and(|before| before.without_script() == scene.without_script())
}

/// What was changed, in words.
pub fn changed(setting: &Setting) -> &str {
    setting.provenance.config.get(CHANGED).map_or("nothing", String::as_str)
}

/// Whether a command line asks for it.
pub fn is_wanted(args: &WhatIfArgs) -> bool {
    args.output.is_some()
}

/// The tuning that a recording was made with, or the usual one, with a warning, where this build does not
/// know it.
pub fn tuning_or_default(provenance: &Provenance) -> Tuning {
    tuning_of(provenance).unwrap_or_else(|problem| {
        warn(&format!("{problem:#}: using the default constants"));
        Tuning::default()
    })
}

#[cfg(test)]
mod tests;
