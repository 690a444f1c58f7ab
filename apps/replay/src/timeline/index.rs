//! The index of a recording that has no checkpoints of use to this build: an earlier one, one that was damaged
//! before its first checkpoint, or an imported stream.
//!
//! The recording is played once, and the checkpoints that a run would have made are written beside it, as a
//! recording of their own: `NAME.mcap.index`, or in the user's cache where the folder takes no file. Of an
//! imported stream the index holds the frames and steps too, which the stream lacks, and is then what is
//! played. An index names the recording and the versions that it was made of and by; one of others is made
//! again.

use super::pairs::Pairs;
use super::{Timeline, saving, streamed};
use crate::engine::Recorded;
use crate::resimulate::scene_of;
use crate::stop::StopSignal;
use anyhow::Context;
use outputs::progress::bytes_bar;
use outputs::{GrowingFile, Outputs};
use protocol::checkpoints::CheckpointTimes;
use protocol::message::fnv1a;
use protocol::steps::STATE_HASH_VERSION;
use recording::{
    Provenance, Recording, RecordingError, STATE_HASH, Source, TRACKER, TRACKER_VERSION, Writer, files_of,
};
use rig::Rig;
use simcore::world::World;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Key of the recording that an index belongs to, among its configuration.
const INDEX_OF: &str = "index-of";
/// Version of what an index holds.
const VERSION: u32 = 1;
/// Bytes at the beginning and at the end of a recording that name it.
const NAMED_BY: u64 = 64 << 10;

/// Opens the timeline of a recording; where its own checkpoints do not serve, with the index of it, which is
/// made first where there is none.
///
/// # Errors
/// Where the recording cannot be read or replayed, or `stop` is raised meanwhile.
pub fn open(recording: &Recording, stop: &StopSignal) -> anyhow::Result<Timeline> {
    open_at(recording, &places(recording.path(), |name| std::env::var_os(name).map(PathBuf::from)), stop)
}

/// Where an index may lie, the best place first.
fn places(recording: &Path, variable: impl Fn(&str) -> Option<PathBuf>) -> Vec<PathBuf> {
    let mut beside = recording.as_os_str().to_owned();
    beside.push(".index");
    // A relative path is to be passed over, says the specification of these variables.
    let folder = |name: &str| variable(name).filter(|path| path.is_absolute());
    let cache = folder("XDG_CACHE_HOME").or_else(|| folder("HOME").map(|home| home.join(".cache")));
    let whole = recording.canonicalize().unwrap_or_else(|_| recording.into());
    let name = recording.file_name().unwrap_or_default().to_string_lossy();
    let name = format!("{name}-{:016x}.index", fnv1a(whole.as_os_str().as_encoded_bytes()));
    [Some(beside.into()), cache.map(|cache| cache.join("vitreo").join(name))].into_iter().flatten().collect()
}

fn open_at(recording: &Recording, places: &[PathBuf], stop: &StopSignal) -> anyhow::Result<Timeline> {
    let timeline = Timeline::open(recording)?;
    if timeline.has_checkpoints() {
        return Ok(timeline);
    }
    let wanted = identity(recording).with_context(|| recording.path().display().to_string())?;
    for place in places.iter().filter(|place| place.exists()) {
        match checked(place, &wanted) {
            Ok(index) => return Ok(with_index(timeline, index)?),
            Err(why) => tracing::info!("{}: rebuilt: {why}", place.display()),
        }
    }
    for place in places {
        let begun = Outputs::new(true).reading_all(files_of(recording.path())).grow(place);
        let mut file = match begun {
            Ok(file) => file,
            Err(why) => {
                tracing::debug!("{why}");
                continue;
            }
        };
        make(recording, &wanted, &file, stop)?;
        file.appear()?;
        return Ok(with_index(timeline, Recording::open(place)?)?);
    }
    tracing::warn!("{}: cannot store an index; playing from the beginning", recording.path().display());
    Ok(timeline)
}

fn with_index(timeline: Timeline, index: Recording) -> Result<Timeline, RecordingError> {
    if timeline.recording().provenance().source == Source::Import {
        return Timeline::open(&index);
    }
    let chunks = index.chunk_index()?;
    Ok(timeline.with_pairs(Pairs::of(index, chunks)?))
}

/// Names a recording by its size, its ends and what reads it.
fn identity(recording: &Recording) -> io::Result<String> {
    let files = files_of(recording.path());
    let mut hash = 0;
    for path in &files {
        let file = File::open(path)?;
        let bytes = file.metadata()?.len();
        let mut ends = vec![0; (2 * NAMED_BY).min(bytes) as usize];
        let half = ends.len() / 2;
        let (head, tail) = ends.split_at_mut(half);
        file.read_exact_at(head, 0)?;
        file.read_exact_at(tail, bytes - tail.len() as u64)?;
        // Of one file it is the hash of its ends alone.
        hash = if files.len() == 1 {
            fnv1a(&ends)
        } else {
            fnv1a(&[hash, fnv1a(&ends)].map(u64::to_le_bytes).concat())
        };
    }
    Ok(format!("{} bytes {hash:016x}, index {VERSION}", recording.bytes()))
}

/// Opens an index, if it is whole and the one that is wanted.
fn checked(place: &Path, wanted: &str) -> anyhow::Result<Recording> {
    let index = Recording::open(place)?;
    let provenance = index.provenance();
    let found = provenance.config.get(INDEX_OF).map_or("nothing", String::as_str);
    anyhow::ensure!(found == wanted, "it is of {found}, expected {wanted}");
    anyhow::ensure!(provenance.versions == versions(provenance), "another version of tracker or simulation");
    anyhow::ensure!(index.matches_checksum()?, "it is damaged, or was cut");
    Ok(index)
}

/// The versions that an index by this build names.
fn versions(provenance: &Provenance) -> std::collections::BTreeMap<String, String> {
    let mut versions = provenance.versions.clone();
    versions.insert(TRACKER.into(), TRACKER_VERSION.to_string());
    versions.insert(STATE_HASH.into(), STATE_HASH_VERSION.to_string());
    versions
}

/// Plays a recording and writes its index.
fn make(recording: &Recording, of: &str, file: &GrowingFile, stop: &StopSignal) -> anyhow::Result<()> {
    let mut provenance = recording.provenance().clone();
    provenance.versions = versions(&provenance);
    provenance.config.insert(INDEX_OF.into(), of.into());
    provenance.source = Source::Live;
    let rig = Rig::parse(&provenance.rig_json, "of the recording")?;
    tracker::rig_check::check(&rig).context("the recording's rig is not usable")?;
    let world = World::new(&scene_of(recording)?).context("scene")?.unseen();
    let mut writer = Writer::on(file.handle()?, file.path(), &provenance)?;
    let bar = bytes_bar(recording.bytes(), "index");
    let write = |at, item: &_| Ok(writer.write(at, item)?);
    match recording.provenance().source {
        Source::Live => {
            let (mut run, mut times) = (Recorded::new(recording, &rig, world), CheckpointTimes::default());
            let due = |exposed_ns| times.after_frame(exposed_ns);
            saving::save(&mut run, stop, |bytes| bar.set_position(bytes), due, write)?;
        }
        Source::Import => {
            streamed::save(recording, &rig, world, stop, |bytes| bar.set_position(bytes), write)?
        }
    }
    bar.finish_and_clear();
    Ok(writer.finish()?)
}

#[cfg(test)]
mod tests;
