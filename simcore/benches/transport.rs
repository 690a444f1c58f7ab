//! What it costs to hand a message on: built aside and copied in and out, or built and read where it lies in
//! shared memory; blobs that are held back on the way; and the scene block of a step:
//! `cargo bench -p simcore --bench transport`.
//! Both ways take turns, and the median of many messages counts.

use bytemuck::Zeroable;
use ipc::clock::now;
use ipc::outbox::{Outbox, Placed};
use ipc::{Instance, Queue, Receiver, Sender};
use protocol::blobs::BlobField;
use protocol::events::{Event, EventKind};
use protocol::frames::FrameRecord;
use protocol::handles::{HandleState, PedalState, Tool};
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use protocol::scene::{SceneHeader, Section};
use protocol::steps::StepRecord;
use scene::SceneFile;
use simcore::scene_block::{SceneWriter, bytes_needed};
use simcore::world::{World, no_clock};
use std::collections::VecDeque;
use std::fmt::Debug;
use std::hint::black_box;
use surgeon::rehearsal::Rehearsal;

/// Messages each way.
const MESSAGES: usize = 20_000;
/// Fields that wait at a time: a read-out of three cameras.
const HELD: usize = 3;
/// Steps of a scene that are written.
const STEPS: u64 = 600;

/// A sender and a receiver in one process: no switch between processes is measured.
struct Pair<M: Message> {
    sender: Sender<M>,
    receiver: Receiver<M>,
}

impl<M: Message + Debug> Pair<M> {
    fn copied(&mut self, build: fn(&mut M, u64), n: u64) {
        let mut message = M::zeroed();
        build(&mut message, n);
        self.sender.send(&message).expect("sent");
        let received = self.receiver.next_valid().expect("the channel works").expect("a message");
        black_box(&received);
    }

    fn in_place(&mut self, build: fn(&mut M, u64), n: u64) {
        let sent = self.sender.fill(|message| {
            *message = M::zeroed();
            build(message, n);
        });
        sent.expect("sent");
        let sample = self.receiver.next_sample().expect("the channel works").expect("a message");
        black_box(&*sample);
    }
}

fn took(work: impl FnOnce()) -> u64 {
    let begin = now();
    work();
    now() - begin
}

fn median_us(mut times: Vec<u64>) -> f64 {
    times.sort_unstable();
    times[times.len() / 2] as f64 * 1e-3
}

fn message<M: Message + Debug>(instance: &Instance, name: &str, build: fn(&mut M, u64)) {
    let (sender, receiver) = (instance.sender(), instance.receiver(Queue::InOrder));
    let mut pair = Pair::<M> { sender: sender.expect("sender"), receiver: receiver.expect("receiver") };
    let (mut copied, mut in_place) = (Vec::new(), Vec::new());
    for n in 1..=MESSAGES as u64 {
        copied.push(took(|| pair.copied(build, n)));
        in_place.push(took(|| pair.in_place(build, n)));
    }
    row(name, 2 * size_of::<M>(), copied, in_place);
}

fn row(name: &str, bytes: usize, copied: Vec<u64>, in_place: Vec<u64>) {
    let (copied, in_place) = (median_us(copied), median_us(in_place));
    println!("{name:<22}{bytes:>16}{copied:>14.2}{:>16}{in_place:>14.2}", 0);
}

/// Fields of blobs that wait until they are due, in turns: built aside, copied into a queue, out of it and into
/// the channel; or built where they are sent from, and queued by their place.
fn held_back(instance: &Instance) {
    let mut sender = Outbox::sender(instance).expect("sender");
    let mut receiver: Receiver<BlobField> = instance.receiver(Queue::InOrder).expect("receiver");
    let (mut queue, mut outbox) = (VecDeque::with_capacity(HELD), Outbox::default());
    let (mut copied, mut in_place) = (Vec::new(), Vec::new());
    for round in 1..=(MESSAGES / HELD) as u64 {
        let numbers = || (0..HELD as u64).map(|n| round * HELD as u64 + n);
        let spent = took(|| {
            for n in numbers() {
                let mut field = BlobField::zeroed();
                build_blobs(&mut field, n);
                queue.push_back((n, field));
            }
            while let Some((_, field)) = queue.pop_front() {
                sender.send(&field).expect("sent");
                black_box(&receiver.next_valid().expect("the channel works").expect("a field"));
            }
        });
        copied.push(spent / HELD as u64);
        let spent = took(|| {
            for n in numbers() {
                let placed = outbox.put(&mut sender, |field| {
                    *field = BlobField::zeroed();
                    build_blobs(field, n);
                    Some(n)
                });
                assert_eq!(placed.expect("lent"), Placed::Waits);
            }
            while let Some(lease) = outbox.take(u64::MAX) {
                sender.send_lease(lease).expect("sent");
                black_box(&*receiver.next_sample().expect("the channel works").expect("a field"));
            }
            outbox.clear();
        });
        in_place.push(spent / HELD as u64);
    }
    // Into the queue, out of it, into the channel and out of it.
    row("blobs, held back", 4 * size_of::<BlobField>(), copied, in_place);
}

fn build_blobs(field: &mut BlobField, n: u64) {
    (field.field, field.exposed_ns, field.read_out_ns, field.blobs_out_ns) = (n, n, n, n);
}

/// Bytes of a scene block in all, and of those that are kept and copied: triangles, places at the start, haze
/// and text.
fn bytes_of(header: &SceneHeader) -> [usize; 2] {
    use protocol::scene::{SceneBody, SceneBrick, SceneHome, SceneMark, SceneNode, SceneTriangle};
    let of = |section: Section, size: usize| section.count as usize * size;
    let kept = of(header.triangles, size_of::<SceneTriangle>())
        + of(header.homes, size_of::<SceneHome>())
        + of(header.bricks, size_of::<SceneBrick>())
        + of(header.text, 1);
    let new = of(header.nodes, size_of::<SceneNode>())
        + of(header.marks, size_of::<SceneMark>())
        + of(header.bodies, size_of::<SceneBody>())
        + of(header.doses, size_of::<f32>());
    [kept + new, kept]
}

fn scene_block(name: &str) {
    let scene = SceneFile::load(name).expect("the shipped scenes are tested");
    let (rehearsal, mut world) = (Rehearsal::shipped(&scene), World::new(&scene).expect("a world"));
    let mut writer = SceneWriter::new(&world);
    let retina = world.retina().map(|r| &r.body.mesh);
    let vitreous = world.vitreous().map(|(v, _)| v);
    let needed = bytes_needed(world.sheet(), world.adhesion().is_some(), vitreous, retina);
    let mut block = vec![0u128; needed.div_ceil(size_of::<u128>())];
    let (mut times, mut bytes) = (Vec::new(), [0; 2]);
    for field in 0..STEPS {
        world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        let payload = bytemuck::cast_slice_mut(&mut block);
        times.push(took(|| bytes = bytes_of(&writer.write(&world, Zeroable::zeroed(), 0, payload))));
    }
    println!(
        "{:<22}{:>16}{:>14}{:>16}{:>14.2}",
        format!("scene {name}"),
        bytes[0],
        "-",
        bytes[1],
        median_us(times)
    );
}

fn main() {
    let name = format!("bench{}", std::process::id());
    let instance = Instance::own(&name).expect("an instance");
    println!("{:<22}{:>16}{:>14}{:>16}{:>14}", "message", "bytes copied", "µs", "in place, bytes", "µs");
    message::<TrackerFrame>(&instance, "poses", |frame, n| {
        (frame.frame, frame.field, frame.instants.exposed) = (n, n, n);
        frame.bodies.iter_mut().for_each(|body| {
            body.world_from_body = protocol::geometry::Pose::IDENTITY;
            body.covariance.iter_mut().for_each(|c| *c = 1e-6);
        });
    });
    message::<BlobField>(&instance, "blobs", build_blobs);
    held_back(&instance);
    message::<HandleState>(&instance, "handles", |handle, n| {
        (handle.seq, handle.field, handle.tool) = (n, n, Tool::Forceps as u32);
    });
    message::<PedalState>(&instance, "pedal", |pedal, n| (pedal.seq, pedal.instant_ns) = (n, n));
    message::<StepRecord>(&instance, "steps", |step, n| (step.step, step.instants.exposed) = (n, n));
    message::<Event>(&instance, "events", |event, n| {
        (event.seq, event.field, event.kind) = (n, n, EventKind::TissueTorn as u32);
    });
    message::<FrameRecord>(&instance, "frames", |frame, n| (frame.frame, frame.field) = (n, n));
    ["peel", "erm", "vitrectomy", "lift"].into_iter().for_each(scene_block);
}
