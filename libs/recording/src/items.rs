//! The items of a recording, one after the other, from its beginning or from a place where they were
//! read before.

use super::data_section::{DataSection, SectionPlace};
use super::records::Records;
use super::{Item, RecordingError, channel_numbers, record};
use mcap::records::Record;
use protocol::time::Nanos;
use std::collections::{HashMap, VecDeque};
use std::path::Path;
use std::sync::Arc;

/// How far the items of a recording were read: small, and to be kept as often as one likes. Of use as
/// long as the file stays as it is.
#[derive(Debug, Clone)]
pub struct Place {
    wanted: Arc<[&'static str]>,
    topics: Arc<Topics>,
    channels_known: bool,
    /// Where the present chunk begins; `None` in a file that cannot be read.
    section: Option<SectionPlace>,
    /// Items and errors that were given out since.
    given: u64,
}

impl Place {
    /// At a chunk of which nothing before it has been read, for all topics.
    pub(super) fn at(offset: u64, topics: Arc<Topics>) -> Self {
        let wanted = Item::TOPICS[..].into();
        let section = Some(SectionPlace::at(offset));
        Place { wanted, topics, channels_known: true, section, given: 0 }
    }

    /// The same place, for these topics only.
    #[must_use]
    pub fn of_topics(mut self, topics: &[&'static str]) -> Self {
        Arc::make_mut(&mut self.topics).retain(|_, topic| topics.contains(topic));
        self.wanted = topics.into();
        self
    }
}

/// Topics by channel.
type Topics = HashMap<u16, &'static str>;

/// Iterator over a recording's items.
#[derive(Debug)]
pub struct Items {
    /// The error stands here until it has been given out.
    section: Result<DataSection, Option<RecordingError>>,
    file: String,
    /// Topics to decode.
    wanted: Arc<[&'static str]>,
    /// Topic by channel, of those.
    topics: Arc<Topics>,
    /// The file has told its channels.
    channels_known: bool,
    /// What log times are ahead of the instants by which items are filed, ns.
    realtime_offset_ns: u64,
    /// What the last chunk held.
    ready: VecDeque<Result<(Nanos, Item), RecordingError>>,
    /// Where reading can go on: at the chunk that was begun last; `None` before the first.
    begun: Option<Place>,
    /// Results that come again before the next one that was not given out.
    passed_over: u64,
}

impl Items {
    /// Of the file from its beginning, of these topics; log times are ahead by `realtime_offset_ns`.
    pub(super) fn open(path: &Path, topics: &[&'static str], realtime_offset_ns: u64) -> Self {
        Items {
            section: Records::open(path).and_then(DataSection::new).map_err(Some),
            file: path.display().to_string(),
            wanted: topics.into(),
            topics: Arc::default(),
            channels_known: false,
            realtime_offset_ns,
            ready: VecDeque::new(),
            begun: None,
            passed_over: 0,
        }
    }

    /// Goes on at a place of this file. The chunk there is read again, and only once an item of it is asked
    /// for, so that nothing of it need be kept.
    pub fn go_to(&mut self, place: &Place) {
        self.wanted.clone_from(&place.wanted);
        self.topics.clone_from(&place.topics);
        self.channels_known = place.channels_known;
        self.ready.clear();
        if let (Ok(section), Some(at)) = (&mut self.section, &place.section)
            && let Err(problem) = section.go_to(at)
        {
            self.section = Err(Some(problem));
        }
        (self.begun, self.passed_over) = (Some(place.clone()), place.given);
    }

    /// The place behind what was given out last.
    pub fn place(&self) -> Place {
        self.begun.clone().unwrap_or_else(|| self.start())
    }

    /// The place at the present chunk's beginning.
    fn start(&self) -> Place {
        Place {
            wanted: Arc::clone(&self.wanted),
            topics: Arc::clone(&self.topics),
            channels_known: self.channels_known,
            section: self.section.as_ref().ok().and_then(DataSection::place),
            given: 0,
        }
    }

    /// Notes the place before a chunk, if it is one at which reading can go on.
    fn begin_chunk(&mut self) {
        let place = self.start();
        if place.section.is_some() || self.begun.is_none() {
            self.begun = Some(place);
        }
    }

    /// Bytes of the file read so far, for a progress bar.
    pub fn bytes_read(&self) -> u64 {
        self.section.as_ref().map_or(0, |section| section.records.offset)
    }

    /// All of the next chunk.
    ///
    /// # Errors
    /// What is wrong there first.
    pub(super) fn first_chunk(mut self) -> Result<Vec<(Nanos, Item)>, RecordingError> {
        self.advance()?;
        self.ready.drain(..).collect()
    }

    fn next_result(&mut self) -> Option<Result<(Nanos, Item), RecordingError>> {
        let next = loop {
            if let Some(item) = self.ready.pop_front() {
                break item;
            }
            self.begin_chunk();
            match self.advance() {
                Ok(true) => {}
                Ok(false) => return None,
                Err(error) => break Err(error),
            }
        };
        self.begun.iter_mut().for_each(|place| place.given += 1);
        Some(next)
    }

    /// Reads one chunk; false at the end of the data.
    fn advance(&mut self) -> Result<bool, RecordingError> {
        let section = match &mut self.section {
            Ok(section) => section,
            Err(failed) => return failed.take().map_or(Ok(false), Err),
        };
        let Some(records) = section.next_chunk()? else { return Ok(false) };
        if section.damaged && !self.channels_known {
            self.assume_channels();
        }
        records.into_iter().for_each(|record| self.take(record));
        Ok(true)
    }

    /// Where the chunk with the channels is lost, they are those that the writer makes.
    fn assume_channels(&mut self) {
        let all = channel_numbers().zip(Item::TOPICS);
        self.topics = Arc::new(all.filter(|(_, topic)| self.wanted.contains(topic)).collect());
        self.channels_known = true;
    }

    /// Decodes a message, or notes a channel.
    fn take(&mut self, record: Record<'_>) {
        match record {
            Record::Channel(channel) => {
                self.channels_known = true;
                let wanted = self.wanted.iter().find(|topic| **topic == channel.topic);
                if let Some(topic) = wanted {
                    Arc::make_mut(&mut self.topics).insert(channel.id, *topic);
                }
            }
            Record::Message { header, data } => {
                let Some(topic) = self.topics.get(&header.channel_id) else { return };
                let log_time_ns = header.log_time.wrapping_sub(self.realtime_offset_ns);
                let refused = |problem| {
                    let (file, topic) = (self.file.clone(), (*topic).into());
                    RecordingError::Message { file, topic, log_time_ns, problem }
                };
                let decoded = record::decode(topic, &data).map_err(refused);
                self.ready.extend(decoded.map(|item| item.map(|item| (log_time_ns, item))).transpose());
            }
            _ => {}
        }
    }
}

impl Iterator for Items {
    type Item = Result<(Nanos, Item), RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.passed_over > 0 {
            self.passed_over -= 1;
            drop(self.next_result());
        }
        self.next_result()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Note, NoteKind, Provenance, Recording, Writer};
    use super::*;
    use std::fs;

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
