//! `vitreo merge`: parts of one run, as `vitreo cut` and `vitreo run --split` make them, become one recording.

use crate::new_recording::{ItemWriter, NewRecording, claim};
use crate::pace::Stopped;
use crate::stop::StopSignal;
use anyhow::{Context, bail, ensure};
use ipc::logging::{inform, warn};
use outputs::exit::{LOSS, WrongUse};
use outputs::progress::bytes_bar;
use outputs::{Outputs, println};
use protocol::time::Nanos;
use recording::{CUT, Item, Note, Recording, Source, files_of, split_name};
use settings::commands::MergeArgs;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::process::ExitCode;

/// A part, and the exposure of the first step that is its own, or of the first field of a stream.
struct Part {
    recording: Recording,
    from_ns: Nanos,
}

/// Runs it. Exit code 3 where a part could not be read whole.
///
/// # Errors
/// Where a part cannot be read, or is of another run, or the file cannot be written.
pub fn run(args: &MergeArgs) -> anyhow::Result<ExitCode> {
    let stop = StopSignal::install().context("signals")?;
    let inputs = args.files.iter().flat_map(|file| files_of(file));
    let mut outputs = Outputs::new(args.force.force).reading_all(inputs);
    claim(&args.output, &args.writing, &mut outputs)?;
    let parts = open(&args.files)?;
    let output = NewRecording::begin(&args.output, &args.writing, &mut outputs)?;
    let (written, lost) = write(&parts, output.writer(parts[0].recording.provenance())?, &stop)?;
    let files = output.appear()?;
    let count = parts.iter().map(|part| part.recording.parts().len().max(1)).sum::<usize>();
    inform(&format!("{count} parts merged, {written} messages written"));
    files.iter().for_each(|file| println!("{}", file.display()));
    let Some(lost) = lost else { return Ok(ExitCode::SUCCESS) };
    warn(&lost);
    Ok(ExitCode::from(LOSS))
}

/// Writes what the parts hold, each item once; returns how many there are, and what could not be read first.
fn write(parts: &[Part], mut writer: ItemWriter, stop: &StopSignal) -> anyhow::Result<(u64, Option<String>)> {
    let bar = bytes_bar(parts.iter().map(|part| part.recording.bytes()).sum(), "merge");
    let (mut seen, mut lost, mut done, mut written) = (Seen::default(), None, 0, 0);
    for (number, part) in parts.iter().enumerate() {
        let mut items = part.recording.items();
        // What begins a part stands in it before what it was made of.
        let mut passed =
            if number > 0 && is_cut(part) { vec!["checkpoints", "tracker-checkpoints"] } else { Vec::new() };
        while let Some(item) = items.next() {
            if stop.is_raised() {
                bail!(Stopped);
            }
            let (at, item) = item.unwrap_or_else(|problem| {
                let text = problem.to_string();
                lost.get_or_insert_with(|| text.clone());
                (seen.newest_ns, Item::Note(Note::loss(seen.newest_ns, 1, text)))
            });
            let begins = passed.iter().position(|topic| *topic == item.topic());
            if begins.map(|i| passed.swap_remove(i)).is_none() && seen.is_new(at, &item) {
                writer.write(at, &item)?;
                written += 1;
            }
            bar.set_position(done + items.bytes_read());
        }
        done += part.recording.bytes();
        seen.end_part();
    }
    bar.finish_and_clear();
    writer.finish()?;
    Ok((written, lost))
}

fn is_cut(part: &Part) -> bool {
    part.recording.provenance().config.contains_key(CUT)
}

/// Opens the parts, the earliest first. Files that a recorder wrote as parts of one recording are one, to the
/// item.
fn open(files: &[PathBuf]) -> anyhow::Result<Vec<Part>> {
    if let Some(recording) = of_one_recorder(files)? {
        return Ok(vec![Part { recording, from_ns: 0 }]);
    }
    if let [file] = files {
        bail!(WrongUse(format!(
            "{}: one recording in one file: expected two parts, or the name of a recording in parts",
            file.display()
        )));
    }
    let mut parts = Vec::new();
    for file in files {
        let recording = Recording::open(file)?;
        let mut first = recording.items_of(&["steps", "blobs"]).filter_map(Result::ok).map(|(_, item)| item);
        let is_stream = recording.provenance().source == Source::Import;
        let from_ns = first.find_map(|item| match item {
            Item::Step(step) => Some(step.instants.exposed),
            Item::Blobs(field) if is_stream => Some(field.exposed_ns),
            _ => None,
        });
        let from_ns =
            from_ns.with_context(|| format!("{}: contains no step and no field", file.display()))?;
        parts.push(Part { recording, from_ns });
    }
    parts.sort_by_key(|part| part.from_ns);
    for part in &parts[1..] {
        let [one, other] = [&parts[0], part].map(|part| part.recording.path().display().to_string());
        let difference = parts[0].recording.provenance().difference(part.recording.provenance());
        ensure!(
            difference.is_none(),
            "{one} and {other} are from different runs: their {} differ",
            difference.unwrap_or_default()
        );
    }
    Ok(parts)
}

/// The recording whose parts these files are, or whose name this is.
fn of_one_recorder(files: &[PathBuf]) -> anyhow::Result<Option<Recording>> {
    let mut sets = BTreeSet::new();
    for file in files {
        let recording = Recording::open(file)?;
        if files.len() == 1 && !recording.parts().is_empty() {
            return Ok(Some(recording));
        }
        let Some(part) = recording.part() else { return Ok(None) };
        sets.insert(part.set.clone());
    }
    let name = split_name(&files[0]).map_or(files[0].clone(), |(name, _)| name);
    if sets.len() == 1 && files.len() > 1 { Ok(Some(Recording::of_parts(&name, files)?)) } else { Ok(None) }
}

/// What was written, by topic.
#[derive(Default)]
struct Seen {
    newest_ns: Nanos,
    /// Log time of the newest message of the parts before, and the messages of that time.
    before: BTreeMap<&'static str, (Nanos, Vec<Vec<u8>>)>,
    /// The same of all so far.
    now: BTreeMap<&'static str, (Nanos, Vec<Vec<u8>>)>,
}

impl Seen {
    /// Whether no part before holds an item; takes it in.
    fn is_new(&mut self, at: Nanos, item: &Item) -> bool {
        let message = item.encoded();
        let held = self
            .before
            .get(item.topic())
            .is_some_and(|(newest, messages)| at < *newest || at == *newest && messages.contains(&message));
        if held {
            return false;
        }
        self.newest_ns = self.newest_ns.max(at);
        let (newest, messages) = self.now.entry(item.topic()).or_default();
        if at > *newest {
            (*newest, *messages) = (at, Vec::new());
        }
        if at == *newest {
            messages.push(message);
        }
        true
    }

    /// What comes now is of another part.
    fn end_part(&mut self) {
        self.before.clone_from(&self.now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::handles::PedalState;
    use recording::Provenance;

    fn pedal(seq: u64) -> Item {
        Item::Pedal(PedalState { seq, instant_ns: seq, ..Zeroable::zeroed() })
    }

    #[test]
    fn what_two_parts_hold_is_taken_once() {
        let mut seen = Seen::default();
        let first = [(1, 1), (2, 2), (4, 4), (4, 5)].map(|(at, seq)| seen.is_new(at, &pedal(seq)));
        assert_eq!(first, [true; 4]);
        seen.end_part();
        let second = [(2, 2), (4, 4), (4, 5), (4, 6), (7, 7)].map(|(at, seq)| seen.is_new(at, &pedal(seq)));
        assert_eq!(second, [false, false, false, true, true]);
        // Within a part the order of the file is kept, whatever its log times.
        assert!(seen.is_new(6, &pedal(8)));
    }

    #[test]
    fn parts_of_two_runs_are_refused_by_what_differs() {
        let provenance = |rig: &str, cut: Option<&str>| {
            let config = cut.into_iter().map(|cut| (CUT.to_owned(), cut.to_owned())).collect();
            Provenance { rig_json: rig.into(), config, ..Provenance::default() }
        };
        assert_eq!(provenance("a", None).difference(&provenance("a", Some("5"))), None);
        assert_eq!(provenance("a", None).difference(&provenance("b", None)), Some("rigs"));
    }
}
