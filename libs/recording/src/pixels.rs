//! Recordings of pixels: the fields of a rig's cameras in an MCAP file of their own.
//!
//! Each field is a message on the topic `/cameraN/pixels`, filed by the instant at which it was read out: the header as
//! cameras publish it ([`FieldHeader`], every stamp of it), and its samples, compressed by Zstandard without
//! loss. A schema in the file says so (`vitreo.FieldPixels`, protobuf). Chunks are written whole and carry a CRC, so a
//! file whose writer was killed is readable up to its last chunk.

mod settings;

pub use settings::CameraSettings;

use super::checksum;
use super::descriptors;
use super::protobuf::{Fields, Value, put_bytes, put_uint};
use super::records::{Records, chunk_records};
use super::{MessageError, REALTIME_OFFSET, RecordingError};
use mcap::records::{MessageHeader, Metadata, Record, op};
use mcap::{McapError, WriteOptions};
use protocol::fields::FieldHeader;
use protocol::message::Message;
use protocol::wire::{Field, layout_of};
use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::Cursor;
use std::path::Path;

/// MCAP profile of a recording of pixels.
pub const PIXELS_PROFILE: &str = "vitreo-pixels";
/// Version of the format; another one is refused.
const FORMAT: &str = "vitreo-pixels-1";
/// Name of the metadata record.
const METADATA: &str = "vitreo-pixels";
/// Key of a camera's source in it, before the camera's id.
const SOURCE: &str = "source-";
/// Name of the message.
pub(super) const MESSAGE: &str = "FieldPixels";
/// Number of the compressed samples among its fields; those of the header come first.
pub(super) const PIXELS_TAG: u32 = 100;
/// Fields of the message, numbered from 1: those of the header, by their names. The order never changes.
pub(super) const FIELDS: [&str; 10] = [
    "field",
    "exposed_ns",
    "first_line_ns",
    "line_period_ns",
    "camera",
    "parity",
    "format",
    "width",
    "height",
    "lines",
];
/// A chunk is closed once it is this large, bytes: a kill costs a few fields.
const CHUNK_BYTES: u64 = 1 << 20;
/// Of Zstandard: the fastest of the usual ones; sensors' noise is what is left.
const LEVEL: i32 = 1;
/// Largest samples of a field: the widest and highest sensor, three bytes a pixel.
const MOST_BYTES: usize = 3 * 8192 * 8192;

/// What a recording of pixels says of itself.
#[derive(Debug, Clone, PartialEq)]
pub struct PixelsHead {
    /// The rig file's text.
    pub rig_json: String,
    /// Ids of the cameras, in the rig's order.
    pub cameras: Vec<u32>,
    /// Fields a second of the fastest.
    pub field_hz: f64,
    /// CLOCK_REALTIME less CLOCK_MONOTONIC at the start, ns, wrapping.
    pub realtime_offset_ns: u64,
    /// Where their pictures came from, as `--cameras` took it, with the settings that were asked for; in the order of
    /// `cameras`. Files of earlier versions have none.
    pub sources: Vec<String>,
}

/// Writes a recording of pixels.
pub struct PixelsWriter {
    file: String,
    writer: mcap::Writer<File>,
    channels: BTreeMap<u32, (u16, u32)>,
    realtime_offset_ns: u64,
    packer: zstd::bulk::Compressor<'static>,
    message: Vec<u8>,
}

impl PixelsWriter {
    /// Begins one in a file that is open and empty; `path` is its name in messages.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn on(target: File, path: &Path, head: &PixelsHead) -> Result<Self, RecordingError> {
        let file = path.display().to_string();
        let failed = |e| failure(&file, e);
        let options = WriteOptions::new()
            .profile(PIXELS_PROFILE)
            .library(format!("vitreo {}", env!("CARGO_PKG_VERSION")))
            .compression(None)
            .disable_seeking(true)
            .chunk_size(Some(CHUNK_BYTES));
        let mut writer = options.create(target).map_err(failed)?;
        let metadata = checksum::signed(pairs(head));
        writer.write_metadata(&Metadata { name: METADATA.into(), metadata }).map_err(failed)?;
        let name = format!("{}.{MESSAGE}", descriptors::PACKAGE);
        let schema = writer.add_schema(&name, "protobuf", &descriptors::of_pixels()).map_err(failed)?;
        let mut channels = BTreeMap::new();
        for &camera in &head.cameras {
            let topic = format!("/camera{camera}/pixels");
            let channel = writer.add_channel(schema, &topic, "protobuf", &BTreeMap::new()).map_err(failed)?;
            channels.insert(camera, (channel, 0));
        }
        let packer = zstd::bulk::Compressor::new(LEVEL).map_err(|e| failure(&file, McapError::Io(e)))?;
        let realtime_offset_ns = head.realtime_offset_ns;
        Ok(PixelsWriter { file, writer, channels, realtime_offset_ns, packer, message: Vec::new() })
    }

    /// Appends a field; `samples` are those that its header says.
    ///
    /// # Errors
    /// A field of a camera that the head does not name, or a file that cannot be written.
    pub fn write(&mut self, header: &FieldHeader, samples: &[u8]) -> Result<(), RecordingError> {
        let refused = |problem: String| RecordingError::Write { file: self.file.clone(), problem };
        if samples.len() != header.bytes() {
            let (expected, found) = (header.bytes(), samples.len());
            return Err(refused(format!("a field of {expected} bytes of samples has {found}")));
        }
        let channel = self.channels.get_mut(&header.camera);
        let (channel_id, count) = channel.ok_or_else(|| refused(format!("no camera {}", header.camera)))?;
        let packed = self.packer.compress(samples).map_err(|e| failure(&self.file, McapError::Io(e)))?;
        self.message.clear();
        for (tag, field) in fields() {
            put_uint(&mut self.message, tag, number(field.bytes(bytemuck::bytes_of(header))));
        }
        put_bytes(&mut self.message, PIXELS_TAG, &packed);
        let log_time = header.read_out_ns().wrapping_add(self.realtime_offset_ns);
        let (channel_id, sequence) = (*channel_id, *count);
        *count = count.wrapping_add(1);
        let header = MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
        self.writer.write_to_known_channel(&header, &self.message).map_err(|e| failure(&self.file, e))
    }

    /// Ends the file in order. Without it, it is left as by a kill.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        self.writer.finish().map_err(|e| failure(&self.file, e))?;
        let target = self.writer.into_inner();
        target.sync_all().map_err(|e| failure(&self.file, McapError::Io(e)))
    }
}

fn failure(file: &str, error: McapError) -> RecordingError {
    let file = file.to_owned();
    match error {
        McapError::Io(problem) => RecordingError::Io { file, problem },
        other => RecordingError::Write { file, problem: other.to_string() },
    }
}

fn pairs(head: &PixelsHead) -> BTreeMap<String, String> {
    let cameras: Vec<String> = head.cameras.iter().map(u32::to_string).collect();
    let pairs = [
        ("format", FORMAT.to_owned()),
        ("rig", head.rig_json.clone()),
        ("cameras", cameras.join(",")),
        ("field-hz", head.field_hz.to_string()),
        (REALTIME_OFFSET, head.realtime_offset_ns.to_string()),
    ];
    let sources = head.cameras.iter().zip(&head.sources);
    let sources = sources.map(|(camera, source)| (format!("{SOURCE}{camera}"), source.clone()));
    pairs.into_iter().map(|(key, value)| (key.to_owned(), value)).chain(sources).collect()
}

fn head_of(pairs: &BTreeMap<String, String>) -> Result<PixelsHead, String> {
    let of = |key: &str| pairs.get(key).ok_or_else(|| format!("its head has no {key:?}"));
    let odd = |key: &str| format!("its head has an invalid {key:?}");
    let format = of("format")?;
    if format != FORMAT {
        return Err(format!("expected the format {FORMAT}, found {format:?}"));
    }
    if checksum::holds(pairs) != Some(true) {
        return Err("its head does not agree with its checksum".into());
    }
    let cameras: Result<Vec<u32>, _> = of("cameras")?.split(',').map(str::parse).collect();
    let cameras = cameras.map_err(|_| odd("cameras"))?;
    let source = |camera: &u32| pairs.get(&format!("{SOURCE}{camera}")).cloned();
    let field_hz = of("field-hz")?.parse().ok().filter(|hz: &f64| hz.is_finite() && *hz > 0.0);
    Ok(PixelsHead {
        rig_json: of("rig")?.clone(),
        field_hz: field_hz.ok_or_else(|| odd("field-hz"))?,
        realtime_offset_ns: of(REALTIME_OFFSET)?.parse().map_err(|_| odd(REALTIME_OFFSET))?,
        sources: cameras.iter().map_while(source).collect(),
        cameras,
    })
}

/// Reads a recording of pixels, or of one of its cameras, from front to back.
#[derive(Debug)]
pub struct PixelsReader {
    records: Records,
    /// What it says of itself.
    pub head: PixelsHead,
    /// The one camera that is read; `None` for all.
    camera: Option<u32>,
    waiting: VecDeque<Vec<u8>>,
    /// The end of the data was reached; what follows is no field.
    is_over: bool,
    /// The file is not whole: its writer was killed, or is still writing.
    pub is_cut: bool,
    /// What its cameras were set to, as far as it was read.
    pub settings: CameraSettings,
}

impl PixelsReader {
    /// True of a file that begins as MCAP does.
    pub fn is_mcap(begin: &[u8]) -> bool {
        begin.starts_with(mcap::MAGIC)
    }

    /// Opens a file; of `camera` alone where one is given.
    ///
    /// # Errors
    /// A file that cannot be read, or is none of this kind.
    pub fn open(path: &Path, camera: Option<u32>) -> Result<Self, RecordingError> {
        let mut records = Records::open(path)?;
        let file = records.file.clone();
        let foreign = |problem: String| RecordingError::Foreign { file: file.clone(), problem };
        loop {
            let record = records.next_record()?.ok_or_else(|| foreign("it has no head".into()))?;
            match record.opcode {
                op::HEADER | op::SCHEMA | op::CHANNEL => {}
                op::METADATA => {
                    let parsed = mcap::parse_record(record.opcode, &record.body);
                    let Ok(Record::Metadata(found)) = parsed else {
                        return Err(records.damaged(record.offset, "its head cannot be read"));
                    };
                    if found.name == crate::write::METADATA {
                        return Err(RecordingError::OtherKind {
                            file,
                            expected: "a recording of pixels (vitreo cameras --record-fields FILE.mcap)",
                            found: "a recording of a run",
                        });
                    }
                    if found.name != METADATA {
                        let problem = format!("it contains {:?}, not pixels", found.name);
                        return Err(foreign(problem));
                    }
                    let head = head_of(&found.metadata).map_err(foreign)?;
                    return Ok(PixelsReader {
                        records,
                        head,
                        camera,
                        waiting: VecDeque::new(),
                        is_over: false,
                        is_cut: false,
                        settings: CameraSettings::new(),
                    });
                }
                _ => return Err(foreign("it does not begin with the head of a recording of pixels".into())),
            }
        }
    }

    /// The next field; its samples are put into `samples`. `None` at the end, also when asked again, or where the file
    /// was cut.
    ///
    /// # Errors
    /// A damaged file.
    pub fn next(&mut self, samples: &mut Vec<u8>) -> Result<Option<FieldHeader>, RecordingError> {
        while !self.is_over {
            let offset = self.records.offset;
            if let Some(message) = self.waiting.pop_front() {
                let damaged = |e: MessageError| self.records.damaged(offset, format!("a field: {e}"));
                let found = decode(&message, self.camera, samples).map_err(damaged)?;
                if let Some(header) = found {
                    return Ok(Some(header));
                }
                continue;
            }
            let record = match self.records.next_record() {
                Err(RecordingError::Truncated { .. }) | Ok(None) => {
                    (self.is_cut, self.is_over) = (true, true);
                    break;
                }
                record => record?,
            };
            let Some(record) = record else { break };
            match record.opcode {
                op::DATA_END => self.is_over = true,
                op::METADATA => settings::take(record.opcode, &record.body, &mut self.settings),
                op::CHUNK => {
                    let records =
                        chunk_records(&record.body).map_err(|e| self.records.damaged(record.offset, e))?;
                    self.waiting.extend(records.into_iter().filter_map(|record| match record {
                        Record::Message { data, .. } => Some(data.into_owned()),
                        _ => None,
                    }));
                }
                _ => {}
            }
        }
        Ok(None)
    }
}

/// Numbers and places of the header's fields.
pub(super) fn fields() -> impl Iterator<Item = (u32, &'static Field)> {
    let place = |name: &str| layout_of::<FieldHeader>().fields.iter().find(|field| field.name == name);
    (1..).zip(FIELDS).filter_map(move |(number, name)| Some((number, place(name)?)))
}

/// An unsigned number of 4 or 8 bytes.
fn number(bytes: &[u8]) -> u64 {
    let mut wide = [0; 8];
    wide[..bytes.len()].copy_from_slice(bytes);
    u64::from_le_bytes(wide)
}

/// The header of a message and its samples; `None` of another camera than `camera`.
fn decode(
    message: &[u8],
    camera: Option<u32>,
    samples: &mut Vec<u8>,
) -> Result<Option<FieldHeader>, MessageError> {
    let mut header: FieldHeader = bytemuck::Zeroable::zeroed();
    let odd = |problem: &str| MessageError::Encoding(problem.into());
    let mut packed = None;
    for entry in Fields(message) {
        match entry? {
            (PIXELS_TAG, Value::Delimited(bytes)) => packed = Some(bytes),
            (tag, Value::Varint(value)) => {
                if let Some((_, field)) = fields().find(|(number, _)| *number == tag) {
                    let to = field.bytes_mut(bytemuck::bytes_of_mut(&mut header));
                    to.copy_from_slice(&value.to_le_bytes()[..to.len()]);
                }
            }
            _ => {}
        }
    }
    header.validate().map_err(MessageError::Invalid)?;
    if camera.is_some_and(|camera| camera != header.camera) {
        return Ok(None);
    }
    let packed = packed.ok_or_else(|| odd("it has no samples"))?;
    let expected = header.bytes();
    if expected > MOST_BYTES {
        return Err(odd("it has more samples than any sensor"));
    }
    // As many as the header says, and one more to notice that there are more.
    samples.clear();
    let unpacker = zstd::stream::read::Decoder::with_buffer(Cursor::new(packed));
    let read = unpacker.and_then(|unpacker| {
        use std::io::Read;
        unpacker.take(expected as u64 + 1).read_to_end(samples)
    });
    match read {
        Ok(found) if found == expected => Ok(Some(header)),
        Ok(found) => Err(odd(&format!("expected {expected} bytes of samples, found {found} or more"))),
        Err(problem) => Err(odd(&format!("its samples cannot be unpacked: {problem}"))),
    }
}

#[cfg(test)]
mod tests;
