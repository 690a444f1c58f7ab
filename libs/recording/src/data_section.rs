//! The data section of a recording: its chunks, one after the other, and what is wrong with them.
//!
//! Every byte that a result depends on is under a checksum: the chunks' own, that of the provenance
//! ([`super::checksum`]), and in a file that was closed in order one over everything. A file that was
//! not closed lacks the last, so its records are held to their form as well: only known records in
//! known places, lengths that agree with each other, and no index without its chunk.

use super::RecordingError;
use super::records::{Outer, Records, chunk_bytes, chunk_records};
use super::resync::{Found, find_next};
use mcap::parse_record;
use mcap::records::{Record, op};
use std::collections::{BTreeMap, VecDeque};

/// Iterator over the chunks of a recording.
#[derive(Debug)]
pub(super) struct DataSection {
    pub records: Records,
    /// The file ends with a footer.
    finished: bool,
    /// Something was wrong: sums over the whole say nothing new.
    pub damaged: bool,
    /// Messages by channel that the indexes to come must name; `None` where the chunk before them
    /// could not be read.
    unindexed: Option<BTreeMap<u16, u64>>,
    /// A chunk that was found behind damage.
    found: Option<Vec<Record<'static>>>,
    /// Further problems to be reported.
    problems: VecDeque<RecordingError>,
    messages: u64,
    ended: bool,
    /// What stands before the place where reading began is not known: sums over the whole say nothing.
    partial: bool,
}

/// Where reading goes on, and what it has seen until there.
#[derive(Debug, Clone)]
pub(super) struct SectionPlace {
    offset: u64,
    crc: crc32fast::Hasher,
    damaged: bool,
    unindexed: Option<BTreeMap<u16, u64>>,
    messages: u64,
    ended: bool,
    partial: bool,
}

impl SectionPlace {
    /// At a chunk of which nothing before it has been read.
    pub fn at(offset: u64) -> Self {
        SectionPlace {
            offset,
            crc: crc32fast::Hasher::new(),
            damaged: false,
            unindexed: None,
            messages: 0,
            ended: false,
            partial: true,
        }
    }
}

impl DataSection {
    /// The present place; `None` while something that was read waits to be reported, which no place can
    /// hold.
    pub fn place(&self) -> Option<SectionPlace> {
        let all_reported = self.found.is_none() && self.problems.is_empty();
        all_reported.then(|| SectionPlace {
            offset: self.records.offset,
            crc: self.records.crc.clone(),
            damaged: self.damaged,
            unindexed: self.unindexed.clone(),
            messages: self.messages,
            ended: self.ended,
            partial: self.partial,
        })
    }

    /// Goes on at a place of the same file.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn go_to(&mut self, place: &SectionPlace) -> Result<(), RecordingError> {
        let SectionPlace { offset, crc, damaged, unindexed, messages, ended, partial } = place;
        self.records.seek(*offset)?;
        self.records.crc.clone_from(crc);
        (self.damaged, self.messages, self.ended) = (*damaged, *messages, *ended);
        self.partial = *partial;
        self.unindexed.clone_from(unindexed);
        self.found = None;
        self.problems.clear();
        Ok(())
    }

    /// From the first record of a file.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn new(mut records: Records) -> Result<Self, RecordingError> {
        let finished = records.has_footer()?;
        Ok(DataSection {
            records,
            finished,
            damaged: false,
            unindexed: Some(BTreeMap::new()),
            found: None,
            problems: VecDeque::new(),
            messages: 0,
            ended: false,
            partial: false,
        })
    }

    /// Channels and messages of the next chunk; `None` at the end of the data.
    ///
    /// # Errors
    /// What is wrong; the next call goes on behind it.
    pub fn next_chunk(&mut self) -> Result<Option<Vec<Record<'static>>>, RecordingError> {
        loop {
            if let Some(problem) = self.problems.pop_front() {
                return Err(problem);
            }
            if let Some(records) = self.found.take() {
                return Ok(Some(records));
            }
            if self.ended {
                return Ok(None);
            }
            let offset = self.records.offset;
            match self.records.next_record() {
                Ok(Some(outer)) => {
                    if let Some(records) = self.take(outer)? {
                        return Ok(Some(records));
                    }
                }
                Ok(None) => {
                    self.ended = true;
                    if self.finished && !self.damaged {
                        return Err(self.records.damaged(offset, "the end of the data is missing"));
                    }
                }
                Err(problem) => return Err(self.broken_frame(offset, problem)),
            }
        }
    }

    /// Judges a record; the chunk, if it is one.
    fn take(&mut self, outer: Outer) -> Result<Option<Vec<Record<'static>>>, RecordingError> {
        let Outer { offset, opcode, body } = outer;
        match opcode {
            op::CHUNK => return self.chunk(offset, &body).map(Some),
            op::MESSAGE_INDEX => return self.index(offset, &body).map(|()| None),
            op::DATA_END if body.len() == 4 => {
                let sum = u32::from_le_bytes([body[0], body[1], body[2], body[3]]);
                return self.end(offset, sum).map(|()| None);
            }
            _ if chunk_bytes(&body) == Some(body.len() as u64) => {
                return Err(
                    self.damage(offset, format!("a chunk is marked as a record of kind {opcode:#04x}"))
                );
            }
            op::HEADER if offset == mcap::MAGIC.len() as u64 => {}
            op::METADATA | op::ATTACHMENT | op::SCHEMA => {}
            op::CHANNEL => {
                let channel = parse_record(opcode, &body).map(Record::into_owned);
                return channel.map(|channel| Some(vec![channel])).map_err(|e| self.damage(offset, e));
            }
            _ => return Err(self.damage(offset, format!("no record of kind {opcode:#04x} belongs here"))),
        }
        Ok(None)
    }

    fn chunk(&mut self, offset: u64, body: &[u8]) -> Result<Vec<Record<'static>>, RecordingError> {
        match chunk_records(body) {
            Ok(records) => {
                self.count(&records);
                Ok(records)
            }
            // The lengths agree, so that the next record begins where it should.
            Err(problem) if chunk_bytes(body) == Some(body.len() as u64) => {
                (self.damaged, self.unindexed) = (true, None);
                Err(self.records.damaged(offset, problem))
            }
            Err(problem) => Err(self.damage(offset, problem)),
        }
    }

    /// Notes what the indexes behind a chunk must name.
    fn count(&mut self, records: &[Record<'_>]) {
        let mut by_channel = BTreeMap::new();
        for record in records {
            if let Record::Message { header, .. } = record {
                *by_channel.entry(header.channel_id).or_insert(0) += 1;
                self.messages += 1;
            }
        }
        self.unindexed = Some(by_channel);
    }

    /// Compares an index with the chunk before it: an index without its chunk means that the chunk was lost.
    fn index(&mut self, offset: u64, body: &[u8]) -> Result<(), RecordingError> {
        const ENTRY_BYTES: usize = 16;
        let (channel, count) = match body {
            [a, b, c, d, e, f, entries @ ..]
                if u32::from_le_bytes([*c, *d, *e, *f]) as usize == entries.len()
                    && entries.len().is_multiple_of(ENTRY_BYTES) =>
            {
                (u16::from_le_bytes([*a, *b]), (entries.len() / ENTRY_BYTES) as u64)
            }
            // Its end is not where it says, whatever stood before it.
            _ => return Err(self.damage(offset, "an index of messages has a wrong length")),
        };
        let Some(unindexed) = &mut self.unindexed else { return Ok(()) };
        if unindexed.remove(&channel) == Some(count) {
            return Ok(());
        }
        let problem =
            format!("the index lists {count} messages of channel {channel} that no chunk before it holds");
        Err(self.damage(offset, problem))
    }

    /// A frame that is cut or makes no sense. Where nothing follows, the file was cut.
    fn broken_frame(&mut self, offset: u64, problem: RecordingError) -> RecordingError {
        if matches!(problem, RecordingError::Io { .. }) {
            self.ended = true;
            return problem;
        }
        let damage = self.damage(offset, "the length of a record is wrong");
        match problem {
            RecordingError::Truncated { .. } if !self.ended || self.finished => damage,
            other => other,
        }
    }

    /// A problem at `offset`, after which reading goes on at the first good chunk from there on.
    fn damage(&mut self, offset: u64, problem: impl ToString) -> RecordingError {
        (self.damaged, self.unindexed) = (true, None);
        let gone_on = find_next(&mut self.records, offset).and_then(|found| match found {
            Some(Found::Chunk { records, end }) => {
                self.count(&records);
                self.found = Some(records);
                self.records.seek(end)
            }
            Some(Found::End { at }) => self.records.seek(at),
            None => {
                self.ended = true;
                self.records.seek(self.records.length)
            }
        });
        if let Err(problem) = gone_on {
            self.ended = true;
            self.problems.push_back(problem);
        }
        self.records.damaged(offset, problem)
    }

    /// At the end of the data: are they whole, and is what follows? `sum` is 0 where there is none.
    fn end(&mut self, offset: u64, sum: u32) -> Result<(), RecordingError> {
        self.ended = true;
        if !self.damaged && !self.partial && sum != 0 && sum != self.records.crc.clone().finalize() {
            let problem = "the data before it do not match the file's checksum";
            self.problems.push_back(self.records.damaged(offset, problem));
        }
        if self.finished {
            self.summary()?;
        }
        Ok(())
    }

    /// Reads the summary, which repeats what stands before it: only its checksum counts, and behind
    /// damage its number of messages.
    fn summary(&mut self) -> Result<(), RecordingError> {
        let (offset, length) = (self.records.offset, self.records.length);
        let mut summary = vec![0; length.saturating_sub(offset) as usize];
        self.records.read(&mut summary)?;
        let sum_at = summary.len().checked_sub(4 + mcap::MAGIC.len());
        let Some((covered, tail)) = sum_at.and_then(|at| summary.split_at_checked(at)) else { return Ok(()) };
        let sum = u32::from_le_bytes([tail[0], tail[1], tail[2], tail[3]]);
        if sum != 0 && sum != crc32fast::hash(covered) {
            let problem = "the summary does not match its checksum (the data may be intact)";
            self.problems.push_back(self.records.damaged(offset, problem));
        } else if let Some(all) =
            messages_of(covered).filter(|all| self.damaged && !self.partial && *all > self.messages)
        {
            let problem = format!("{} of {all} messages of the file are missing", all - self.messages);
            self.problems.push_back(self.records.damaged(offset, problem));
        }
        Ok(())
    }
}

/// Messages in the file by the statistics of its summary.
fn messages_of(mut summary: &[u8]) -> Option<u64> {
    loop {
        let (opcode, rest) = summary.split_first()?;
        let (size, rest) = rest.split_first_chunk()?;
        let (body, rest) = rest.split_at_checked(u64::from_le_bytes(*size) as usize)?;
        match parse_record(*opcode, body) {
            Ok(Record::Statistics(statistics)) => return Some(statistics.message_count),
            _ => summary = rest,
        }
    }
}
