//! The process itself: fields of pixels and of blobs, schedule, pause, reset, late cameras, end of
//! a stream, shutdown.

use blob_stream::live::LiveFigures;
use ipc::clock::now;
use ipc::{Instance, Queue, Receiver, Sender, wait};
use protocol::blobs::BlobField;
use protocol::control::{Answer, Command as Ask, Request};
use protocol::fields::{FieldHeader, FieldPicture};
use protocol::handles::{HandleState, PedalState};
use protocol::health::{Health, Process, STATE_DEGRADED, STATE_FINISHED, STATE_RUNNING};
use std::io::Write;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

/// Nothing here takes longer on the slowest machine.
const WATCHDOG: Duration = Duration::from_secs(60);
const PERIOD_NS: u64 = 20_000_000;
/// From exposure to the end of the read-out in the shipped rig: 2 ms and 288 lines of 64 µs.
const READ_OUT_NS: u64 = 2_000_000 + 288 * 64_000;
/// From exposure until blobs may leave at the earliest: no marker of the shipped rig appears below
/// line 245 of a field, in any camera.
const OUT_NS: u64 = 2_000_000 + 245 * 64_000;

struct Setup {
    child: Child,
    blobs: Receiver<BlobField>,
    handles: Receiver<HandleState>,
    pedal: Receiver<PedalState>,
    health: Receiver<Health>,
    answers: Receiver<Answer>,
    control: Sender<Request>,
    asked: u64,
    instance: Instance,
}

impl Setup {
    fn start(name: &str, args: &[&str]) -> Setup {
        let name = format!("vr{name}{}", std::process::id() % 1_000_000);
        let instance = Instance::own(&name).unwrap();
        Setup {
            blobs: instance.receiver(Queue::InOrder).unwrap(),
            handles: instance.receiver(Queue::InOrder).unwrap(),
            pedal: instance.receiver(Queue::InOrder).unwrap(),
            health: instance.receiver(Queue::InOrder).unwrap(),
            answers: instance.receiver(Queue::InOrder).unwrap(),
            control: instance.sender().unwrap(),
            asked: 0,
            child: Command::new(env!("CARGO_BIN_EXE_vitreo-virtual-rig"))
                .args(["--instance", &name])
                .args(args)
                .spawn()
                .unwrap(),
            instance,
        }
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

    fn fields(&mut self, n: usize) -> Vec<BlobField> {
        let mut all = Vec::new();
        self.until("enough fields come", |s| {
            while let Some(field) = s.blobs.next_valid().unwrap() {
                all.push(field);
            }
            (all.len() >= n).then_some(())
        });
        all
    }

    fn state(&mut self, state: u32) -> Health {
        self.until("the state is reported", |s| {
            std::iter::from_fn(|| s.health.next_valid().unwrap()).find(|h| h.state == state)
        })
    }

    fn send(&mut self, command: Ask) -> u64 {
        let (seq, target) = (self.asked, Process::VirtualRig as u32);
        self.asked += 1;
        self.control.send(&Request { seq, argument: 0, target, command: command as u32 }).unwrap();
        seq
    }

    /// Asks and returns the result code.
    fn ask(&mut self, command: Ask) -> u32 {
        let seq = self.send(command);
        self.until("the request is answered", |s| {
            std::iter::from_fn(|| s.answers.next_valid().unwrap()).find(|a| a.seq == seq).map(|a| a.result)
        })
    }

    /// A process that ends takes its unread answer along: its exit is the answer.
    fn end(mut self) {
        self.send(Ask::Shutdown);
        let status = self.until("the process ends", |s| s.child.try_wait().unwrap());
        assert!(status.success(), "{status}");
    }
}

impl Drop for Setup {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn pixels_are_published_ahead_with_controls_and_with_their_instants() {
    let mut setup = Setup::start("s", &["--duration", "0.6"]);
    let mut blocks = setup.instance.block_receiver::<FieldHeader>().unwrap();
    setup.state(STATE_RUNNING);
    let (mut headers, mut ahead): (Vec<FieldHeader>, usize) = (Vec::new(), 0);
    setup.until("the last field is published", |s| {
        while let Some(sample) = blocks.receive().unwrap() {
            let (header, arrived) = (*sample.header(), now());
            // On a machine under load this test may look late; the rig itself leaves fields out.
            ahead += usize::from(arrived < header.first_line_ns + OUT_NS);
            let picture = FieldPicture::in_payload(&header, sample.payload()).unwrap();
            assert_eq!((picture.width, header.height), (720, 288));
            assert!(picture.height < header.height as usize, "only lines in which markers can appear");
            let bright = picture.luma.iter().filter(|&&luma| luma > 80).count();
            assert!(bright > 500, "markers, found {bright} bright pixels");
            headers.push(header);
        }
        let finished = std::iter::from_fn(|| s.health.next_valid().unwrap());
        { finished }.any(|h| h.state == STATE_FINISHED).then_some(())
    });
    assert!(ahead > 0, "none of {} fields came before its region had passed", headers.len());
    let t0 = headers[0].exposed_ns - headers[0].field * PERIOD_NS;
    for header in &headers {
        assert_eq!(header.exposed_ns, t0 + header.field * PERIOD_NS, "exposed on the grid, genlocked");
        assert_eq!(header.read_out_ns(), header.exposed_ns + READ_OUT_NS);
        assert_eq!(u64::from(header.parity), header.field & 1);
    }
    for camera in 0..3 {
        let own: Vec<_> = headers.iter().filter(|f| f.camera == camera).map(|f| f.field).collect();
        assert!(!own.is_empty() && own.is_sorted_by(|a, b| a < b), "{own:?}");
    }
    let handles: Vec<_> = std::iter::from_fn(|| setup.handles.next_valid().unwrap()).collect();
    let published = headers.len() as u64 + blocks.counts().lost;
    assert_eq!(handles.len() as u64, published / 3 * 2);
    assert!(handles.iter().zip(0..).all(|(h, seq)| h.seq == seq && u64::from(h.instrument) == seq % 2));
    assert!(setup.pedal.next_valid().unwrap().is_some());
    assert!(setup.fields(0).is_empty(), "the rig sends pixels or blobs, not both");
    setup.end();
}

#[test]
fn late_and_delayed_pixels_have_a_later_first_line() {
    let mut setup = Setup::start("d", &["--late-camera", "1=30", "--duration", "0.3"]);
    let mut blocks = setup.instance.block_receiver::<FieldHeader>().unwrap();
    let mut seen = 0;
    setup.until("fields of both kinds come", |_| {
        while let Some(sample) = blocks.receive().unwrap() {
            let header = *sample.header();
            let late = if header.camera == 1 { 30_000_000 } else { 0 };
            assert_eq!(header.first_line_ns, header.exposed_ns + 2_000_000 + late);
            seen |= 1 << header.camera;
        }
        (seen == 0b111).then_some(())
    });
    setup.end();
}

#[test]
fn pause_stands_still_and_reset_begins_anew() {
    let mut setup = Setup::start("p", &["--direct"]);
    setup.fields(6);
    assert_eq!(setup.ask(Ask::Pause), 0);
    // What was sent before the answer is in the queue by now; nothing follows it.
    let before = setup.fields(0).last().copied();
    assert_eq!(setup.ask(Ask::Snapshot), 1, "cameras save no pictures");
    assert!(setup.fields(0).is_empty());
    assert_eq!(setup.ask(Ask::Start), 0);
    let after = setup.fields(1)[0];
    if let Some(before) = before {
        assert!(after.field <= before.field + 1, "a pause leaves nothing out");
    }
    assert_eq!(setup.ask(Ask::Reset), 0);
    setup.until("field 0 comes again", |s| {
        std::iter::from_fn(|| s.blobs.next_valid().unwrap()).find(|f| f.field == 0)
    });
    setup.end();
}

#[test]
fn a_late_camera_is_late_and_loses_nothing() {
    let mut setup = Setup::start("l", &["--direct", "--late-camera", "1=30", "--duration", "0.4"]);
    setup.state(STATE_FINISHED);
    let fields = setup.fields(3);
    let of = |camera: u32| fields.iter().filter(move |f| f.camera == camera);
    assert_eq!(of(0).map(|f| f.field).collect::<Vec<_>>(), of(1).map(|f| f.field).collect::<Vec<_>>());
    assert!(of(1).all(|f| f.blobs_out_ns >= f.exposed_ns + OUT_NS + 30_000_000));
    setup.end();
}

/// Lines of a fault log of one kind: camera and field.
fn told(log: &std::path::Path, kind: &str) -> Vec<(u32, u64)> {
    let text = std::fs::read_to_string(log).unwrap();
    let lines = text.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let of_kind = lines.filter(|v| v["kind"] == kind);
    of_kind.map(|v| (v["camera"].as_u64().unwrap() as u32, v["field"].as_u64().unwrap())).collect()
}

#[test]
fn dropped_and_late_fields_are_those_of_the_log_and_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let (log, spec) = (folder.path().join("log.jsonl"), folder.path().join("f.toml"));
    let text = "format = \"vitreo-faults-1\"\n[dropped]\nrate = 0.2\ncameras = [0, 1]\n[late]\nrate = 0.2\n\
                delay-ms = 50\ncameras = [2]\n";
    std::fs::write(&spec, text).unwrap();
    let (spec, log_path) = (spec.to_str().unwrap(), log.to_str().unwrap());
    let args = ["--direct", "--duration", "0.8", "--faults", spec, "--fault-log", log_path];
    let mut setup = Setup::start("f", &args);
    let health = setup.state(STATE_FINISHED);
    let fields = setup.fields(3);
    let (dropped, late) = (told(&log, "dropped"), told(&log, "late"));
    assert!(!dropped.is_empty() && !late.is_empty(), "0.2 of 40 fields of each camera");
    for camera in 0..3 {
        let own = |n: &u64| fields.iter().any(|f| f.camera == camera && f.field == *n);
        // A machine too slow leaves whole instants out; those nobody has.
        let exposed = (0..40)
            .filter(|n| fields.iter().any(|f| f.field == *n) || dropped.iter().any(|(_, field)| field == n));
        let absent: Vec<u64> = exposed.filter(|n| !own(n)).collect();
        let expected: Vec<u64> = dropped.iter().filter(|(c, _)| *c == camera).map(|(_, n)| *n).collect();
        assert_eq!(absent, expected, "camera {camera}: exactly the dropped fields are absent");
    }
    let text = std::fs::read_to_string(&log).unwrap();
    for line in text.lines().filter(|l| l.contains("\"late\"")) {
        let line: serde_json::Value = serde_json::from_str(line).unwrap();
        let (number, delay) = (line["field"].as_u64().unwrap(), line["delay_ns"].as_u64().unwrap());
        let field = fields.iter().find(|f| f.camera == 2 && f.field == number).unwrap();
        assert!(
            field.blobs_out_ns >= field.exposed_ns + OUT_NS + delay,
            "field {number} is late by {delay} ns"
        );
    }
    let order: Vec<u64> = fields.iter().filter(|f| f.camera == 2).map(|f| f.field).collect();
    assert!(order.is_sorted(), "late fields are not overtaken: {order:?}");
    let said = health.text();
    let counted = format!("faults: dropped {}, late {}", dropped.len(), late.len());
    assert!(said.contains("finished") && said.contains(&counted), "{said:?}, expected {counted:?}");
    setup.end();
}

#[test]
fn cameras_with_clocks_of_their_own_keep_their_own_spacing() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.jsonl");
    let args =
        ["--direct", "--duration", "0.6", "--faults", "clock-drift", "--fault-log", log.to_str().unwrap()];
    let mut setup = Setup::start("c", &args);
    setup.state(STATE_FINISHED);
    let fields = setup.fields(3);
    let mut starts = Vec::new();
    for line in std::fs::read_to_string(&log).unwrap().lines() {
        let line: serde_json::Value = serde_json::from_str(line).unwrap();
        let (camera, ppb) = (line["camera"].as_u64().unwrap() as u32, line["ppb"].as_i64().unwrap());
        let phase = line["phase_ns"].as_u64().unwrap();
        let period = |n: u64| (n * PERIOD_NS) as i64 + (n * PERIOD_NS) as i64 * ppb / 1_000_000_000;
        let own: Vec<_> = fields.iter().filter(|f| f.camera == camera).collect();
        assert!(own.len() > 5, "camera {camera}");
        for field in &own {
            let start = field.exposed_ns as i64 - period(field.field) - phase as i64;
            starts.push(start);
            assert!(field.blobs_out_ns >= field.exposed_ns + OUT_NS);
        }
    }
    assert_eq!(starts.len(), fields.len(), "one line of the log for each camera");
    assert!(
        starts.iter().all(|s| *s == starts[0]),
        "every camera on its own grid from one start: {starts:?}"
    );
    let second = |camera| fields.iter().find(|f| f.camera == camera).unwrap().exposed_ns % PERIOD_NS;
    assert!(second(0) != second(1) && second(1) != second(2), "not genlocked");
    setup.end();
}

#[test]
fn a_recorded_stream_is_played_to_its_end() {
    let line = |seq: u64| {
        let t = 48_000_000 + seq * 5_000_000;
        let blob = r#"{"x":300.5,"y":100.25,"area":180,"colour":"red","w":20,"h":11}"#;
        format!(
            "{{\"cam\":2,\"seq\":{seq},\"t_ns\":{t},\"t_rx_ns\":{},\"parity\":{},\"blobs\":[{blob}]}}\n",
            t + 24_000_000,
            seq & 1
        )
    };
    let path = std::env::temp_dir().join(format!("vitreo-play-{}.jsonl", std::process::id()));
    std::fs::write(&path, (0..20).map(line).collect::<String>()).unwrap();
    let mut setup = Setup::start("b", &["--blobs", path.to_str().unwrap()]);
    setup.state(STATE_FINISHED);
    std::fs::remove_file(&path).unwrap();
    let fields = setup.fields(20);
    assert_eq!(fields.len(), 20);
    for (field, seq) in fields.iter().zip(0..) {
        assert_eq!((field.camera, field.field, field.count), (2, seq, 1));
        assert_eq!(field.exposed_ns, fields[0].exposed_ns + seq * 5_000_000, "the stream's own spacing");
        assert!(field.blobs_out_ns >= field.exposed_ns + 24_000_000, "never before it was received");
    }
    setup.end();
}

/// A line of a stream whose writer counts from 0, by a clock of its own.
fn live_line(seq: u64) -> String {
    let t = 48_000_000 + seq * PERIOD_NS;
    let blob = r#"{"x":300.5,"y":100.25,"area":180,"colour":"red","w":20,"h":11}"#;
    let t_rx = t + 24_000_000;
    format!("{{\"cam\":2,\"seq\":{seq},\"t_ns\":{t},\"t_rx_ns\":{t_rx},\"parity\":0,\"blobs\":[{blob}]}}\n")
}

#[test]
fn a_pipe_is_live_and_heard_from_one_writer_after_the_other() {
    let folder = tempfile::tempdir().unwrap();
    let fifo = folder.path().join("fifo");
    assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    let mut setup = Setup::start("fi", &["--blobs", fifo.to_str().unwrap()]);
    let waiting = |h: &Health| h.text().starts_with("waiting for a writer");
    let mut fields = Vec::new();
    for round in 1..=2u64 {
        setup.until("a writer is waited for", |s| {
            std::iter::from_fn(|| s.health.next_valid().unwrap()).find(waiting)
        });
        let mut writer = std::fs::File::options().write(true).open(&fifo).unwrap();
        for seq in 0..10 {
            // One at a time: each line comes out before the next is written.
            writer.write_all(live_line(seq).as_bytes()).unwrap();
            let next = setup.fields(1);
            assert!(next.iter().all(|f| f.exposed_ns + 24_000_000 <= now()), "never from the future");
            fields.extend(next);
            if seq == 5 {
                writer.write_all(b"{\"cam\":2}\n").unwrap();
            }
        }
        let heard = 11 * round;
        setup.until("the lines are counted, and nothing comes", |s| {
            let mut beats = std::iter::from_fn(|| s.health.next_valid().unwrap());
            beats.find(|h| (h.received, h.refused, h.state) == (heard, round, STATE_DEGRADED))
        });
    }
    assert_eq!(fields.iter().map(|f| f.field).collect::<Vec<_>>(), (0..20).collect::<Vec<_>>());
    assert!(fields.windows(2).all(|w| w[0].exposed_ns < w[1].exposed_ns));
    let handle = setup.handles.next_valid().unwrap().unwrap();
    assert!(handle.jaw_rad > 0.0, "open");
    assert_eq!(setup.pedal.next_valid().unwrap().unwrap().axes, [0.0; 2], "up");
    let directory = setup.instance.directory().to_owned();
    assert_eq!(setup.ask(Ask::Ping), 0);
    let left = LiveFigures::left_in(&directory).unwrap();
    assert_eq!((left.lines, left.fields, left.bad, left.writers), (22, 20, 2, 2));
    assert!(left.silences >= 1 && left.source.starts_with("FIFO "), "{left:?}");
    setup.end();
}

#[test]
fn a_live_stream_ends_with_its_duration_though_nobody_writes() {
    let mut setup = Setup::start("po", &["--blobs", "tcp:0", "--duration", "0.2"]);
    setup.state(STATE_FINISHED);
    setup.end();
}

#[test]
fn bad_input_ends_with_a_message_that_names_the_file() {
    let run = |args: &[&str]| {
        let out = Command::new(env!("CARGO_BIN_EXE_vitreo-virtual-rig")).args(args).output().unwrap();
        (out.status.code(), String::from_utf8(out.stderr).unwrap())
    };
    for (args, named, wanted) in [
        (["--motion", "/dev/null"], "/dev/null", 1),
        (["--blobs", "/nonexistent.jsonl"], "/nonexistent.jsonl", 1),
        (["--blobs", "tcp:192.0.2.1:1"], "--blobs: tcp:192.0.2.1:1", 1),
        (["--scene", "nowhere"], "nowhere", 1),
        (["--rig", "/nonexistent.json"], "--rig: rig file /nonexistent.json", 1),
        (["--late-camera", "7=3"], "camera 7", 1),
        (["--faults", "dropped,gremlins"], "gremlins", 2),
        (["--faults", "/nonexistent.toml"], "/nonexistent.toml", 1),
    ] {
        let (code, text) = run(&args);
        assert_eq!(code, Some(wanted), "{text}");
        assert!(text.starts_with("vitreo-virtual-rig: ") && text.contains(named), "{text}");
    }
    assert_eq!(run(&["--seed", "many"]).0, Some(2), "wrong use");
}
