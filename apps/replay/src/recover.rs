//! `vitreo recover`: makes a whole file of a truncated or damaged recording.
//!
//! Every item that can be read is written to a new file, which is then read back and compared. Behind
//! damage it goes on at the next good chunk, and a note stands where something is missing.

use crate::new_recording::{NewRecording, claim};
use anyhow::{Context, bail};
use ipc::logging::{inform, warn};
use outputs::exit::LOSS;
use outputs::progress::bytes_bar;
use outputs::{Outputs, STDOUT};
use protocol::message::fnv1a;
use protocol::time::Nanos;
use recording::{Item, Note, Recording, RecordingError, files_of};
use settings::commands::RecoverArgs;
use std::path::Path;
use std::process::ExitCode;

/// Count and running hash of items, to compare two passes.
#[derive(Debug, Default, PartialEq, Eq)]
struct Tally {
    items: u64,
    hash: u64,
}

impl Tally {
    fn take(&mut self, log_time: Nanos, item: &Item) {
        let parts = [self.hash, log_time, fnv1a(item.topic().as_bytes()), fnv1a(&item.encoded())];
        self.hash = fnv1a(&parts.map(u64::to_le_bytes).concat());
        self.items += 1;
    }
}

/// Runs it: 0 if nothing was lost, 3 if something was.
///
/// # Errors
/// Where nothing can be read, the output exists, or it differs when it is read back.
pub fn run(args: &RecoverArgs) -> anyhow::Result<ExitCode> {
    let recording = Recording::open_in_doubt(&args.file)?;
    if args.output == Path::new(STDOUT) {
        bail!("the output is read back for verification: give a file, not {STDOUT}");
    }
    let mut outputs = Outputs::new(args.force.force).reading_all(files_of(&args.file));
    claim(&args.output, &args.writing, &mut outputs)?;
    let output = NewRecording::begin(&args.output, &args.writing, &mut outputs)?;
    let (expected, problems) = copy(&recording, &output)?;
    output.appear()?;
    let found = read_back(&args.output).context("reading the output back")?;
    if found != expected {
        bail!("{}: reads back {found:?}, but {expected:?} was written", args.output.display());
    }
    let messages = if expected.items == 1 { "message" } else { "messages" };
    inform(&format!("{}: {} {messages} recovered and verified", args.output.display(), expected.items));
    if problems == 0 && recording.is_finished() {
        return Ok(ExitCode::SUCCESS);
    }
    if problems == 0 {
        warn("the recording was not closed properly; at most its last 200 ms are missing");
    }
    Ok(ExitCode::from(LOSS))
}

/// A problem in words. That of a cut recording names this command as its remedy elsewhere.
fn in_words(error: &RecordingError) -> String {
    match error {
        RecordingError::Truncated { file, offset } => {
            format!("{file}: ends in the middle of a record at byte {offset}; everything before it is kept")
        }
        other => other.to_string(),
    }
}

/// Copies what can be read; returns what was written, and the problems with their places.
fn copy(recording: &Recording, output: &NewRecording) -> anyhow::Result<(Tally, u64)> {
    let mut writer = output.writer(recording.provenance())?;
    let (mut tally, mut problems) = (Tally::default(), 0);
    // Instant of the last item; before the first one notes of losses wait for it: a recording does not
    // begin at the machine's boot.
    let (mut last, mut early) = (None, Vec::new());
    let bar = bytes_bar(recording.bytes(), "recover");
    let mut items = recording.items();
    let mut put = |log_time: Nanos, item: &Item| -> Result<(), RecordingError> {
        tally.take(log_time, item);
        writer.write(log_time, item)
    };
    if let Some(doubt) = recording.doubt() {
        warn(&format!("{doubt}; they are used unchecked"));
        problems += 1;
        early.push(format!("recovered: {doubt}"));
    }
    while let Some(item) = items.next() {
        match item {
            Ok((log_time, item)) => {
                for text in early.drain(..) {
                    put(log_time, &Item::Note(Note::loss(log_time, 0, text)))?;
                }
                put(log_time, &item)?;
                last = Some(log_time);
            }
            Err(error) => {
                let problem = in_words(&error);
                warn(&problem);
                problems += 1;
                let text = format!("recovered: {problem}");
                match last {
                    Some(at) => put(at, &Item::Note(Note::loss(at, 0, text)))?,
                    None => early.push(text),
                }
            }
        }
        bar.set_position(items.bytes_read());
    }
    if problems == 0 && !recording.is_finished() {
        early.push("recovered: the recorder ended without closing the file".into());
    }
    let at = last.unwrap_or(0);
    for text in early {
        put(at, &Item::Note(Note::loss(at, 0, text)))?;
    }
    bar.finish_and_clear();
    writer.finish()?;
    Ok((tally, problems))
}

fn read_back(output: &Path) -> anyhow::Result<Tally> {
    let recording = Recording::open(output)?;
    if !recording.is_finished() {
        bail!("{}: has no footer", output.display());
    }
    let mut tally = Tally::default();
    for item in recording.items() {
        let (log_time, item) = item?;
        tally.take(log_time, &item);
    }
    Ok(tally)
}

#[cfg(test)]
mod tests {
    use super::*;
    use outputs::Force;
    use recording::{NoteKind, Provenance, Writer};
    use settings::commands::WritingArgs;

    fn note(count: u64) -> Item {
        let text = format!("note {count} {}", "x".repeat(60));
        Item::Note(Note { instant_ns: 1, kind: NoteKind::Log, process: None, count, text })
    }

    fn recorded(path: &Path) -> Vec<u8> {
        let mut writer = Writer::create(path, &Provenance::default()).unwrap();
        for i in 0..200 {
            writer.write(i * 1_000_000, &note(i)).unwrap();
            writer.flush_aged(i * 1_000_000).unwrap();
        }
        writer.finish().unwrap();
        std::fs::read(path).unwrap()
    }

    fn copied(recording: &Recording, output: &Path) -> anyhow::Result<(Tally, u64)> {
        let output = NewRecording::begin(output, &WritingArgs::default(), &mut Outputs::new(true))?;
        let copied = copy(recording, &output)?;
        output.appear()?;
        Ok(copied)
    }

    fn counts(path: &Path) -> Vec<u64> {
        let items = Recording::open(path).unwrap().items();
        let log = |item: Result<(Nanos, Item), RecordingError>| match item.unwrap().1 {
            Item::Note(note) if note.kind == NoteKind::Log => Some(note.count),
            _ => None,
        };
        items.filter_map(log).collect()
    }

    #[test]
    fn a_cut_recording_is_mended_up_to_the_cut() {
        let directory = tempfile::tempdir().unwrap();
        let (file, output) = (directory.path().join("a.mcap"), directory.path().join("b.mcap"));
        let bytes = recorded(&file);
        let whole = counts(&file);
        for cut in (1000..bytes.len()).step_by(997) {
            std::fs::write(&file, &bytes[..cut]).unwrap();
            let Ok(recording) = Recording::open(&file) else { continue };
            copied(&recording, &output).unwrap();
            assert!(Recording::open(&output).unwrap().is_finished());
            assert!(whole.starts_with(&counts(&output)));
            read_back(&output).unwrap();
        }
    }

    #[test]
    fn behind_damage_in_the_middle_it_goes_on() {
        let directory = tempfile::tempdir().unwrap();
        let (file, output) = (directory.path().join("a.mcap"), directory.path().join("b.mcap"));
        let bytes = recorded(&file);
        let whole = counts(&file);
        let mut items = Recording::open(&file).unwrap().items();
        // Where the chunk of an item ends.
        let ends = std::iter::from_fn(|| items.next().map(|_| items.bytes_read() as usize));
        let mut ends: Vec<usize> = ends.collect();
        ends.dedup();
        assert!(ends.len() >= 3, "{ends:?}");
        let mut damaged = bytes.clone();
        damaged[ends[0] + 200..ends[1]].fill(0xa5);
        std::fs::write(&file, &damaged).unwrap();
        let grown = NewRecording::begin(&output, &WritingArgs::default(), &mut Outputs::new(true)).unwrap();
        let (tally, problems) = copy(&Recording::open(&file).unwrap(), &grown).unwrap();
        grown.appear().unwrap();
        assert!(problems > 0);
        assert_eq!(read_back(&output).unwrap(), tally);
        let saved = counts(&output);
        let before = saved.iter().zip(&whole).take_while(|(a, b)| a == b).count();
        assert!(before > 0 && before < saved.len() && whole.ends_with(&saved[before..]), "{saved:?}");
    }

    #[test]
    fn behind_a_damaged_beginning_it_begins_at_the_first_intact_item() {
        let directory = tempfile::tempdir().unwrap();
        let (file, output) = (directory.path().join("a.mcap"), directory.path().join("b.mcap"));
        let boot_ns = 2_400_000_000_000;
        let mut writer = Writer::create(&file, &Provenance::default()).unwrap();
        for i in 0..200 {
            writer.write(boot_ns + i * 10_000_000, &note(i)).unwrap();
            writer.flush_aged(boot_ns + i * 10_000_000).unwrap();
        }
        writer.finish().unwrap();
        let mut items = Recording::open(&file).unwrap().items();
        items.next().unwrap().unwrap();
        let mut bytes = std::fs::read(&file).unwrap();
        bytes[items.bytes_read() as usize - 50] ^= 0x10;
        std::fs::write(&file, bytes).unwrap();
        let writing = WritingArgs::default();
        let args = RecoverArgs { file, output: output.clone(), writing, force: Force::default() };
        assert_eq!(run(&args).unwrap(), ExitCode::from(LOSS));
        let items: Vec<(Nanos, Item)> =
            Recording::open(&output).unwrap().items().collect::<Result<_, _>>().unwrap();
        assert!(items.len() > 100 && items.len() < 200, "{}", items.len());
        assert!(matches!(&items[0].1, Item::Note(n) if n.kind == NoteKind::Loss && n.instant_ns > boot_ns));
        assert!(items[0].0 > boot_ns && items[0].0 == items[1].0, "{}", items[0].0);
    }

    #[test]
    fn a_changed_rig_is_warned_of_and_noted() {
        let directory = tempfile::tempdir().unwrap();
        let (file, output) = (directory.path().join("a.mcap"), directory.path().join("b.mcap"));
        let provenance = Provenance { rig_json: "{\"focal\": 1234.5}".into(), ..Provenance::default() };
        Writer::create(&file, &provenance).unwrap().finish().unwrap();
        let mut bytes = std::fs::read(&file).unwrap();
        let digit = bytes.windows(6).position(|w| w == b"1234.5").unwrap();
        bytes[digit] = b'9';
        std::fs::write(&file, &bytes).unwrap();
        let writing = WritingArgs::default();
        let args = RecoverArgs { file, output: output.clone(), writing, force: Force::default() };
        assert_eq!(run(&args).unwrap(), ExitCode::from(LOSS));
        let losses = Recording::open(&output).unwrap().items().filter(
            |item| matches!(item, Ok((_, Item::Note(n))) if n.kind == NoteKind::Loss && n.text.contains("rig")),
        );
        assert_eq!(losses.count(), 1);
    }

    #[test]
    fn a_whole_recording_loses_nothing() {
        let directory = tempfile::tempdir().unwrap();
        let (file, output) = (directory.path().join("a.mcap"), directory.path().join("b.mcap"));
        recorded(&file);
        let (tally, problems) = copied(&Recording::open(&file).unwrap(), &output).unwrap();
        assert_eq!((tally.items, problems), (200, 0));
        assert_eq!(read_back(&output).unwrap(), tally);
        let writing = WritingArgs::default();
        let onto_itself =
            RecoverArgs { file: file.clone(), output: file, writing, force: Force { force: true } };
        assert!(run(&onto_itself).is_err());
    }
}
