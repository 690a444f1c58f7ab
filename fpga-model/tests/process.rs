//! The process itself: fields of pixels in, blobs out when the hardware would send them.

use ipc::clock::now;
use ipc::{BlockSender, Instance, Queue, Receiver, Sender, wait};
use protocol::blobs::BlobField;
use protocol::control::{Answer, Command as Ask, Request};
use protocol::fields::{FieldHeader, FieldPicture};
use protocol::health::{Health, Process, STATE_DEGRADED, STATE_RUNNING};
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};
use std::process::{Child, Command};
use std::time::{Duration, Instant};
use surgeon::motion::MotionSource;
use virtual_rig::cameras::{Cameras, Path};

/// Nothing here takes longer on the slowest machine.
const WATCHDOG: Duration = Duration::from_secs(60);
/// From the first line until blobs may leave at the earliest: no marker of the shipped rig appears
/// below line 245 of a field, in any camera.
const REGION_NS: u64 = 245 * 64_000;

/// A camera source, and what hears the process.
struct Setup {
    child: Child,
    fields: BlockSender<FieldHeader>,
    blobs: Receiver<BlobField>,
    health: Receiver<Health>,
    answers: Receiver<Answer>,
    control: Sender<Request>,
    cameras: Cameras,
    surgeon: MotionSource,
    _instance: Instance,
}

impl Setup {
    fn start(name: &str, args: &[&str]) -> Setup {
        let name = format!("fp{name}{}", std::process::id() % 1_000_000);
        let instance = Instance::own(&name).unwrap();
        let rig = Rig::load_or_shipped(None).unwrap();
        let cameras = Cameras::new(&rig, Path::Pixels, 1).unwrap();
        let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
        let mut setup = Setup {
            fields: instance.block_sender(1 << 20).unwrap(),
            blobs: instance.receiver(Queue::InOrder).unwrap(),
            health: instance.receiver(Queue::InOrder).unwrap(),
            answers: instance.receiver(Queue::InOrder).unwrap(),
            control: instance.sender().unwrap(),
            child: Command::new(env!("CARGO_BIN_EXE_vitreo-fpga-model"))
                .args(["--instance", &name])
                .args(args)
                .spawn()
                .unwrap(),
            cameras,
            surgeon: MotionSource::new(&scene, &rig, None, 1),
            _instance: instance,
        };
        setup.state(STATE_RUNNING);
        setup
    }

    /// Waits until `found` finds something.
    fn until<T>(&mut self, what: &str, mut found: impl FnMut(&mut Setup) -> Option<T>) -> T {
        let begun = Instant::now();
        loop {
            if let Some(found) = found(self) {
                return found;
            }
            assert!(begun.elapsed() < WATCHDOG, "timed out before {what}");
            wait(&[&self.blobs, &self.health, &self.answers], 5_000_000);
        }
    }

    fn state(&mut self, state: u32) -> Health {
        self.until("the state is reported", |s| {
            std::iter::from_fn(|| s.health.next_valid().unwrap()).find(|h| h.state == state)
        })
    }

    /// Publishes field `number` of camera `i` with its first line at `first_line_ns`.
    fn publish(&mut self, i: usize, number: u64, first_line_ns: u64) -> FieldHeader {
        let mut exposure = self.cameras.expose(i, &mut self.surgeon, number);
        let mut header = exposure.header();
        (header.exposed_ns, header.first_line_ns) = (first_line_ns - 2_000_000, first_line_ns);
        self.fields
            .send(header.bytes(), |payload| {
                exposure.paint(payload);
                header
            })
            .unwrap();
        header
    }

    fn next(&mut self) -> BlobField {
        self.until("blobs come", |s| s.blobs.next_valid().unwrap())
    }

    /// Asks and returns the result code.
    fn ask(&mut self, seq: u64, command: Ask) -> u32 {
        let target = Process::FpgaModel as u32;
        self.control.send(&Request { seq, argument: 0, target, command: command as u32 }).unwrap();
        self.until("the request is answered", |s| {
            std::iter::from_fn(|| s.answers.next_valid().unwrap()).find(|a| a.seq == seq).map(|a| a.result)
        })
    }
}

impl Drop for Setup {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn blobs_leave_when_the_pixel_clock_says_so_however_early_the_pixels_came() {
    let mut setup = Setup::start("t", &[]);
    for number in 0..4 {
        let first_line_ns = now() + 30_000_000;
        let sent: Vec<FieldHeader> = (0..3).map(|i| setup.publish(i, number, first_line_ns)).collect();
        for header in &sent {
            let field = setup.next();
            let own = sent.iter().find(|h| h.camera == field.camera).unwrap();
            assert_eq!((field.field, field.parity), (number, header.parity));
            assert_eq!((field.exposed_ns, field.read_out_ns), (own.exposed_ns, own.read_out_ns()));
            assert!(field.blobs_out_ns >= first_line_ns + REGION_NS, "never earlier than the hardware");
            assert!(field.count >= 10, "most of 14 markers, found {}", field.count);
        }
    }
}

#[test]
fn a_delayed_process_delays_every_field_and_pixels_that_come_late_leave_at_once() {
    let mut setup = Setup::start("d", &["--inject-delay-ms", "40"]);
    let header = setup.publish(0, 0, now());
    assert!(setup.next().blobs_out_ns >= header.first_line_ns + REGION_NS + 40_000_000);
    let header = setup.publish(0, 1, now() - 500_000_000);
    let late = setup.next();
    assert_eq!((late.field, late.exposed_ns), (1, header.exposed_ns));
}

#[test]
fn a_reset_forgets_what_is_held_back_and_so_does_a_source_that_begins_anew() {
    let mut setup = Setup::start("r", &[]);
    setup.publish(0, 7, now() + 3_600_000_000_000);
    assert_eq!(setup.ask(1, Ask::Pause), 0, "fields on their way are the source's");
    assert_eq!(setup.ask(2, Ask::Reset), 0);
    assert_eq!(setup.ask(3, Ask::Snapshot), 1, "cameras save no pictures");
    setup.publish(0, 8, now());
    assert_eq!(setup.next().field, 8);
    setup.publish(0, 9, now() + 3_600_000_000_000);
    setup.publish(0, 2, now());
    assert_eq!(setup.next().field, 2);
}

#[test]
fn fields_of_no_camera_of_the_rig_are_refused_and_reported() {
    let mut setup = Setup::start("f", &[]);
    let picture = FieldPicture::new([64, 64]);
    let mut header = setup.publish(0, 0, now());
    (header.width, header.height, header.lines) = (64, 32, 32);
    setup
        .fields
        .send(header.bytes(), |payload| {
            payload[..picture.luma.len()].copy_from_slice(&picture.luma);
            header
        })
        .unwrap();
    let health = setup.state(STATE_DEGRADED);
    assert!(health.text().contains("64×32"), "{}", health.text());
    assert_eq!(setup.next().field, 0, "the good one came");
}

#[test]
fn bad_input_ends_with_a_message_that_names_the_file() {
    let run = |args: &[&str]| {
        let out = Command::new(env!("CARGO_BIN_EXE_vitreo-fpga-model")).args(args).output().unwrap();
        (out.status.code(), String::from_utf8(out.stderr).unwrap())
    };
    let (code, text) = run(&["--rig", "/nonexistent.json"]);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.starts_with("vitreo-fpga-model: ") && text.contains("/nonexistent.json"), "{text}");
    assert_eq!(run(&["--scene", "peel"]).0, Some(2), "it knows of no scene");
}
