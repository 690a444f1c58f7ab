//! The items of a recording, one after the other, through all its files, from its beginning or from a place
//! where they were read before.

use super::file_items::{FileItems, FilePlace, Topics};
use super::parts::RecordedFile;
use super::{Item, RecordingError};
use protocol::time::Nanos;
use std::sync::Arc;

/// How far the items of a recording were read: small, and to be kept as often as one likes. Of use as
/// long as its files stay as they are.
#[derive(Debug, Clone)]
pub struct Place {
    /// Which of the files.
    file: usize,
    within: FilePlace,
}

impl Place {
    /// At a chunk of a file of which nothing before it has been read, for all topics.
    pub(super) fn at(file: usize, offset: u64, topics: Arc<Topics>) -> Self {
        Place { file, within: FilePlace::at(offset, topics) }
    }

    /// The same place, for these topics only.
    #[must_use]
    pub fn of_topics(self, topics: &[&'static str]) -> Self {
        Place { within: self.within.of_topics(topics), ..self }
    }
}

/// Iterator over a recording's items.
#[derive(Debug)]
pub struct Items {
    files: Arc<[RecordedFile]>,
    realtime_offset_ns: u64,
    /// Which of the files is read.
    file: usize,
    within: FileItems,
    /// Bytes of the files before it.
    before: u64,
}

impl Items {
    /// Of the files from their beginning, of these topics; log times are ahead by `realtime_offset_ns`. There
    /// is one file at least.
    pub(super) fn open(
        files: &Arc<[RecordedFile]>,
        topics: &[&'static str],
        realtime_offset_ns: u64,
    ) -> Self {
        let within = FileItems::open(&files[0], &topics.into(), realtime_offset_ns);
        Items { files: Arc::clone(files), realtime_offset_ns, file: 0, within, before: 0 }
    }

    /// Goes on at a place of this recording. The chunk there is read again, and only once an item of it is asked
    /// for, so that nothing of it need be kept.
    pub fn go_to(&mut self, place: &Place) {
        // All that is known of a lost file has been said.
        if place.file != self.file || self.files[self.file].is_lost() {
            self.enter(place.file);
        }
        self.within.go_to(&place.within);
    }

    /// Begins to read a file.
    fn enter(&mut self, file: usize) {
        self.file = file;
        self.before = self.files[..file].iter().map(|file| file.bytes).sum();
        let wanted = Arc::clone(self.within.wanted());
        self.within = FileItems::open(&self.files[file], &wanted, self.realtime_offset_ns);
    }

    /// The place behind what was given out last.
    pub fn place(&self) -> Place {
        Place { file: self.file, within: self.within.place() }
    }

    /// Bytes of the files read so far, for a progress bar.
    pub fn bytes_read(&self) -> u64 {
        self.before + self.within.bytes_read()
    }

    /// All of the next chunk of the present file.
    ///
    /// # Errors
    /// What is wrong there first.
    pub(super) fn first_chunk(self) -> Result<Vec<(Nanos, Item)>, RecordingError> {
        self.within.first_chunk()
    }
}

impl Iterator for Items {
    type Item = Result<(Nanos, Item), RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let next = self.within.next();
            if next.is_some() || self.file + 1 == self.files.len() {
                return next;
            }
            self.enter(self.file + 1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Note, NoteKind, Provenance, Recording, Writer};
    use super::*;
    use std::fs;
    use std::path::Path;

    fn note(count: u64) -> Item {
        let text = "x".repeat(900);
        Item::Note(Note { instant_ns: 5, kind: NoteKind::Log, process: None, count, text })
    }

    /// What an iterator gives, as text.
    fn told(items: Items) -> Vec<String> {
        let of = |item: Result<(Nanos, Item), RecordingError>| match item {
            Ok((at, item)) => format!("{at} {:?}", item.encoded()),
            Err(error) => error.to_string(),
        };
        items.map(of).collect()
    }

    /// From every place on, the same follows as without a break.
    fn same_from_everywhere(path: &Path, wanted: &[&'static str]) -> usize {
        let recording = Recording::open(path).unwrap();
        let whole = told(recording.items_of(wanted));
        let from = |place: &Place| {
            let mut items = recording.items();
            items.go_to(place);
            items
        };
        let mut items = recording.items_of(wanted);
        for given in 0..=whole.len() {
            let place = items.place();
            assert!(told(from(&place)) == whole[given..], "behind {given}");
            assert!(told(from(&from(&place).place())) == whole[given..]);
            // A place of what went on from a place is as good.
            if given + 1 < whole.len() {
                let mut again = from(&place);
                again.next();
                assert!(told(from(&again.place())) == whole[given + 1..], "behind {given} + 1");
            }
            items.next();
        }
        whole.len()
    }

    #[test]
    fn from_every_place_the_same_items_and_errors_follow() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut writer = Writer::create(&path, &Provenance::default()).unwrap();
        for i in 0..90 {
            writer.write(i, &note(i)).unwrap();
            if i % 3 == 0 {
                writer.write(i, &Item::Pedal(bytemuck::Zeroable::zeroed())).unwrap();
            }
        }
        writer.finish().unwrap();
        assert_eq!(same_from_everywhere(&path, &Item::TOPICS), 120);
        assert_eq!(same_from_everywhere(&path, &["pedal"]), 30);
        let bytes = fs::read(&path).unwrap();
        let third = bytes.len() / 3;
        fs::write(&path, &bytes[..2 * third]).unwrap();
        assert!(same_from_everywhere(&path, &Item::TOPICS) > 10, "cut");
        // A chunk whose CRC is wrong, one whose length is, and several of them.
        for hits in [&[third][..], &[third, third + 1, 2 * third], &(third..third + 3000).collect::<Vec<_>>()]
        {
            let mut damaged = bytes.clone();
            hits.iter().for_each(|at| damaged[*at] ^= 0xff);
            fs::write(&path, &damaged).unwrap();
            assert!(same_from_everywhere(&path, &Item::TOPICS) > 10, "{} bytes changed", hits.len());
        }
    }
}
