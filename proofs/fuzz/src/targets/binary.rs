//! Readers of files that are no text: recordings, journals, checkpoints, meshes, pictures, clips, the
//! store of results.

use super::{Kind, Target};
use crate::corpus::{self, Scratch};
use calibration::charuco::CharucoBoard;
use calibration::grey_image::GreyImage;
use cameras::stream::{Expected, PictureStream, is_black};
use fpga_model::input::Picture;
use fpga_model::input::still;
use fpga_model::input::y4m::Clip;
use ipc::trace::json::FieldTrace;
use ipc::trace::part::TracePart;
use ipc::trace::{About, Trace, TraceArgs};
use protocol::blobs::BlobField;
use protocol::fields::{FieldHeader, FieldPicture, PixelFormat};
use protocol::health::Process;
use protocol::journal;
use protocol::phases::Phase;
use recording::{PixelsHead, PixelsReader, PixelsWriter, Recording};
use renderer::tools::TOOLS;
use results::Store;
use results::store::Filter;
use rig::Rig;
use scene::SceneFile;
use simcore::world::World;
use std::cell::RefCell;
use std::hint::black_box;
use std::io::Cursor;
use std::path::Path;
use std::time::Duration;
use tracker::assembler::FrameAssembler;
use tracker::tracker::Tracker;

/// Camera-fields that a tracker has seen before its checkpoint.
const TRACKED: usize = 60;

/// Targets of all readers of such files.
pub fn targets() -> Vec<Target> {
    let target =
        |name, run, seeds, longest| Target { name, kind: Kind::Recording, run, seeds, layout: None, longest };
    vec![
        target("recording", recording, corpus::recordings, 160 << 10),
        target("pixels", pixels, pixel_recordings, 32 << 10),
        target("journal", journal, corpus::journals, 64 << 10),
        target("state", checkpoint, checkpoints, 512 << 10),
        target("tracker-state", tracker_checkpoint, tracker_checkpoints, 256 << 10),
        target("mesh-glb", mesh, || corpus::shipped(&["assets/instruments"], "glb"), 32 << 10),
        target("fundus", fundus, corpus::photographs, 16 << 10),
        target("grey-picture", |b| drop(black_box(GreyImage::decode(b, "f"))), corpus::pictures, 16 << 10),
        target("charuco", charuco, corpus::charuco_pictures, 16 << 10),
        target("still", still_picture, corpus::pictures, 16 << 10),
        target("clip-y4m", clip, clips, 4 << 10),
        target("live-pictures", live_pictures, live_streams, 4 << 10),
        target("results-store", store, corpus::stores, 128 << 10),
        target("trace-part", trace_part, trace_parts, 8 << 10),
    ]
}

thread_local! {
    static FILE: Scratch = Scratch::new();
    static WORLD: RefCell<World> = RefCell::new(peel());
    static TRACKER: RefCell<(Rig, Tracker, Vec<BlobField>)> = RefCell::new({
        let (tracker, after) = tracked();
        (Rig::load_or_shipped(None).expect("the shipped rig"), tracker, after)
    });
}

fn peel() -> World {
    World::new(&SceneFile::load("peel").expect("a shipped scene")).expect("a world")
}

fn recording(bytes: &[u8]) {
    FILE.with(|file| {
        let Ok(recording) = Recording::open(file.with(bytes)) else { return };
        black_box((recording.provenance(), recording.is_finished()));
        for item in recording.items().take(100_000).flatten() {
            let (_, item) = item;
            black_box(item.encoded().len());
        }
        let Ok(index) = recording.chunk_index() else { return };
        black_box(recording.matches_checksum().is_ok_and(|matches| matches));
        black_box(recording.checkpoint_heads(&index).map_or(0, |heads| heads.len()));
        for chunk in index.holding("checkpoints").take(1000) {
            let read = recording.items_of_chunk(&index, chunk, &["checkpoints"]);
            black_box(read.map_or(0, |items| items.len()));
        }
    });
}

fn pixels(bytes: &[u8]) {
    FILE.with(|file| {
        let Ok(mut reader) = PixelsReader::open(file.with(bytes), None) else { return };
        let mut samples = Vec::new();
        while let Ok(Some(header)) = reader.next(&mut samples) {
            assert_eq!(samples.len(), header.bytes());
            // Planes of the largest sensors would take the time of a hundred inputs.
            if header.width * header.height <= 1 << 16 {
                let mut planes = FieldPicture::of_size([header.width, header.height].map(|n| n as usize));
                black_box(fpga_model::pixels::decode(&header, &samples, &mut planes));
            }
        }
    });
}

/// Two fields of one camera, in planes and behind a mosaic.
fn pixel_recordings() -> Vec<Vec<u8>> {
    let head = PixelsHead {
        rig_json: "{}".into(),
        cameras: vec![0],
        field_hz: 50.0,
        realtime_offset_ns: 7,
        sources: Vec::new(),
    };
    let made = |format: PixelFormat| {
        let file = tempfile::NamedTempFile::new().expect("a file");
        let target = file.reopen().expect("a file");
        let mut writer = PixelsWriter::on(target, file.path(), &head).expect("a recording");
        for field in 0..2 {
            let (width, height, lines, format) = (32, 16, 16, format as u32);
            let [exposed_ns, first_line_ns, line_period_ns] = [1_000, 2_000, 64];
            let (camera, parity) = (0, (field % 2) as u32);
            let header = FieldHeader {
                field,
                exposed_ns,
                first_line_ns,
                line_period_ns,
                camera,
                parity,
                format,
                width,
                height,
                lines,
            };
            let samples: Vec<u8> = (0..header.bytes()).map(|i| (i * 7) as u8).collect();
            writer.write(&header, &samples).expect("a field");
        }
        writer.finish().expect("a recording");
        std::fs::read(file.path()).expect("bytes")
    };
    vec![made(PixelFormat::Yuyv), made(PixelFormat::BayerRg8)]
}

fn journal(bytes: &[u8]) {
    let Ok(mut reader) = journal::Reader::new(bytes) else { return };
    let mut history = simcore::resume::InputHistory::default();
    while let Ok(Some(entry)) = reader.next_entry() {
        history.note(entry);
    }
    black_box(history.waiting().is_some());
}

fn checkpoints() -> Vec<Vec<u8>> {
    let mut bytes = Vec::new();
    peel().save(&mut bytes).expect("a checkpoint");
    vec![bytes]
}

/// A checkpoint that is taken must be one that the world goes on from.
fn checkpoint(bytes: &[u8]) {
    WORLD.with_borrow_mut(|world| {
        if world.restore(bytes).is_ok() {
            let frame = corpus::resting_frame(1);
            let input = protocol::steps::StepInput { frame: &frame, handles: &[], pedals: &[] };
            black_box(world.step(&input, &mut simcore::world::no_clock));
        }
    });
}

/// The shipped rig's tracker after some camera-fields, and the fields after those.
fn tracked() -> (Tracker, Vec<BlobField>) {
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    let (mut tracker, mut fields) = (Tracker::new(&rig), corpus::camera_fields(TRACKED + 12));
    let after = fields.split_off(TRACKED);
    track(&mut tracker, &rig, &fields);
    (tracker, after)
}

fn track(tracker: &mut Tracker, rig: &Rig, fields: &[BlobField]) {
    let mut assembler = FrameAssembler::new(rig);
    for field in fields {
        assembler.add(field, field.blobs_out_ns, |used, closed| {
            black_box(tracker.track(used, &closed.reference));
        });
    }
}

fn tracker_checkpoints() -> Vec<Vec<u8>> {
    let mut bytes = Vec::new();
    tracked().0.save(&mut bytes).expect("a checkpoint");
    vec![bytes]
}

/// A checkpoint that is taken must be one that the tracker goes on from.
fn tracker_checkpoint(bytes: &[u8]) {
    TRACKER.with_borrow_mut(|(rig, tracker, after)| {
        if tracker.restore(bytes).is_ok() {
            track(tracker, rig, after);
        }
    });
}

fn mesh(bytes: &[u8]) {
    for tool in TOOLS {
        if let Ok(model) = renderer::tools::load(tool, "f", bytes) {
            black_box(model.parts.len());
        }
    }
}

fn fundus(bytes: &[u8]) {
    drop(black_box(renderer::assets::decode("f", bytes)));
}

/// A ChArUco board in whatever is a picture, no corner of it twice.
fn charuco(bytes: &[u8]) {
    thread_local!(static BOARD: CharucoBoard = CharucoBoard::parse("5x4,10,8,DICT_4X4_50").expect("a board"));
    // Larger ones take longer, not other ways.
    let Ok(picture) = GreyImage::decode(bytes, "f") else { return };
    if picture.width.max(picture.height) > 200 {
        return;
    }
    BOARD.with(|board| {
        let found = board.find_any(&picture).unwrap_or_default();
        let mut ids: Vec<usize> = found.iter().map(|s| board.id_at(&s.point)).collect();
        ids.dedup();
        assert!(ids.len() == found.len() && ids.is_sorted() && ids.iter().all(|id| *id < 12));
        assert!(found.iter().all(|s| picture.holds(s.pixel, 0.0)));
    });
}

fn still_picture(bytes: &[u8]) {
    let mut picture = Picture::default();
    for levels in [None, Some(still::Levels { black: 10, white: 2000 })] {
        if still::decode(Cursor::new(bytes), levels, &mut picture).is_ok() {
            assert_eq!(picture.luma.len(), picture.width * picture.height);
            assert_eq!(picture.red.len(), picture.chroma_width() * picture.height);
        }
    }
}

fn clips() -> Vec<Vec<u8>> {
    let clip = |head: &str, bytes: usize| [head.as_bytes(), b"\nFRAME\n", &vec![77; bytes]].concat();
    vec![
        clip("YUV4MPEG2 W8 H4 F50:1 It C420jpeg", 48),
        clip("YUV4MPEG2 W4 H2 F25:1 Ip C444alpha XCOLORRANGE=FULL", 32),
        clip("YUV4MPEG2 W4 H3 Ib A1:1 C411", 18),
        clip("YUV4MPEG2 W3 H3 Cmono", 9),
    ]
}

fn clip(bytes: &[u8]) {
    let Ok(mut clip) = Clip::open(bytes, "f") else { return };
    let mut picture = Picture::default();
    while let Ok(true) = clip.read(&mut picture) {
        assert_eq!(picture.blue.len(), picture.chroma_width() * picture.height);
    }
}

/// Of a camera with frames of 8 × 4 px: one field, another header in the middle, an interlaced frame.
fn live_streams() -> Vec<Vec<u8>> {
    let field = [&b"YUV4MPEG2 W8 H2 F50:1 Ip C422\nFRAME\n"[..], &[77; 32]].concat();
    let frame = [&b"YUV4MPEG2 W8 H4 F25:1 It C420jpeg\nFRAME\n"[..], &[16; 48]].concat();
    vec![field.clone(), frame.clone(), [field.clone(), frame, field].concat()]
}

fn live_pictures(bytes: &[u8]) {
    let expected =
        Expected { frame_px: [8, 4], scan: rig::sensor::Scan::Interlaced, field_hz: 50.0, has_parity: false };
    let Ok(mut stream) = PictureStream::open(bytes, expected) else { return };
    let mut picture = Picture::default();
    while let Ok(true) = stream.read(&mut picture) {
        let fields = stream.interlace.parities().len();
        assert_eq!([picture.width, picture.height], [8, 2 * fields]);
        black_box(is_black(&picture));
    }
}

fn store(bytes: &[u8]) {
    FILE.with(|file| {
        let path = file.with(bytes);
        if let Ok(store) = Store::open_with(path, Duration::ZERO) {
            drop(black_box(store.attempts(&Filter::default())));
            drop(black_box(store.trainees()));
        }
    });
}

fn trace_parts() -> Vec<Vec<u8>> {
    let part = |process: Process| {
        let args = TraceArgs { trace_spans: Some(30) };
        let mut trace = Trace::start(process, args, Path::new("/nowhere"));
        for (i, &phase) in (0..).zip(Phase::ALL.iter().filter(|p| p.process() == process)) {
            (0..3).for_each(|field| trace.note(phase, About::field(field), [field * 900 + i, field * 1000]));
        }
        trace.part().expect("it traces").to_bytes()
    };
    Process::ALL.into_iter().map(part).collect()
}

/// What is taken for a part can be written as a trace, which is JSON with a slice for each known span.
fn trace_part(bytes: &[u8]) {
    let Ok(part) = TracePart::parse(bytes) else { return };
    assert_eq!(TracePart::parse(&part.to_bytes()).expect("it was whole"), part);
    let trace = FieldTrace { parts: vec![part], seconds: 1.0, ..FieldTrace::default() };
    let mut json = Vec::new();
    let figures = trace.write(&mut json).expect("memory takes everything");
    let json: serde_json::Value = serde_json::from_slice(&json).expect("valid JSON");
    let slices =
        json["traceEvents"].as_array().map_or(0, |events| events.iter().filter(|e| e["ph"] == "X").count());
    assert_eq!(slices, figures.spans);
}
