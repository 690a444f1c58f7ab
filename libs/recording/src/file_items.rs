//! The items of one file, one after the other, from its beginning or from a place where they were read before.

use super::data_section::{DataSection, SectionPlace};
use super::parts::{Kept, RecordedFile};
use super::records::Records;
use super::{Item, RecordingError, channel_numbers, record};
use mcap::records::Record;
use protocol::time::Nanos;
use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

/// How far the items of a file were read.
#[derive(Debug, Clone)]
pub(super) struct FilePlace {
    wanted: Arc<[&'static str]>,
    topics: Arc<Topics>,
    channels_known: bool,
    /// Where the present chunk begins; `None` in a file that cannot be read.
    section: Option<SectionPlace>,
    /// Items and errors that were given out since.
    given: u64,
}

impl FilePlace {
    /// At a chunk of which nothing before it has been read, for all topics.
    pub fn at(offset: u64, topics: Arc<Topics>) -> Self {
        let wanted = Item::TOPICS[..].into();
        let section = Some(SectionPlace::at(offset));
        FilePlace { wanted, topics, channels_known: true, section, given: 0 }
    }

    /// The same place, for these topics only.
    pub fn of_topics(mut self, topics: &[&'static str]) -> Self {
        Arc::make_mut(&mut self.topics).retain(|_, topic| topics.contains(topic));
        self.wanted = topics.into();
        self
    }
}

/// Topics by channel.
pub(super) type Topics = HashMap<u16, &'static str>;

/// Iterator over a file's items.
#[derive(Debug)]
pub(super) struct FileItems {
    /// The error stands here until it has been given out.
    section: Result<DataSection, Option<RecordingError>>,
    file: String,
    /// Which of its messages belong to the recording.
    kept: Arc<Kept>,
    /// Topics to decode.
    wanted: Arc<[&'static str]>,
    /// Topic by channel, of those.
    topics: Arc<Topics>,
    /// The channels of the file have been read.
    channels_known: bool,
    /// What log times are ahead of the instants by which items are filed, ns.
    realtime_offset_ns: u64,
    /// What the last chunk held.
    ready: VecDeque<Result<(Nanos, Item), RecordingError>>,
    /// Where reading can go on: at the chunk that was begun last; `None` before the first.
    begun: Option<FilePlace>,
    /// Results that come again before the next one that was not given out.
    passed_over: u64,
}

impl FileItems {
    /// Of the file from its beginning, of these topics; log times are ahead by `realtime_offset_ns`. A file
    /// that is lost gives its error.
    pub fn open(file: &RecordedFile, topics: &Arc<[&'static str]>, realtime_offset_ns: u64) -> Self {
        let section = match file.lost() {
            Some(lost) => Err(Some(lost)),
            None => Records::open(&file.path).and_then(DataSection::new).map_err(Some),
        };
        FileItems {
            section,
            file: file.path.display().to_string(),
            kept: Arc::clone(&file.kept),
            wanted: Arc::clone(topics),
            topics: Arc::default(),
            channels_known: false,
            realtime_offset_ns,
            ready: VecDeque::new(),
            begun: None,
            passed_over: 0,
        }
    }

    /// Topics that are decoded.
    pub fn wanted(&self) -> &Arc<[&'static str]> {
        &self.wanted
    }

    /// Goes on at a place of this file. The chunk there is read again, and only once an item of it is asked
    /// for, so that nothing of it need be kept.
    pub fn go_to(&mut self, place: &FilePlace) {
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
    pub fn place(&self) -> FilePlace {
        self.begun.clone().unwrap_or_else(|| self.start())
    }

    /// The place at the present chunk's beginning.
    fn start(&self) -> FilePlace {
        FilePlace {
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
    pub fn first_chunk(mut self) -> Result<Vec<(Nanos, Item)>, RecordingError> {
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
                if !self.kept.holds(topic, header.sequence) {
                    return;
                }
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

impl Iterator for FileItems {
    type Item = Result<(Nanos, Item), RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.passed_over > 0 {
            self.passed_over -= 1;
            drop(self.next_result());
        }
        self.next_result()
    }
}
