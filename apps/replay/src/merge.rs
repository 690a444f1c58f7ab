//! `vitreo merge`: parts of one run, as `vitreo cut` makes them, become one recording again.

use crate::pace::Stopped;
use crate::stop::StopSignal;
use anyhow::{Context, bail, ensure};
use ipc::logging::{inform, warn};
use outputs::exit::LOSS;
use outputs::progress::bytes_bar;
use outputs::{Outputs, println};
use protocol::time::Nanos;
use recording::{CUT, Item, Note, Provenance, Recording, Writer};
use settings::commands::MergeArgs;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;

/// A part, and the log time of its first message.
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
    let mut outputs = Outputs::new(args.force.force).reading_all(&args.files);
    outputs.claim(&args.output)?;
    let parts = open(&args.files)?;
    let mut output = outputs.grow(&args.output)?;
    let mut writer = Writer::on(output.handle()?, output.path(), parts[0].recording.provenance())?;
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
    output.appear()?;
    inform(&format!("{} parts, {written} messages", parts.len()));
    println!("{}", args.output.display());
    let Some(lost) = lost else { return Ok(ExitCode::SUCCESS) };
    warn(&lost);
    Ok(ExitCode::from(LOSS))
}

fn is_cut(part: &Part) -> bool {
    part.recording.provenance().config.contains_key(CUT)
}

/// Opens the parts, the earliest first.
fn open(files: &[PathBuf]) -> anyhow::Result<Vec<Part>> {
    let mut parts = Vec::new();
    for file in files {
        let recording = Recording::open(file)?;
        let first = recording.items().find_map(Result::ok);
        let (from_ns, _) = first.with_context(|| format!("{}: holds nothing", file.display()))?;
        parts.push(Part { recording, from_ns });
    }
    parts.sort_by_key(|part| part.from_ns);
    for part in &parts[1..] {
        let [one, other] = [&parts[0], part].map(|part| part.recording.path().display().to_string());
        let difference = difference(parts[0].recording.provenance(), part.recording.provenance());
        ensure!(
            difference.is_none(),
            "{one} and {other} are of two runs: {}",
            difference.unwrap_or_default()
        );
    }
    Ok(parts)
}

/// The first part of what results depend on that differs.
fn difference(a: &Provenance, b: &Provenance) -> Option<String> {
    let config = |p: &Provenance| {
        p.config.clone().into_iter().filter(|(key, _)| key != CUT).collect::<BTreeMap<_, _>>()
    };
    let parts = [
        ("rigs", a.rig_json == b.rig_json),
        ("scenes", a.scene_toml == b.scene_toml),
        ("sources", a.source == b.source),
        ("seeds", a.seeds == b.seeds),
        ("versions", a.versions == b.versions),
        ("configurations", config(a) == config(b)),
    ];
    parts.into_iter().find(|(_, same)| !same).map(|(what, _)| format!("their {what} differ"))
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
        assert_eq!(difference(&provenance("a", None), &provenance("a", Some("5"))), None);
        assert_eq!(
            difference(&provenance("a", None), &provenance("b", None)).as_deref(),
            Some("their rigs differ")
        );
    }
}
