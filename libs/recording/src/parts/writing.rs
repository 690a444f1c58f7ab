//! Writing a recording in parts.

use super::recent::{Late, Prologue, Recent, provenance_of_part};
use super::{MOST_PARTS, Numbers, PartOf, part_file};
use crate::{Item, Packing, Provenance, RecordingError, Writer};
use protocol::message::fnv1a;
use protocol::time::Nanos;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Longest wait of a part that is due for a place from which it is determined alone, ns.
const PATIENCE_NS: Nanos = 10_000_000_000;

/// When a part ends: at the next place from which another one is determined alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Limit {
    /// After this time, ns of log time.
    Time(Nanos),
    /// At this size, bytes, without those with which it began.
    Bytes(u64),
}

/// Makes the files of parts, from the second on.
pub trait PartFiles: Send {
    /// A new file, empty and without its name.
    ///
    /// # Errors
    /// Where it cannot be made.
    fn begin(&mut self, path: &Path) -> Result<File, RecordingError>;

    /// Gives it its name; its provenance is on it.
    ///
    /// # Errors
    /// Where the name is taken.
    fn appear(&mut self, path: &Path) -> Result<(), RecordingError>;
}

/// A recording being written in parts, as [`Writer`] writes one file.
pub struct PartsWriter {
    /// The name after which the parts are named.
    recording: PathBuf,
    provenance: Provenance,
    packing: Packing,
    limit: Limit,
    files: Box<dyn PartFiles>,
    /// The part that is written.
    part: PartOf,
    writer: Writer,
    /// Parts before it that are not closed: late inputs, or the disk, are waited for.
    before: Vec<Ending>,
    /// Last log time that the newest of them may hold.
    late_until_ns: Nanos,
    /// Bytes of the parts that are closed.
    closed: u64,
    recent: Recent,
    /// Log time of the part's first item.
    begun_ns: Option<Nanos>,
    /// Bytes with which it began.
    begun_bytes: u64,
    /// Newest log time when it became due.
    due_ns: Option<Nanos>,
    synced: bool,
    /// Why no part could be begun, until that was asked for.
    warning: Option<String>,
    warned: bool,
    /// Why a part that is closed may not be on the disk.
    unsafe_because: Option<RecordingError>,
}

/// A part that ends.
struct Ending {
    writer: Writer,
    late: Late,
    /// Name of the part behind it.
    next: String,
}

impl PartsWriter {
    /// Begins the first part in a file that is open and empty; further ones are made by `files`.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn begin(
        recording: &Path,
        first: File,
        provenance: &Provenance,
        packing: Packing,
        limit: Limit,
        files: Box<dyn PartFiles>,
    ) -> Result<Self, RecordingError> {
        let part = PartOf { number: 1, set: set_of(provenance), from: Numbers::default() };
        let path = part_file(recording, part.number);
        let writer = Writer::of_part(first, &path, provenance, packing, &part)?;
        let begun_bytes = writer.bytes();
        Ok(PartsWriter {
            recording: recording.into(),
            provenance: provenance.clone(),
            packing,
            limit,
            files,
            part,
            writer,
            before: Vec::new(),
            late_until_ns: 0,
            closed: 0,
            recent: Recent::new(provenance),
            begun_ns: None,
            begun_bytes,
            due_ns: None,
            synced: false,
            warning: None,
            warned: false,
            unsafe_because: None,
        })
    }

    /// As [`Writer::sync_along`], of this part and all to come.
    ///
    /// # Errors
    /// As there.
    pub fn sync_along(&mut self) -> Result<(), RecordingError> {
        self.synced = true;
        self.writer.sync_along()
    }

    /// As [`Writer::write`]. Where the part is due and another one can begin, it begins behind this item.
    ///
    /// # Errors
    /// As there; the item is kept.
    pub fn write(&mut self, log_time_ns: Nanos, item: &Item) -> Result<(), RecordingError> {
        let number = self.writer.numbers()[item.topic_index()];
        let mut done = Ok(());
        for ending in self.before.iter_mut().filter(|ending| !ending.late.is_over(log_time_ns)) {
            if ending.late.wants(item) {
                done = done.and(ending.writer.repeat(log_time_ns, item, number));
            }
        }
        done = done.and(self.close(|ending| ending.late.is_over(log_time_ns)));
        done = self.writer.write(log_time_ns, item).and(done);
        self.recent.note(log_time_ns, item, number);
        let begun_ns = *self.begun_ns.get_or_insert(log_time_ns);
        if let Some(prologue) = self.next_prologue(begun_ns) {
            done = done.and(self.go_on_in_new_part(prologue));
        }
        done
    }

    /// What the next part begins with, if one is due and can begin.
    fn next_prologue(&mut self, begun_ns: Nanos) -> Option<Prologue> {
        let newest_ns = self.recent.newest_ns();
        let over = match self.limit {
            Limit::Time(limit_ns) => newest_ns.saturating_sub(begun_ns) >= limit_ns,
            // The beginning of a part alone may be larger.
            Limit::Bytes(limit) => self.writer.bytes().saturating_sub(self.begun_bytes) >= limit,
        };
        if !over || self.part.number >= MOST_PARTS {
            return None;
        }
        let due_ns = self.due_ns.get_or_insert(newest_ns);
        let waited = newest_ns.saturating_sub(*due_ns) >= PATIENCE_NS;
        let prologue = self.recent.prologue().or_else(|| waited.then(|| self.recent.undetermined()));
        // What the part before the present one holds too would be read twice where the present one is missing.
        prologue.filter(|p| p.items.iter().all(|(at, ..)| *at > self.late_until_ns))
    }

    /// Begins the next part. Where it cannot be made, the present one goes on, and the next place is tried.
    fn go_on_in_new_part(&mut self, prologue: Prologue) -> Result<(), RecordingError> {
        let Prologue { items, after_step } = prologue;
        let number = self.part.number + 1;
        let part = PartOf { number, from: self.writer.numbers(), ..self.part.clone() };
        let mut writer = match self.new_writer(&part, after_step) {
            Ok(writer) => writer,
            Err(problem) => {
                // Said once, however often it is tried.
                if !std::mem::replace(&mut self.warned, true) {
                    self.warning = Some(format!("no further part of the recording can be begun: {problem}"));
                }
                self.due_ns = Some(self.recent.newest_ns());
                self.recent.forget_checkpoints();
                return Ok(());
            }
        };
        let mut done = Ok(());
        for (at, item, number) in &items {
            done = done.and(writer.repeat(*at, item, *number));
        }
        done = done.and(writer.close_chunk());
        let next = name_of(&part_file(&self.recording, number));
        let writer = std::mem::replace(&mut self.writer, writer);
        let late = self.recent.late();
        self.late_until_ns = late.until_ns;
        self.before.push(Ending { writer, late, next });
        // Each part begins later than the one before it, however small they are to be.
        self.recent.forget_checkpoints();
        self.begun_bytes = self.writer.bytes();
        (self.part, self.begun_ns, self.due_ns, self.warned) = (part, None, None, false);
        done
    }

    fn new_writer(&mut self, part: &PartOf, after_step: Option<u64>) -> Result<Writer, RecordingError> {
        let path = part_file(&self.recording, part.number);
        let provenance = provenance_of_part(&self.provenance, &name_of(&self.recording), after_step);
        let file = self.files.begin(&path)?;
        let mut writer = Writer::of_part(file, &path, &provenance, self.packing, part)?;
        if self.synced {
            writer.sync_along()?;
        }
        self.files.appear(&path)?;
        Ok(writer)
    }

    /// Closes the parts before the present one that are over.
    fn close(&mut self, is_over: impl Fn(&Ending) -> bool) -> Result<(), RecordingError> {
        while let Some(ending) = self.before.first_mut().filter(|ending| is_over(ending)) {
            match ending.writer.end_before(&ending.next) {
                Ok(()) => {}
                Err(problem @ RecordingError::NotSafe { .. }) => {
                    self.unsafe_because.get_or_insert(problem);
                }
                Err(problem) => return Err(problem),
            }
            self.closed += self.before.remove(0).writer.bytes();
        }
        Ok(())
    }

    /// As [`Writer::flush_aged`], of every part that is open.
    ///
    /// # Errors
    /// As there.
    pub fn flush_aged(&mut self, now_ns: Nanos) -> Result<(), RecordingError> {
        let newest_ns = self.recent.newest_ns();
        let mut done = Ok(());
        for ending in &mut self.before {
            done = done.and(ending.writer.flush_aged(now_ns));
        }
        done = done.and(self.close(|ending| ending.late.is_over(newest_ns)));
        self.writer.flush_aged(now_ns).and(done)
    }

    /// As [`Writer::end`], of every part that is open.
    ///
    /// # Errors
    /// As there.
    pub fn end(&mut self) -> Result<(), RecordingError> {
        self.close(|_| true)?;
        self.writer.end()?;
        self.unsafe_because.take().map_or(Ok(()), Err)
    }

    /// As [`PartsWriter::end`], for a caller that asks nothing of it any more.
    ///
    /// # Errors
    /// As there.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        self.end()
    }

    /// Items that were given and are not on a file.
    pub fn unwritten(&self) -> u64 {
        let before: u64 = self.before.iter().map(|ending| ending.writer.unwritten()).sum();
        before + self.writer.unwritten()
    }

    /// Bytes on all files.
    pub fn bytes(&self) -> u64 {
        let before: u64 = self.before.iter().map(|ending| ending.writer.bytes()).sum();
        self.closed + before + self.writer.bytes()
    }

    /// As [`Writer::sync_lag`], the longest of the parts that are open.
    pub fn sync_lag(&self) -> Duration {
        let before = self.before.iter().map(|ending| ending.writer.sync_lag());
        before.fold(self.writer.sync_lag(), Duration::max)
    }

    /// The name after which the parts are named.
    pub fn recording(&self) -> &Path {
        &self.recording
    }

    /// Number of the part that is written.
    pub fn number(&self) -> u32 {
        self.part.number
    }

    /// Why no further part could be begun; said once.
    pub fn take_warning(&mut self) -> Option<String> {
        self.warning.take()
    }
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// A name for a recording that no other one has.
fn set_of(provenance: &Provenance) -> String {
    let now_ns = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |now| now.as_nanos());
    let of = format!("{now_ns} {} {:?}", std::process::id(), provenance.config);
    format!("{now_ns:x}-{:016x}", fnv1a(of.as_bytes()))
}
