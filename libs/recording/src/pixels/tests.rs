//! Pixels come back to the bit, whole, cut and damaged.

use super::*;
use proptest::prelude::*;
use protocol::fields::FORMAT_YCBCR_422;

fn head() -> PixelsHead {
    PixelsHead {
        rig_json: "{}".into(),
        cameras: vec![0, 2],
        field_hz: 50.0,
        realtime_offset_ns: 77,
        sources: Vec::new(),
    }
}

fn field(number: u64, camera: u32, noise: u8) -> (FieldHeader, Vec<u8>) {
    let header = FieldHeader {
        field: number,
        exposed_ns: 20_000_000 * (number + 1),
        first_line_ns: 20_000_000 * (number + 1) + 5,
        line_period_ns: 64_000,
        camera,
        parity: (number % 2) as u32,
        format: FORMAT_YCBCR_422,
        width: 64,
        height: 48,
        lines: 48,
    };
    let samples = (0..header.bytes()).map(|i| (i as u8).wrapping_mul(noise) ^ (i >> 8) as u8).collect();
    (header, samples)
}

fn written(path: &Path, fields: &[(FieldHeader, Vec<u8>)]) {
    let mut writer = PixelsWriter::on(File::create(path).unwrap(), path, &head()).unwrap();
    fields.iter().for_each(|(header, samples)| writer.write(header, samples).unwrap());
    writer.finish().unwrap();
}

/// A field and its samples.
type Kept = (FieldHeader, Vec<u8>);

/// All fields that can be read, whether the file was cut, and how it ended.
fn read(path: &Path, camera: Option<u32>) -> (Vec<Kept>, bool, Result<(), RecordingError>) {
    let (mut all, mut samples) = (Vec::new(), Vec::new());
    let mut reader = match PixelsReader::open(path, camera) {
        Ok(reader) => reader,
        Err(problem) => return (all, false, Err(problem)),
    };
    loop {
        match reader.next(&mut samples) {
            Ok(Some(header)) => all.push((header, samples.clone())),
            Ok(None) => return (all, reader.is_cut, Ok(())),
            Err(problem) => return (all, reader.is_cut, Err(problem)),
        }
    }
}

/// A file of some chunks: noise does not pack.
fn some(path: &Path) -> Vec<(FieldHeader, Vec<u8>)> {
    let mut random = 1_u64;
    let mut noise = move || {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (random >> 56) as u8
    };
    let fields: Vec<_> = (0..700)
        .map(|k| {
            let (header, mut samples) = field(k / 2, [0, 2][(k % 2) as usize], 3);
            samples.iter_mut().for_each(|s| *s = noise());
            (header, samples)
        })
        .collect();
    written(path, &fields);
    fields
}

#[test]
fn the_message_has_every_field_of_the_header() {
    let names: Vec<&str> = layout_of::<FieldHeader>().fields.iter().map(|field| field.name).collect();
    assert_eq!((names, fields().count()), (FIELDS.to_vec(), FIELDS.len()));
}

#[test]
fn fields_of_all_cameras_or_of_one_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let fields = some(&path);
    let (all, is_cut, ended) = read(&path, None);
    assert!(ended.is_ok() && !is_cut);
    assert!(all == fields);
    let (one, ..) = read(&path, Some(2));
    assert!(one.iter().all(|(header, _)| header.camera == 2) && one.len() == 350);
    assert_eq!(PixelsReader::open(&path, None).unwrap().head, head());
    // Log times are of the wall clock, as in every recording.
    let file = std::fs::read(&path).unwrap();
    let first = mcap::MessageStream::new(&file).unwrap().next().unwrap().unwrap();
    assert_eq!(first.log_time, fields[0].0.read_out_ns() + 77);
    assert_eq!(first.channel.topic, "/camera0/pixels");
}

#[test]
fn a_whole_file_is_whole_also_when_it_is_asked_beyond_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    some(&path);
    let (mut reader, mut samples) = (PixelsReader::open(&path, Some(0)).unwrap(), Vec::new());
    while reader.next(&mut samples).unwrap().is_some() {}
    for _ in 0..20 {
        assert!(reader.next(&mut samples).unwrap().is_none() && !reader.is_cut);
    }
}

#[test]
fn a_cut_file_is_a_readable_beginning() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let fields = some(&path);
    let bytes = std::fs::read(&path).unwrap();
    let mut counts = Vec::new();
    for share in [10, 30, 60, 90] {
        std::fs::write(&path, &bytes[..bytes.len() * share / 100]).unwrap();
        let (all, is_cut, ended) = read(&path, None);
        assert!(ended.is_ok() && is_cut);
        assert!(all == fields[..all.len()]);
        counts.push(all.len());
    }
    assert!(counts[3] > 400 && counts.is_sorted(), "{counts:?}");
}

#[test]
fn what_is_no_recording_of_pixels_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, "YUV4MPEG2 W4 H4\n").unwrap();
    assert!(read(&path, None).2.unwrap_err().to_string().contains("a.mcap: not a vitreo recording"));
    crate::Writer::create(&path, &crate::Provenance::default()).unwrap().finish().unwrap();
    let told = read(&path, None).2.unwrap_err().to_string();
    assert!(
        told.contains("expected a recording of pixels") && told.contains("found a recording of a run"),
        "{told}"
    );
    let mut writer = PixelsWriter::on(File::create(&path).unwrap(), &path, &head()).unwrap();
    let (header, samples) = field(0, 1, 3);
    assert!(writer.write(&header, &samples).unwrap_err().to_string().contains("no camera 1"));
    let (header, samples) = field(0, 0, 3);
    assert!(writer.write(&header, &samples[1..]).unwrap_err().to_string().contains("has 6143"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// One changed byte is noticed, or changes nothing that is read.
    #[test]
    fn a_changed_byte_is_noticed(at in any::<prop::sample::Index>(), to in any::<u8>()) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let fields: Vec<_> = (0..4).map(|k| field(k, 0, 5)).collect();
        written(&path, &fields);
        let mut bytes = std::fs::read(&path).unwrap();
        let at = at.index(bytes.len());
        bytes[at] = to;
        std::fs::write(&path, &bytes).unwrap();
        let (all, _, ended) = read(&path, None);
        prop_assert!(ended.is_err() || all == fields || all.is_empty());
    }
}

#[test]
fn what_cameras_were_set_to_is_kept_also_in_a_file_that_was_cut() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let sources = vec!["v4l2:/dev/video0?exposure_us=2000".to_owned(), "y4m:a,b".to_owned()];
    let head = PixelsHead { sources, ..head() };
    let mut writer = PixelsWriter::on(File::create(&path).unwrap(), &path, &head).unwrap();
    for (number, settings) in [(0, "exposure 2000 µs"), (1, "exposure 2000 µs"), (2, "gain 4")] {
        writer.write_settings(2, settings).unwrap();
        let (header, samples) = field(number, 2, 3);
        writer.write(&header, &samples).unwrap();
    }
    writer.finish().unwrap();
    let settings = |path: &Path| {
        let (mut reader, mut samples) = (PixelsReader::open(path, None).unwrap(), Vec::new());
        assert_eq!(reader.head, head);
        while reader.next(&mut samples).unwrap().is_some() {}
        reader.settings
    };
    assert_eq!(settings(&path), BTreeMap::from([(2, vec!["exposure 2000 µs".into(), "gain 4".into()])]));
    let whole = std::fs::read(&path).unwrap();
    let last = whole.windows(6).rposition(|w| w == b"gain 4").unwrap();
    std::fs::write(&path, &whole[..last]).unwrap();
    assert_eq!(settings(&path), BTreeMap::from([(2, vec!["exposure 2000 µs".into()])]));
}
