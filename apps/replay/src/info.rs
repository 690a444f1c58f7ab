//! `vitreo info`: contents of a recording.

use crate::{info_pixels, pixels};
use diagnosis::{BodySummary, Due, Summary};
use ipc::logging::warn;
use outputs::exit::LOSS;
use outputs::println;
use protocol::events::{Event, Severity};
use protocol::poses::BODY_NAMES;
use recording::{Item, NoteKind, PartInfo, Recording, STATE_HASH, Source, TRACKER, split_name};
use rig::Rig;
use serde::Serialize;
use settings::commands::InfoArgs;
use std::collections::BTreeMap;
use std::process::ExitCode;

/// Contents of a recording.
#[derive(Debug, Default, Serialize)]
struct Contents {
    file: String,
    bytes: u64,
    source: &'static str,
    /// The recorder closed the file in order.
    finished: bool,
    /// Rig, scene and configuration are under a checksum; former versions wrote none.
    checksum: bool,
    /// Which part of which recording it is, where it is one that was opened alone.
    part: Option<PartNumber>,
    /// The files of a recording in parts.
    parts: Vec<PartFile>,
    /// Blocks that are missing, by the notes of the recorder.
    missing: u64,
    restarts: u64,
    scene: String,
    seeds: BTreeMap<String, String>,
    config: BTreeMap<String, String>,
    versions: BTreeMap<String, String>,
    start_ns: u64,
    end_ns: u64,
    duration_s: f64,
    messages: BTreeMap<&'static str, u64>,
    camera_fields: BTreeMap<u32, u64>,
    /// First and last field of the reference camera that has poses.
    pose_fields: Option<[u64; 2]>,
    events: EventCounts,
    notes: Vec<String>,
    damage: Option<String>,
    /// How bodies were tracked; nothing at a desk and in an imported stream.
    bodies: BTreeMap<&'static str, BodySummary>,
    /// The same, a line each.
    #[serde(skip)]
    lines: Vec<String>,
}

/// A part that was opened alone.
#[derive(Debug, Serialize)]
struct PartNumber {
    number: u32,
    of: String,
}

/// A part of a recording.
#[derive(Debug, Serialize)]
struct PartFile {
    file: String,
    bytes: u64,
    /// Why nothing of it is read.
    problem: Option<String>,
}

/// Events that concern the trainee, by name: how many there are of each kind.
#[derive(Debug, Default, Serialize)]
struct EventCounts {
    /// Of severity "warning". The warnings of a run or replay about cameras, rig and tracking are no events.
    warning: BTreeMap<&'static str, u64>,
    /// Of severity "injury".
    injury: BTreeMap<&'static str, u64>,
}

impl EventCounts {
    fn take(&mut self, event: &Event) {
        let counts = match event.severity {
            s if s == Severity::Warning as u32 => &mut self.warning,
            s if s == Severity::Injury as u32 => &mut self.injury,
            _ => return,
        };
        *counts.entry(event.info().map_or("unknown", |info| info.name)).or_insert(0) += 1;
    }

    /// A line for each severity: how many events, and of which kinds.
    fn lines(&self) -> [String; 2] {
        [("warning", &self.warning), ("injury", &self.injury)].map(|(severity, counts)| {
            let all: u64 = counts.values().sum();
            let kinds: Vec<String> = counts.iter().map(|(name, count)| format!("{name} {count}")).collect();
            let kinds = if all > 0 { format!(": {}", kinds.join(", ")) } else { String::new() };
            let events = if all == 1 { "event" } else { "events" };
            format!("{all} {events} of severity {severity}{kinds}")
        })
    }
}

/// How the bodies of a recording were tracked.
struct Bodies {
    due: Due,
    summary: Summary,
}

impl Bodies {
    /// Where poses are a tracker's, and the rig can be read.
    fn of(recording: &Recording) -> Option<Self> {
        let provenance = recording.provenance();
        let desk = provenance.config.contains_key(recording::DESK);
        let rig = Rig::parse(&provenance.rig_json, "of the recording").ok().filter(|_| !desk)?;
        let period_ns = rig.field_period_ns();
        Some(Bodies { due: Due::new(period_ns), summary: Summary::new(period_ns) })
    }

    fn take(&mut self, item: &Item) {
        match item {
            Item::Blobs(field) => self.due.note_field(field),
            Item::Poses(frame) => {
                self.due.note_frame(frame);
                self.summary.note_frame(frame);
            }
            Item::Matches(matches) => self.summary.note_matches(matches),
            _ => {}
        }
    }
}

impl Contents {
    /// Takes how bodies were tracked, once all items are counted.
    fn take_bodies(&mut self, bodies: &Bodies) {
        let frames = self.messages.get("poses").copied().unwrap_or(0);
        let due = frames + bodies.due.frames_missing();
        self.lines = bodies.summary.lines(due);
        if !self.lines.is_empty() {
            self.bodies = BODY_NAMES.into_iter().zip(bodies.summary.bodies(due)).collect();
        }
    }

    fn take(&mut self, log_time: u64, item: &Item) {
        let first = self.messages.is_empty();
        *self.messages.entry(item.topic()).or_insert(0) += 1;
        self.start_ns = if first { log_time } else { self.start_ns.min(log_time) };
        self.end_ns = self.end_ns.max(log_time);
        self.duration_s = (self.end_ns - self.start_ns) as f64 * 1e-9;
        match item {
            Item::Blobs(field) => *self.camera_fields.entry(field.camera).or_insert(0) += 1,
            Item::Poses(frame) => {
                let [from, _] = self.pose_fields.unwrap_or([frame.field; 2]);
                self.pose_fields = Some([from, frame.field]);
            }
            Item::Event(event) => self.events.take(event),
            Item::Note(note) => {
                match note.kind {
                    NoteKind::Loss => self.missing += note.count.max(1),
                    NoteKind::Restart => self.restarts += 1,
                    NoteKind::Log => {}
                }
                self.notes.push(note.text.clone());
            }
            _ => {}
        }
    }

    /// An imported stream holds no results, and a desk's poses are no tracker's.
    fn has_version_of(&self, key: &str) -> bool {
        let desk = self.config.contains_key(recording::DESK);
        self.source == Source::Live.name() && !(key == TRACKER && desk)
    }

    fn print(&self) {
        let state = match (&self.damage, self.finished) {
            (Some(damage), _) => damage.clone(),
            (None, true) => "complete".into(),
            (None, false) => NOT_CLOSED.into(),
        };
        println!("{}", self.file);
        println!("  {:.1} MiB, {}, {state}", self.bytes as f64 / f64::from(1 << 20), self.source);
        if let Some(PartNumber { number, of }) = &self.part {
            println!("  part {number} of {of}, alone");
        }
        for PartFile { file, bytes, problem } in &self.parts {
            let mib = *bytes as f64 / f64::from(1 << 20);
            let text = problem.clone().unwrap_or_else(|| format!("{mib:.1} MiB"));
            println!("  part {file}: {text}");
        }
        if !self.checksum {
            println!("  without a checksum of rig and scene (written by an earlier version)");
        }
        println!("  scene {}, {:.2} s from {} ns", self.scene, self.duration_s, self.start_ns);
        for (key, what) in [(TRACKER, "the tracker"), (STATE_HASH, "state hashes")] {
            if self.has_version_of(key) && !self.versions.contains_key(key) {
                println!("  without a version of {what} (written by an earlier version)");
            }
        }
        for (group, map) in [("version", &self.versions), ("seed", &self.seeds), ("config", &self.config)] {
            map.iter().for_each(|(key, value)| println!("  {group} {key}: {value}"));
        }
        for (topic, count) in &self.messages {
            let rate = *count as f64 / self.duration_s.max(1e-9);
            println!("  {topic:<12} {count:>9}  {:>7.1} /s", if self.duration_s > 0.0 { rate } else { 0.0 });
        }
        for (camera, count) in &self.camera_fields {
            println!("  camera {camera}: {count} fields");
        }
        if let Some([first, last]) = self.pose_fields {
            println!("  poses of fields {first} to {last}");
        }
        self.lines.iter().for_each(|line| println!("  {line}"));
        self.events.lines().iter().for_each(|line| println!("  {line}"));
        if self.restarts > 0 {
            println!("  restarts of processes: {}", self.restarts);
        }
        if self.missing > 0 {
            println!("  missing blocks: {}", self.missing);
        }
        self.notes.iter().for_each(|note| println!("  note: {note}"));
    }
}

/// Says that a recording ends where its recorder did.
pub(crate) const NOT_CLOSED: &str = "not closed properly, readable to its end";

/// Runs it. A recording that is damaged or was not closed is described as far as it can be read, with exit
/// code 3.
///
/// # Errors
/// Where the file cannot be read as a recording.
pub fn run(args: &InfoArgs) -> anyhow::Result<ExitCode> {
    if pixels::is_recorded(&args.file) {
        return info_pixels::run(args);
    }
    let recording = Recording::open_in_doubt(&args.file)?;
    let provenance = recording.provenance().clone();
    let mut contents = Contents {
        file: args.file.display().to_string(),
        bytes: recording.bytes(),
        source: provenance.source.name(),
        finished: recording.is_finished(),
        checksum: recording.has_checksum(),
        part: part_of(&recording),
        parts: parts_of(&recording),
        damage: recording.doubt().map(ToString::to_string),
        scene: provenance.scene_name,
        seeds: provenance.seeds,
        config: provenance.config,
        versions: provenance.versions,
        ..Contents::default()
    };
    let mut bodies = Bodies::of(&recording);
    for item in recording.items() {
        match item {
            Ok((log_time, item)) => {
                contents.take(log_time, &item);
                bodies.iter_mut().for_each(|bodies| bodies.take(&item));
            }
            Err(error) => contents.damage = contents.damage.take().or(Some(error.to_string())),
        }
    }
    bodies.iter().for_each(|bodies| contents.take_bodies(bodies));
    if args.json {
        println!("{}", serde_json::to_string_pretty(&contents)?);
    } else {
        contents.print();
    }
    if contents.damage.is_none() && !contents.finished {
        warn(&format!("{}: {NOT_CLOSED} (vitreo recover repairs it)", contents.file));
    }
    let whole = contents.damage.is_none() && contents.finished;
    Ok(ExitCode::from(if whole { 0 } else { LOSS }))
}

/// Which part it is, and of what.
fn part_of(recording: &Recording) -> Option<PartNumber> {
    let number = recording.part()?.number;
    let of =
        split_name(recording.path()).map_or_else(|| "a recording".into(), |(of, _)| of.display().to_string());
    Some(PartNumber { number, of })
}

/// The files of a recording in parts.
fn parts_of(recording: &Recording) -> Vec<PartFile> {
    let part =
        |PartInfo { file, bytes, problem }| PartFile { file: file.display().to_string(), bytes, problem };
    recording.parts().into_iter().map(part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::events::EventKind;
    use recording::Note;

    #[test]
    fn losses_and_spans_are_counted() {
        let mut contents = Contents::default();
        let note =
            |kind, count| Item::Note(Note { instant_ns: 0, kind, process: None, count, text: "n".into() });
        contents.take(2_000_000_000, &note(NoteKind::Loss, 5));
        contents.take(500_000_000, &note(NoteKind::Restart, 1));
        assert_eq!((contents.missing, contents.restarts, contents.notes.len()), (5, 1, 2));
        assert_eq!((contents.start_ns, contents.duration_s), (500_000_000, 1.5));
    }

    #[test]
    fn events_are_counted_by_severity_and_kind() {
        let mut contents = Contents::default();
        let none = ["0 events of severity warning", "0 events of severity injury"];
        assert_eq!(contents.events.lines(), none);
        let event = |kind: EventKind| {
            let (kind, severity) = (kind as u32, kind.info().severity as u32);
            Item::Event(Event { kind, severity, ..Event::zeroed() })
        };
        for kind in [
            EventKind::RetinaTouched,
            EventKind::GripSlipped,
            EventKind::RetinaTouched,
            EventKind::TissueGrabbed,
            EventKind::LensTouched,
        ] {
            contents.take(0, &event(kind));
        }
        assert_eq!(
            contents.events.lines(),
            [
                "3 events of severity warning: retina.touched 2, tissue.grip_slipped 1",
                "1 event of severity injury: lens.touched 1"
            ]
        );
    }
}
