//! Reading a recording, whole or not.
//!
//! The file's outer records are framed and held to their checksums here ([`super::data_section`]), so
//! that every problem has a byte offset and reading goes on behind damage; chunks and records are
//! parsed by the `mcap` crate.

use super::items::Items;
use super::parts::{PartOf, RecordedFile, assemble, parts_of};
use super::records::{Outer, Records};
use super::write::METADATA;
use super::{FORMAT, Item, PIXELS_PROFILE, PROFILE, Provenance, RecordingError, Source, checksum};
use mcap::parse_record;
use mcap::records::{Record, op};
use protocol::file::STDIN;
use protocol::steps::STATE_HASH_VERSION;
use protocol::time::Nanos;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A recording opened for reading.
#[derive(Debug)]
pub struct Recording {
    pub(super) path: PathBuf,
    /// One, or its parts.
    pub(super) files: Arc<[RecordedFile]>,
    pub(super) provenance: Provenance,
    pub(super) checksum: bool,
    pub(super) doubt: Option<RecordingError>,
    pub(super) finished: bool,
    pub(super) bytes: u64,
    pub(super) part: Option<PartOf>,
}

/// What the beginning and the end of a file say.
#[derive(Debug)]
pub(super) struct Opened {
    pub provenance: Provenance,
    pub part: Option<PartOf>,
    pub checksum: bool,
    pub doubt: Option<RecordingError>,
    pub finished: bool,
    pub bytes: u64,
}

impl Opened {
    /// Of a file.
    ///
    /// # Errors
    /// As [`Recording::open_in_doubt`].
    pub fn of(path: &Path) -> Result<Self, RecordingError> {
        let mut records = Records::open(path)?;
        let finished = records.has_footer()?;
        let (offset, pairs) = metadata_of(&mut records)?;
        let foreign = |problem| RecordingError::Foreign { file: path.display().to_string(), problem };
        let holds = checksum::holds(&pairs);
        let doubt = (holds == Some(false))
            .then(|| records.damaged(offset, "rig, scene or configuration do not match their checksum"));
        let part = PartOf::of(&pairs).map_err(foreign)?;
        let provenance = provenance_of(pairs).map_err(foreign)?;
        Ok(Opened { provenance, part, checksum: holds.is_some(), doubt, finished, bytes: records.length })
    }
}

impl Recording {
    /// Opens a recording and reads its provenance. Where there is no file of that name, its parts are opened
    /// as one; a part that is named is opened alone.
    ///
    /// # Errors
    /// Where the file cannot be read, is no recording, ends before its provenance, or its provenance
    /// does not match its checksum. Missing parts are errors while the items are read.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        Self::open_in_doubt(path)?.trusted()
    }

    /// Itself, if its provenance matches its checksum.
    pub(super) fn trusted(mut self) -> Result<Self, RecordingError> {
        self.doubt.take().map_or(Ok(self), Err)
    }

    /// As [`Recording::open`], but a provenance that does not match its checksum is taken as it is:
    /// for those who look at a damaged file or save what is left of it.
    ///
    /// # Errors
    /// As there, but for the checksum.
    pub fn open_in_doubt(path: &Path) -> Result<Self, RecordingError> {
        if path.as_os_str() == STDIN {
            let problem = "it needs random access: save it as a file first".into();
            return Err(RecordingError::Foreign { file: "standard input".into(), problem });
        }
        if path.symlink_metadata().is_err() {
            let parts = parts_of(path);
            if !parts.is_empty() {
                return assemble(path, parts);
            }
        }
        let Opened { provenance, part, checksum, doubt, finished, bytes } = Opened::of(path)?;
        let files = [RecordedFile::whole(path.into(), bytes)].into();
        Ok(Recording { path: path.into(), files, provenance, checksum, doubt, finished, bytes, part })
    }

    /// Rig, scene, configuration, seeds and versions.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// Why the provenance cannot be trusted, where [`Recording::open_in_doubt`] took it as it is.
    pub fn doubt(&self) -> Option<&RecordingError> {
        self.doubt.as_ref()
    }

    /// True if the provenance has a checksum; recordings of former versions have none.
    pub fn has_checksum(&self) -> bool {
        self.checksum
    }

    /// True if the recorder closed the file in order, and all parts of it are there; a crashed one leaves it
    /// without a footer.
    pub fn is_finished(&self) -> bool {
        self.finished
    }

    /// Size of the file, or of all parts, bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The name by which it was opened: a file, or what its parts are named after.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// All items in the order of the file, which is the order in which the recorder got them,
    /// with their log times.
    ///
    /// After an error the iterator goes on behind the damage, at the next good chunk (`vitreo
    /// recover` makes use of that); a caller that needs an unbroken record stops there.
    pub fn items(&self) -> Items {
        self.items_of(&Item::TOPICS)
    }

    /// As [`Recording::items`], of these topics only. The rest is not decoded, which is most of the
    /// work.
    pub fn items_of(&self, topics: &[&'static str]) -> Items {
        Items::open(&self.files, topics, self.provenance.realtime_offset_ns())
    }

    /// Instants of exposure of what is replayed: those of the tracker's frames, or of the
    /// camera-fields of an imported stream. The first that is intact is the recording's start; damage after
    /// it ends them.
    pub fn exposures(&self) -> impl Iterator<Item = Nanos> + use<> {
        let topic = match self.provenance.source {
            Source::Live => "poses",
            Source::Import => "blobs",
        };
        self.items_of(&[topic]).skip_while(Result::is_err).map_while(Result::ok).filter_map(|(_, item)| {
            match item {
                Item::Poses(frame) => Some(frame.instants.exposed),
                Item::Blobs(field) => Some(field.exposed_ns),
                _ => None,
            }
        })
    }

    /// From the first exposure to the last of what is replayed, s; damage ends it.
    pub fn exposed_s(&self) -> f64 {
        let mut exposures = self.exposures();
        let first = exposures.next().unwrap_or(0);
        exposures.fold(first, Nanos::max).saturating_sub(first) as f64 * 1e-9
    }
}

/// Says that states of another hash version cannot be compared.
pub fn states_incomparable(version: u32) -> String {
    format!(
        "states cannot be compared: the recording's state hashes are of version {version}, this build's of \
         version {STATE_HASH_VERSION}"
    )
}

/// The metadata at the file's start, and their place.
fn metadata_of(records: &mut Records) -> Result<(u64, BTreeMap<String, String>), RecordingError> {
    let file = records.file.clone();
    let foreign = |problem: String| RecordingError::Foreign { file: file.clone(), problem };
    loop {
        let next = records.next_record().map_err(|e| match e {
            RecordingError::Truncated { .. } => foreign("ends before its provenance".into()),
            other => other,
        });
        let Some(Outer { offset, opcode, body }) = next? else {
            return Err(foreign("ends before its provenance".into()));
        };
        match opcode {
            op::HEADER | op::METADATA => {}
            _ => return Err(foreign("its provenance is not at the start".into())),
        }
        match parse_record(opcode, &body).map_err(|e| records.damaged(offset, e))? {
            Record::Header(header) if header.profile == PIXELS_PROFILE => {
                return Err(foreign(
                    "a recording of pixels, without poses; vitreo replay, blobs, calibrate and --cameras mcap: read it"
                        .into(),
                ));
            }
            Record::Header(header) if header.profile != PROFILE => {
                return Err(foreign(format!("an MCAP file of profile '{}'", header.profile)));
            }
            Record::Metadata(data) if data.name == METADATA => return Ok((offset, data.metadata)),
            _ => {}
        }
    }
}

fn provenance_of(mut pairs: BTreeMap<String, String>) -> Result<Provenance, String> {
    let mut take = |key: &str| pairs.remove(key).ok_or(format!("its provenance lacks '{key}'"));
    let format = take("format")?;
    if format != FORMAT {
        return Err(format!("its format is '{format}'; this version reads '{FORMAT}'"));
    }
    let source = take("source")?;
    let source = Source::from_name(&source).ok_or(format!("unknown source '{source}'"))?;
    let (rig_json, scene_name) = (take("rig_json")?, take("scene_name")?);
    let scene_toml = take("scene_toml")?;
    let group = |prefix: &str| {
        let members = pairs.iter().filter_map(|(k, v)| Some((k.strip_prefix(prefix)?.into(), v.clone())));
        members.collect()
    };
    let (seeds, config, versions) = (group("seed."), group("config."), group("version."));
    Ok(Provenance { rig_json, scene_name, scene_toml, source, seeds, config, versions })
}

#[cfg(test)]
mod tests {
    use super::super::samples::{any_item, bits};
    use super::super::{Note, NoteKind, Writer};
    use super::*;
    use proptest::prelude::*;
    use std::fs;

    fn provenance() -> Provenance {
        let map = |key: &str, value: &str| BTreeMap::from([(key.to_string(), value.to_string())]);
        Provenance {
            rig_json: "{\"format\": \"vitreo-rig-1\"}".into(),
            scene_name: "peel".into(),
            scene_toml: "[eye]".into(),
            source: Source::Live,
            seeds: map("scene", "7"),
            config: map("source", "pixels"),
            versions: map("vitreo", "0.1.0"),
        }
    }

    fn written(path: &Path, items: &[Item]) {
        write(Writer::create(path, &provenance()).unwrap(), items);
    }

    fn write(mut writer: Writer, items: &[Item]) {
        for (i, item) in items.iter().enumerate() {
            writer.write(1000 + i as u64, item).unwrap();
        }
        writer.finish().unwrap();
    }

    fn note(count: u64) -> Item {
        let text = "x".repeat(100);
        Item::Note(Note { instant_ns: 5, kind: NoteKind::Log, process: None, count, text })
    }

    /// Counts of the notes that can be read before the first problem, and the problem.
    fn notes_of(path: &Path) -> (Vec<u64>, Option<RecordingError>) {
        let mut counts = Vec::new();
        for item in Recording::open(path).unwrap().items() {
            match item {
                Ok((_, Item::Note(note))) => counts.push(note.count),
                Ok((_, other)) => panic!("no note: {other:?}"),
                Err(error) => return (counts, Some(error)),
            }
        }
        (counts, None)
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 32, failure_persistence: None, ..Default::default() })]

        #[test]
        fn a_file_gives_back_what_was_written(items in prop::collection::vec(any_item(), 0..60)) {
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("a.mcap");
            written(&path, &items);
            let recording = Recording::open(&path).unwrap();
            prop_assert!(recording.is_finished());
            prop_assert_eq!(recording.provenance(), &provenance());
            let back: Vec<_> = recording.items().collect::<Result<_, _>>().unwrap();
            prop_assert_eq!(back.len(), items.len());
            for (i, ((time, item), original)) in back.iter().zip(&items).enumerate() {
                prop_assert_eq!(*time, 1000 + i as u64);
                prop_assert_eq!(bits(item), bits(original));
            }
        }

        #[test]
        fn damage_anywhere_is_an_error_or_leaves_true_items(
            cut in any::<prop::sample::Index>(),
            hits in prop::collection::vec((any::<prop::sample::Index>(), 1u8..), 1..4),
            truncate in any::<bool>(),
        ) {
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("a.mcap");
            written(&path, &(0..600).map(note).collect::<Vec<_>>());
            let mut bytes = fs::read(&path).unwrap();
            for (at, xor) in hits {
                let at = at.index(bytes.len());
                bytes[at] ^= xor;
            }
            if truncate {
                bytes.truncate(cut.index(bytes.len()));
            }
            fs::write(&path, &bytes).unwrap();
            if let Ok(recording) = Recording::open(&path) {
                for (_, item) in recording.items().flatten() {
                    prop_assert!(matches!(item, Item::Note(n) if n.count < 600 && n.text.len() == 100));
                }
            }
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400), magic in any::<bool>()) {
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("a.mcap");
            let start: &[u8] = if magic { mcap::MAGIC } else { b"" };
            fs::write(&path, [start, &bytes].concat()).unwrap();
            let error = Recording::open(&path).unwrap_err().to_string();
            prop_assert!(error.contains("a.mcap"), "{}", error);
        }

        #[test]
        fn arbitrary_records_after_a_good_start_never_panic(
            records in prop::collection::vec((0u8..0x12, prop::collection::vec(any::<u8>(), 0..120)), 1..6),
        ) {
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("a.mcap");
            let writer = Writer::create(&path, &provenance()).unwrap();
            let mut bytes = fs::read(&path).unwrap();
            drop(writer);
            for (opcode, body) in records {
                bytes.push(opcode);
                bytes.extend((body.len() as u64).to_le_bytes());
                bytes.extend(body);
            }
            fs::write(&path, &bytes).unwrap();
            let recording = Recording::open(&path).unwrap();
            prop_assert!(recording.items().count() < 100);
        }
    }

    /// A file with one note in each of three chunks, and where the chunks end.
    fn three_chunks(path: &Path) -> (Writer, Vec<u64>) {
        const APART_NS: u64 = 1_000_000_000;
        let mut writer = Writer::create(path, &provenance()).unwrap();
        let ends = (0..3).map(|i| {
            writer.write(i, &note(i)).unwrap();
            writer.flush_aged(i * APART_NS).unwrap();
            writer.flush_aged(i * APART_NS + APART_NS / 2).unwrap();
            fs::metadata(path).unwrap().len()
        });
        let ends = ends.collect();
        (writer, ends)
    }

    #[test]
    fn a_cut_file_is_readable_up_to_the_cut_and_says_so() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.mcap");
        let (writer, ends) = three_chunks(&path);
        drop(writer);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..ends[1] as usize + 20]).unwrap();
        let (counts, problem) = notes_of(&path);
        assert_eq!(counts, [0, 1]);
        assert!(matches!(problem, Some(RecordingError::Truncated { offset, .. }) if offset == ends[1]));
    }

    #[test]
    fn behind_a_damaged_chunk_reading_goes_on() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.mcap");
        let (writer, ends) = three_chunks(&path);
        writer.finish().unwrap();
        let mut bytes = fs::read(&path).unwrap();
        bytes[ends[0] as usize + 80] ^= 0xff;
        fs::write(&path, &bytes).unwrap();
        let items: Vec<_> = Recording::open(&path).unwrap().items().collect();
        assert_eq!(items.len(), 4);
        let missing = items[3].as_ref().unwrap_err().to_string();
        // The note and its copy for viewers.
        assert!(missing.contains("2 of 6 messages"), "{missing}");
        let error = items[1].as_ref().unwrap_err();
        assert!(matches!(error, RecordingError::Damaged { offset, .. } if *offset == ends[0]), "{error}");
        assert!(matches!(&items[2], Ok((2, Item::Note(n))) if n.count == 2));
    }

    #[test]
    fn topics_that_are_not_wanted_are_passed_over() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.mcap");
        let tool = protocol::handles::Tool::Forceps as u32;
        let handle = protocol::handles::HandleState { tool, ..bytemuck::Zeroable::zeroed() };
        written(&path, &[note(1), Item::Handle(handle), note(2)]);
        let recording = Recording::open(&path).unwrap();
        let of =
            |topics: &[&'static str]| recording.items_of(topics).map(|i| i.unwrap().0).collect::<Vec<_>>();
        assert_eq!((of(&["handles"]), of(&["notes"]), of(&[])), (vec![1001], vec![1000, 1002], vec![]));
    }

    #[test]
    fn foreign_files_are_named() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.mcap");
        let missing = Recording::open(&path).unwrap_err().to_string();
        assert!(missing.contains("a.mcap"), "{missing}");
        fs::write(&path, "t_ns,body\n").unwrap();
        assert!(matches!(Recording::open(&path), Err(RecordingError::Foreign { .. })));
        let other = mcap::WriteOptions::new().profile("ros2");
        other.create(fs::File::create(&path).unwrap()).unwrap().finish().unwrap();
        let error = Recording::open(&path).unwrap_err().to_string();
        assert!(error.contains("ros2"), "{error}");
    }
}
