//! Streams of messages into the cores of the processes, and scenes that are simulated.
//!
//! An input is a list of patches, twelve bytes each: which message of a real stream, which number of
//! it, and the number's new bytes. A message that does not pass validation is left out, as a receiver
//! does.

use super::{Kind, Target};
use crate::corpus;
use crate::fields::{Number, numbers};
use bytemuck::Zeroable;
use fpga_model::camera_extractor::CameraExtractor;
use protocol::blobs::BlobField;
use protocol::fields::{FieldHeader, FieldPicture};
use protocol::handles::{HandleState, PedalState};
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use protocol::steps::StepInput;
use protocol::wire::layout_of;
use rig::Rig;
use scene::SceneFile;
use simcore::world::{World, no_clock};
use std::cell::RefCell;
use std::hint::black_box;
use tracker::assembler::FrameAssembler;
use tracker::tracker::Tracker;

/// Bytes of a patch.
const PATCH: usize = 12;
/// Camera-fields of the real stream into the tracker.
const FIELDS: usize = 18;
/// Tracker frames of the real stream into the simulation.
const FRAMES: usize = 3;
/// Most squares of a membrane's side in a scene that is simulated here: larger ones are a question of
/// time, not of what they hold.
const MAX_SQUARES: u32 = 40;

/// Targets of the cores.
pub fn targets() -> Vec<Target> {
    let target =
        |name, run, seeds, longest| Target { name, kind: Kind::Scene, run, seeds, layout: None, longest };
    vec![
        target("scene-world", scene_world, || corpus::shipped(&["assets/scenes"], "toml"), 8 << 10),
        target("tracker-stream", tracker_stream, patches, 40 * PATCH),
        target("world-stream", world_stream, patches, 40 * PATCH),
        target("extractor", extractor, || vec![a_field()], HEADER + PIXELS),
    ]
}

/// No patch, one, and one of every number.
fn patches() -> Vec<Vec<u8>> {
    let patch =
        |i: u16, value: f64| [&i.to_le_bytes()[..], &(i * 7).to_le_bytes(), &value.to_le_bytes()].concat();
    vec![Vec::new(), patch(3, f64::NAN), (0..20).flat_map(|i| patch(i, 1e300)).collect(), patch(2, 4.0)]
}

/// A block with the patches that are meant for message `index` of `count`; `None` if it is no valid
/// message then.
fn patched<M: Message>(block: &M, index: usize, count: usize, numbers: &[Number], bytes: &[u8]) -> Option<M> {
    let mut block = *block;
    for patch in bytes.as_chunks::<PATCH>().0 {
        let [a, b, c, d, value @ ..] = patch;
        if usize::from(u16::from_le_bytes([*a, *b])) % count == index {
            let number = numbers[usize::from(u16::from_le_bytes([*c, *d])) % numbers.len()];
            number.set(bytemuck::bytes_of_mut(&mut block), value);
        }
    }
    block.validate().is_ok().then_some(block)
}

struct TrackerBench {
    rig: Rig,
    tracker: Tracker,
    stream: Vec<BlobField>,
    numbers: Vec<Number>,
}

thread_local! {
    static TRACKER: RefCell<TrackerBench> = RefCell::new({
        let rig = Rig::load_or_shipped(None).expect("the shipped rig");
        let tracker = Tracker::new(&rig);
        let numbers = numbers(layout_of::<BlobField>());
        TrackerBench { tracker, rig, stream: corpus::camera_fields(FIELDS), numbers }
    });
    static WORLD: RefCell<(World, Vec<TrackerFrame>)> = RefCell::new({
        let world = World::new(&SceneFile::load("peel").expect("a shipped scene")).expect("a world");
        (world, corpus::tracker_frames(FRAMES))
    });
    static EXTRACTOR: RefCell<(CameraExtractor, BlobField)> = RefCell::new({
        let mut rig = Rig::load_or_shipped(None).expect("the shipped rig");
        (rig.cameras[0].width, rig.cameras[0].height) = (WIDTH as u32, 2 * LINES as u32);
        let extractor = CameraExtractor::new(&rig, &rig.cameras()[0]).expect("an extractor");
        (extractor, BlobField::zeroed())
    });
}

fn tracker_stream(bytes: &[u8]) {
    TRACKER.with_borrow_mut(|TrackerBench { rig, tracker, stream, numbers }| {
        tracker.reset();
        let mut assembler = FrameAssembler::new(rig);
        for (i, field) in stream.iter().enumerate() {
            let Some(field) = patched(field, i, FIELDS, numbers, bytes) else { continue };
            assembler.add(&field, stream[i].blobs_out_ns, |used, closed| {
                let frame = tracker.track(used, &closed.reference);
                frame.validate().expect("a tracker's frame is valid whatever it is given");
            });
        }
    });
}

fn world_stream(bytes: &[u8]) {
    let handle = HandleState { tool: 1, jaw_rad: 0.4, ..HandleState::zeroed() };
    let of = [
        numbers(layout_of::<TrackerFrame>()),
        numbers(layout_of::<HandleState>()),
        numbers(layout_of::<PedalState>()),
    ];
    WORLD.with_borrow_mut(|(world, frames)| {
        world.reset();
        let count = 3 * FRAMES;
        for (i, frame) in frames.iter().enumerate() {
            let handles: Vec<_> = patched(&handle, 3 * i + 1, count, &of[1], bytes).into_iter().collect();
            let pedals: Vec<_> =
                patched(&PedalState::zeroed(), 3 * i + 2, count, &of[2], bytes).into_iter().collect();
            let Some(frame) = patched(frame, 3 * i, count, &of[0], bytes) else { continue };
            world.step(&StepInput { frame: &frame, handles: &handles, pedals: &pedals }, &mut no_clock);
        }
        let places = world.state().membrane.position_mm.iter().flatten();
        assert!(places.into_iter().all(|c| c.is_finite()), "the membrane is somewhere");
    });
}

/// A scene that is read is simulated, or refused with a reason.
fn scene_world(bytes: &[u8]) {
    let Ok(scene) = SceneFile::parse(&String::from_utf8_lossy(bytes), "f") else { return };
    let squares = scene.membrane.as_ref().map_or(0, |m| m.squares[0].max(m.squares[1]));
    if squares > MAX_SQUARES || scene.contact.resolution > 64 {
        return;
    }
    if let Ok(mut world) = World::new(&scene) {
        let frame = corpus::resting_frame(1);
        world.step(&StepInput { frame: &frame, handles: &[], pedals: &[] }, &mut no_clock);
        black_box(world.state_hash());
    }
}

const WIDTH: usize = 64;
const LINES: usize = 24;
const HEADER: usize = size_of::<FieldHeader>();
const PIXELS: usize = 2 * WIDTH * LINES;

/// A field with two discs.
fn a_field() -> Vec<u8> {
    let mut header = FieldHeader::zeroed();
    (header.exposed_ns, header.first_line_ns, header.line_period_ns) = (47_000_000, 49_000_000, 64_000);
    (header.format, header.width, header.height, header.lines) =
        (1, WIDTH as u32, LINES as u32, LINES as u32);
    let mut pixels = vec![30; WIDTH * LINES];
    pixels.resize(PIXELS, 128);
    for (x, y) in (0..WIDTH * LINES).map(|i| (i % WIDTH, i / WIDTH)) {
        let near = |a: usize, b: usize| x.abs_diff(a).pow(2) + 4 * y.abs_diff(b).pow(2) < 40;
        if near(20, 8) || near(45, 15) {
            pixels[y * WIDTH + x] = 170;
        }
    }
    [bytemuck::bytes_of(&header), &pixels].concat()
}

fn extractor(bytes: &[u8]) {
    let Some((head, payload)) = bytes.split_at_checked(HEADER) else { return };
    let header: FieldHeader = bytemuck::pod_read_unaligned(head);
    EXTRACTOR.with_borrow_mut(|(extractor, out)| {
        if header.validate().is_err() || !extractor.takes(&header) {
            return;
        }
        if let Some(picture) = FieldPicture::in_payload(&header, payload) {
            extractor.extract(&header, &picture, out);
            out.validate().expect("an extractor's field is valid whatever it is given");
        }
    });
}
