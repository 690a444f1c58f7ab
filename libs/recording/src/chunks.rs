//! The chunks of a recording, packed by the `mcap` crate in bounded memory.
//!
//! The crate's writer keeps some 270 bytes of index for each chunk until it ends: 12 MB an hour. So a
//! new one takes its place after every [`CHUNKS`] chunks, and goes on at the same place of the file;
//! what the one before has to say at the end goes into an [`Index`]. The file is the same.

use super::summary::Index;
use super::{FIRST_TOPICS, Item, descriptors, message_name, viewer_messages};
use mcap::records::{MessageHeader, Metadata};
use mcap::{McapResult, WriteOptions};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Error, ErrorKind, Seek, SeekFrom, Write};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Chunks after which a new writer of the crate takes the place of the one before.
const CHUNKS: u32 = 512;

/// What the crate has written and the disk has not taken over yet.
#[derive(Default)]
struct Bytes {
    bytes: Vec<u8>,
    /// Bytes written before and after those that were taken: the place in the file.
    position: u64,
}

#[derive(Clone, Default)]
struct Sink(Arc<Mutex<Bytes>>);

impl Sink {
    fn lock(&self) -> MutexGuard<'_, Bytes> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take(&self) -> Vec<u8> {
        std::mem::take(&mut self.lock().bytes)
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut inner = self.lock();
        inner.bytes.extend_from_slice(bytes);
        inner.position += bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Sink {
    /// Returns the position; the crate seeks nowhere else if seeking is disabled.
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match to {
            SeekFrom::Current(0) => Ok(self.lock().position),
            _ => Err(Error::new(ErrorKind::Unsupported, "a recording is written from front to back")),
        }
    }
}

/// Numbers of the channels of items and of the messages for viewers.
pub(super) type Channels = ([u16; Item::TOPICS.len()], [u16; viewer_messages::TOPICS.len()]);

pub(super) struct Chunks {
    options: WriteOptions,
    mcap: mcap::Writer<Sink>,
    sink: Sink,
    index: Index,
    /// CRC-32 of what was taken.
    crc: crc32fast::Hasher,
    /// Chunks of the present writer, and their limit.
    count: u32,
    most: u32,
    renewed: bool,
}

impl Chunks {
    /// Begins a file with `metadata` and the channels; `scratch` is an unnamed file for the index.
    pub fn begin(
        options: WriteOptions,
        metadata: &Metadata,
        scratch: Option<File>,
    ) -> McapResult<(Self, Channels)> {
        // Without seeking, a chunk reaches the sink in one piece with its length and CRC known.
        let options = options.disable_seeking(true);
        let sink = Sink::default();
        let mut mcap = options.clone().create(sink.clone())?;
        mcap.write_metadata(metadata)?;
        let channels = add_channels(&mut mcap)?;
        mcap.flush()?;
        let (index, crc) = (Index::new(scratch), crc32fast::Hasher::new());
        Ok((Chunks { options, mcap, sink, index, crc, count: 1, most: CHUNKS, renewed: false }, channels))
    }

    /// Appends a message; the chunk before it is closed where it was large enough.
    pub fn append(&mut self, header: &MessageHeader, message: &[u8]) -> McapResult<()> {
        if self.count >= self.most {
            self.flush()?;
        }
        let before = self.sink.lock().position;
        self.mcap.write_to_known_channel(header, message)?;
        self.count += u32::from(self.sink.lock().position > before);
        Ok(())
    }

    /// Closes the open chunk.
    pub fn flush(&mut self) -> McapResult<()> {
        let before = self.sink.lock().position;
        self.mcap.flush()?;
        self.count += u32::from(self.sink.lock().position > before);
        if self.count >= self.most { self.renew() } else { Ok(()) }
    }

    /// Closes the open chunk, and puts a metadata record behind it.
    pub fn note(&mut self, metadata: &Metadata) -> McapResult<()> {
        self.flush()?;
        self.mcap.write_metadata(metadata)
    }

    /// What is to be written next: whole chunks with their message indexes.
    pub fn take(&mut self) -> Vec<u8> {
        let piece = self.sink.take();
        self.crc.update(&piece);
        piece
    }

    /// Puts a new writer in the place of the present one, which has no open chunk.
    fn renew(&mut self) -> McapResult<()> {
        let (waiting, position) = (self.sink.take(), self.sink.lock().position);
        let summary = self.mcap.finish()?;
        self.index.take_in(&self.sink.take(), summary.stats.as_ref(), self.renewed);
        // Its beginning stands in the file already.
        self.mcap = self.options.clone().create(self.sink.clone())?;
        add_channels(&mut self.mcap)?;
        self.mcap.flush()?;
        *self.sink.lock() = Bytes { bytes: waiting, position };
        (self.count, self.renewed) = (1, true);
        Ok(())
    }

    /// Closes the last chunk; returns it, and the end of the file after it.
    pub fn end(&mut self) -> McapResult<[Vec<u8>; 2]> {
        self.mcap.flush()?;
        let (chunk, position) = (self.take(), self.sink.lock().position);
        let summary = self.mcap.finish()?;
        let tail = self.sink.take();
        self.index.take_in(&tail, summary.stats.as_ref(), self.renewed);
        let crc = self.crc.clone().finalize();
        Ok([chunk, self.index.end_of_file(&tail, position, crc)])
    }
}

fn add_channels(mcap: &mut mcap::Writer<Sink>) -> McapResult<Channels> {
    let none = BTreeMap::new();
    let (mut channels, mut viewers) = ([0; Item::TOPICS.len()], [0; viewer_messages::TOPICS.len()]);
    let mut add = |mcap: &mut mcap::Writer<Sink>, i: usize| {
        let schema = mcap.add_schema(&message_name(i), "protobuf", &descriptors::file_descriptor_set(i))?;
        channels[i] = mcap.add_channel(schema, Item::TOPICS[i], "protobuf", &none)?;
        McapResult::Ok(())
    };
    let mut add_viewer = |mcap: &mut mcap::Writer<Sink>, i: usize| {
        let schema = match viewer_messages::schema(i) {
            Some(s) => mcap.add_schema(&s.name, &s.encoding, &s.data)?,
            None => 0,
        };
        viewers[i] = mcap.add_channel(schema, viewer_messages::TOPICS[i], "protobuf", &none)?;
        McapResult::Ok(())
    };
    (0..FIRST_TOPICS).try_for_each(|i| add(mcap, i))?;
    (0..viewer_messages::FIRST).try_for_each(|i| add_viewer(mcap, i))?;
    (FIRST_TOPICS..Item::TOPICS.len()).try_for_each(|i| add(mcap, i))?;
    (viewer_messages::FIRST..viewer_messages::TOPICS.len()).try_for_each(|i| add_viewer(mcap, i))?;
    Ok((channels, viewers))
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcap::Compression;

    /// A file of 800 small chunks, whose index is more than is kept in memory, with at most `most` of them for each of the crate's writers.
    fn file(most: u32, scratch: Option<File>) -> Vec<u8> {
        let options = WriteOptions::new().compression(Some(Compression::Zstd)).chunk_size(Some(1 << 20));
        let metadata = Metadata { name: "m".into(), metadata: BTreeMap::from([("a".into(), "b".into())]) };
        let (mut chunks, (channels, _)) = Chunks::begin(options, &metadata, scratch).unwrap();
        chunks.most = most;
        let mut file = chunks.take();
        for i in 0..4000 {
            let channel_id = channels[i as usize % 3];
            let header =
                MessageHeader { channel_id, sequence: i, log_time: 70 + 10 * u64::from(i), publish_time: 9 };
            chunks.append(&header, &[i as u8; 40]).unwrap();
            if i % 5 == 4 {
                chunks.flush().unwrap();
                file.extend(chunks.take());
            }
        }
        chunks.end().unwrap().iter().for_each(|piece| file.extend(piece));
        file
    }

    #[test]
    fn a_file_of_many_writers_is_that_of_one() {
        let whole = file(u32::MAX, None);
        let summary = mcap::Summary::read(&whole).unwrap().unwrap();
        assert_eq!(summary.chunk_indexes.len(), 801);
        assert_eq!(mcap::MessageStream::new(&whole).unwrap().count(), 4000);
        for most in [2, 3, 17, 800, 801, 802] {
            assert!(file(most, None) == whole, "{most} chunks a writer, index in memory");
            assert!(
                file(most, tempfile::tempfile().ok()) == whole,
                "{most} chunks a writer, index in a file"
            );
        }
    }

    #[test]
    fn without_its_index_a_file_is_whole_all_the_same() {
        let scratch = tempfile::NamedTempFile::new().unwrap();
        let unreadable = File::options().write(true).open(scratch.path()).unwrap();
        let file = file(17, Some(unreadable));
        let summary = mcap::Summary::read(&file).unwrap().unwrap();
        assert!(summary.chunk_indexes.is_empty() && summary.stats.unwrap().chunk_count == 801);
        assert_eq!(mcap::MessageStream::new(&file).unwrap().count(), 4000);
    }

    #[test]
    fn what_large_messages_close_is_indexed_too() {
        let options = WriteOptions::new().compression(None).chunk_size(Some(1000));
        let metadata = Metadata { name: "m".into(), metadata: BTreeMap::new() };
        let (mut chunks, (channels, _)) = Chunks::begin(options, &metadata, None).unwrap();
        chunks.most = 7;
        let mut file = Vec::new();
        for i in 0..100 {
            let header = MessageHeader { channel_id: channels[0], sequence: i, log_time: 1, publish_time: 1 };
            chunks.append(&header, &[7; 600]).unwrap();
            file.extend(chunks.take());
        }
        chunks.end().unwrap().iter().for_each(|piece| file.extend(piece));
        let summary = mcap::Summary::read(&file).unwrap().unwrap();
        // The first one holds the schemas.
        let counts = summary.chunk_indexes.iter().skip(1).map(|index| {
            summary.read_message_indexes(&file, index).unwrap().values().map(Vec::len).sum::<usize>()
        });
        assert_eq!(counts.sum::<usize>(), 100);
        assert_eq!(mcap::MessageStream::new(&file).unwrap().count(), 100);
    }
}
