//! A publisher of the same user that sends nonsense on every channel: nobody dies of it.

use fuzz::fields::{self, Number};
use fuzz::random::Random;
use fuzz::targets;
use ipc::{BlockSender, Instance, Sender, wait};
use protocol::blobs::BlobField;
use protocol::checkpoints::TrackerCheckpointHeader;
use protocol::control::{Answer, Request};
use protocol::events::Event;
use protocol::fields::FieldHeader;
use protocol::frames::{FrameRecord, PictureHeader};
use protocol::handles::{HandleState, PedalState};
use protocol::health::{Health, Process, STATE_RUNNING};
use protocol::inputs::{Hint, Input, InputEvent};
use protocol::limits::MAX_WAIT_MS;
use protocol::matches::MatchFrame;
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use protocol::scene::SceneHeader;
use protocol::steps::{CheckpointHeader, StepRecord};
use protocol::wire::layout_of;
use std::fmt::Debug;
use vitreo_tests::{Observer, Running, instance_name, json, next};

/// Blocks of each message in a round.
const BURST: usize = 4;
/// Payload of a block that has one, bytes.
const PAYLOAD: usize = 4096;

/// Makes nonsense of one message: noise, only NaN, or a real block with some numbers changed.
struct Nonsense {
    seeds: Vec<Vec<u8>>,
    numbers: Vec<Number>,
}

impl Nonsense {
    fn of<M: Message>() -> Self {
        let layout = layout_of::<M>();
        let target = targets::all().into_iter().find(|t| t.layout.is_some_and(|l| l.name == layout.name));
        Nonsense {
            seeds: (target.expect("a target of every message").seeds)(),
            numbers: fields::numbers(layout),
        }
    }

    fn block<M: Message>(&self, random: &mut Random) -> M {
        let mut block = M::zeroed();
        let bytes = bytemuck::bytes_of_mut(&mut block);
        match random.below(4) {
            0 => bytes.iter_mut().for_each(|b| *b = random.bits() as u8),
            1 => bytes.fill(0xff),
            _ => {
                bytes.copy_from_slice(&self.seeds[random.below(self.seeds.len())]);
                fields::vary(bytes, &self.numbers, random);
            }
        }
        block
    }
}

/// Sends nonsense on one channel.
type Spray<'a> = Box<dyn FnMut(&mut Random) + 'a>;

fn plain<'a, M: Message + Debug>(instance: &Instance, meant: fn(&mut M)) -> Spray<'a> {
    let mut sender: Sender<M> = instance.sender().expect("a sender beside the real one");
    let nonsense = Nonsense::of::<M>();
    Box::new(move |random| {
        for _ in 0..BURST {
            let mut block = nonsense.block(random);
            meant(&mut block);
            sender.send(&block).expect("sent");
        }
    })
}

fn with_payload<'a, H: Message + Debug>(instance: &Instance) -> Spray<'a> {
    let mut sender: BlockSender<H> = instance.block_sender(PAYLOAD).expect("a sender beside the real one");
    let nonsense = Nonsense::of::<H>();
    Box::new(move |random| {
        for _ in 0..BURST {
            let (header, length) = (nonsense.block(random), random.below(PAYLOAD));
            let fill = |payload: &mut [u8]| {
                payload.iter_mut().for_each(|b| *b = random.bits() as u8);
                header
            };
            sender.send(length, fill).expect("sent");
        }
    })
}

/// A request that is obeyed is no nonsense: whoever may send it may end the run.
fn no_command(request: &mut Request) {
    request.command |= 1 << 20;
}

/// Neither is a record of a step that says of what it was made and lies about what came of it: verification
/// must call that a difference. This one was made of something that is not there.
fn no_record(step: &mut StepRecord) {
    step.inputs_hash |= 1;
}

/// Neither is a key or a button of the pedal: who may press those may pause the run, and then it does not
/// end by itself.
fn no_button(pedal: &mut PedalState) {
    pedal.buttons = 0;
}

fn no_key(event: &mut InputEvent) {
    if matches!(event.input(), Some(Input::Press(_))) {
        event.code |= 1 << 20;
    }
}

/// One on every channel.
fn all_channels<'a>(instance: &Instance) -> Vec<Spray<'a>> {
    vec![
        with_payload::<FieldHeader>(instance),
        plain::<BlobField>(instance, |_| {}),
        plain::<HandleState>(instance, |_| {}),
        plain::<PedalState>(instance, no_button),
        plain::<TrackerFrame>(instance, |_| {}),
        plain::<MatchFrame>(instance, |_| {}),
        with_payload::<SceneHeader>(instance),
        plain::<StepRecord>(instance, no_record),
        with_payload::<CheckpointHeader>(instance),
        with_payload::<TrackerCheckpointHeader>(instance),
        plain::<Event>(instance, |_| {}),
        plain::<FrameRecord>(instance, |_| {}),
        with_payload::<PictureHeader>(instance),
        plain::<Health>(instance, |_| {}),
        plain::<Request>(instance, no_command),
        plain::<Answer>(instance, |_| {}),
        plain::<InputEvent>(instance, no_key),
        plain::<Hint>(instance, |_| {}),
    ]
}

#[test]
fn nonsense_on_every_channel_ends_no_process() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (report, recording, name) = (path("report.json"), path("a.mcap"), instance_name());
    let run = ["run", "--no-picture", "--direct", "--duration", "8", "--instance", &name];
    let running = Running::start(&[&run[..], &["--report", &report, "--record", &recording]].concat());
    let mut observer = Observer::join(&name);
    let mut steps = observer.receiver::<StepRecord>();
    observer.health(Process::Simcore, |h| h.state == STATE_RUNNING);
    next(&mut steps, |s| s.step >= 20 && s.step < 1000);
    let hostile = Instance::join(&name).expect("the instance");
    let mut channels = all_channels(&hostile);
    let mut random = Random::new(11);
    // The real stream goes on between the rounds: nonsense comes at every moment of it.
    for _ in 0..60 {
        channels.iter_mut().for_each(|spray| spray(&mut random));
        wait(&[&steps], MAX_WAIT_MS * 10_000_000);
        while steps.receive().expect("channel works").is_some() {}
    }
    drop((channels, hostile, steps, observer));
    let finished = running.finish();
    assert!(matches!(finished.code, Some(0 | 3)), "{finished:#?}");
    assert!(!finished.stderr.contains("panicked"), "{}", finished.stderr);
    let report = json(&folder.path().join("report.json"));
    let restarts = report["restarts"].as_object().expect("restarts");
    assert!(restarts.values().all(|n| n == 0), "{restarts:?}\n{}", finished.stderr);
    let refused = |p: &serde_json::Value| p["refused"].as_u64().unwrap_or(0);
    let all: u64 = report["processes"].as_array().expect("processes").iter().map(refused).sum();
    assert!(all > 100, "nonsense arrived and was refused: {all}");
}
