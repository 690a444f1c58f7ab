//! Calls as C makes them, above all wrong ones.

use super::*;
use crate::roles::{READS_POSES, SENDS_BLOBS, SENDS_FIELDS, SENDS_HANDLES, SENDS_PEDAL, SENDS_POSES};
use ipc::{Instance, Queue, Receiver};
use protocol::message::Message;
use std::ffi::CString;
use std::ptr::{null, null_mut};

fn words() -> String {
    // SAFETY: the library's text, which ends with a zero.
    unsafe { CStr::from_ptr(vitreo_error_text()) }.to_str().unwrap().to_owned()
}

fn open(instance: &str, roles: u32) -> (i32, u64) {
    let (instance, name) = (CString::new(instance).unwrap(), CString::new("test").unwrap());
    let mut driver = 0;
    // SAFETY: texts with their ends, and a number.
    let code = unsafe { vitreo_open(instance.as_ptr(), name.as_ptr(), roles, LAYOUT, 0, &mut driver) };
    (code, driver)
}

/// A run that takes everything from outside.
fn run(test: &str) -> (Instance, String) {
    let name = format!("f{}-{test}", std::process::id() % 1_000_000);
    let run = Instance::own(&name).unwrap();
    run.invite(&["blobs", "fields", "handles", "pedal", "poses"]).unwrap();
    (run, name)
}

fn blobs() -> BlobField {
    BlobField { field: 7, exposed_ns: vitreo_now(), ..bytemuck::Zeroable::zeroed() }
}

#[test]
fn what_is_sent_arrives_and_what_makes_no_sense_is_refused_in_words() {
    let (run, name) = run("send");
    let mut received = run.receiver::<BlobField>(Queue::InOrder).unwrap();
    let (code, driver) = open(&name, SENDS_BLOBS | READS_POSES);
    assert_eq!(code, 0, "{}", words());
    let size = size_of::<BlobField>();
    // SAFETY: blocks of their sizes, or NULL.
    unsafe {
        assert_eq!(vitreo_send_blobs(driver, &blobs(), size), 0);
        assert_eq!(vitreo_send_blobs(driver, null(), size), Code::Null as i32);
        assert_eq!(vitreo_send_blobs(driver, &blobs(), size - 8), Code::Size as i32);
        assert!(words().contains("BlobField") && words().contains("recompile this program"), "{}", words());
        let odd = BlobField { parity: 9, ..blobs() };
        assert_eq!(vitreo_send_blobs(driver, &odd, size), Code::Invalid as i32);
        assert_eq!(words(), "BlobField.parity: expected 0 or 1, or 2 of a whole frame, found 9");
        let pedal = bytemuck::Zeroable::zeroed();
        assert_eq!(vitreo_send_pedal(driver, &pedal, size_of::<PedalState>()), Code::Role as i32);
        let mut frame = bytemuck::Zeroable::zeroed();
        let frame_size = size_of::<TrackerFrame>();
        assert_eq!(vitreo_next_poses(driver, &mut frame, frame_size, 1), Code::Nothing as i32);
        assert_eq!(vitreo_next_poses(driver, null_mut(), frame_size, 0), Code::Null as i32);
    }
    let got = received.next_valid().unwrap().expect("a field");
    assert!(got.field == 7 && got.blobs_out_ns >= got.exposed_ns);
    assert_eq!(vitreo_close(driver), 0);
    assert_eq!((vitreo_close(driver), vitreo_check(driver)), (Code::Closed as i32, Code::Closed as i32));
    // SAFETY: a block of its size.
    assert_eq!(unsafe { vitreo_send_blobs(driver, &blobs(), size) }, Code::Closed as i32);
}

#[test]
fn every_channel_takes_its_block_and_a_field_is_written_where_it_lies() {
    let (run, name) = run("all");
    let mut handles = run.receiver::<HandleState>(Queue::InOrder).unwrap();
    let mut pedals = run.receiver::<PedalState>(Queue::InOrder).unwrap();
    let mut poses = run.receiver::<TrackerFrame>(Queue::InOrder).unwrap();
    let mut fields = run.block_receiver::<FieldHeader>().unwrap();
    let (code, driver) = open(&name, SENDS_FIELDS | SENDS_HANDLES | SENDS_PEDAL | SENDS_POSES | READS_POSES);
    assert_eq!(code, 0, "{}", words());
    let handle = HandleState { tool: 1, ..bytemuck::Zeroable::zeroed() };
    let pedal: PedalState = bytemuck::Zeroable::zeroed();
    let mut frame: TrackerFrame = bytemuck::Zeroable::zeroed();
    let exposed_ns = vitreo_now();
    frame.instants.exposed = exposed_ns;
    frame.bodies.iter_mut().for_each(|b| b.world_from_body = protocol::geometry::Pose::IDENTITY);
    let header = FieldHeader {
        exposed_ns,
        line_period_ns: 64_000,
        format: protocol::fields::FORMAT_YCBCR_422,
        width: 8,
        height: 4,
        lines: 4,
        ..bytemuck::Zeroable::zeroed()
    };
    let (mut memory, mut bytes, size) = (null_mut(), 0, size_of::<FieldHeader>());
    // SAFETY: blocks of their sizes, places of this function, and memory that is lent.
    unsafe {
        for _ in 0..2 {
            assert_eq!(vitreo_send_handle(driver, &handle, size_of::<HandleState>()), 0, "{}", words());
        }
        assert_eq!(vitreo_send_pedal(driver, &pedal, size_of::<PedalState>()), 0, "{}", words());
        assert_eq!(vitreo_send_poses(driver, &frame, size_of::<TrackerFrame>()), 0, "{}", words());
        assert_eq!(vitreo_send_field(driver), Code::Loan as i32);
        assert_eq!(vitreo_lend_field(driver, &header, size, &mut memory, &mut bytes), 0, "{}", words());
        assert_eq!(vitreo_lend_field(driver, &header, size, &mut memory, &mut bytes), Code::Loan as i32);
        std::slice::from_raw_parts_mut(memory, bytes).fill(9);
        assert_eq!((bytes, vitreo_send_field(driver)), (64, 0));
        let large = FieldHeader { width: 16, ..header };
        assert_eq!(vitreo_lend_field(driver, &large, size, &mut memory, &mut bytes), Code::Size as i32);
        assert_eq!(vitreo_next_poses(driver, &mut frame, size_of::<TrackerFrame>(), 1_000), 0);
    }
    let seqs: Vec<u64> = std::iter::from_fn(|| handles.next_valid().unwrap()).map(|h| h.seq).collect();
    assert_eq!((seqs, frame.instants.exposed), (vec![0, 1], exposed_ns));
    assert!(pedals.next_valid().unwrap().is_some_and(|p| p.instant_ns > 0));
    assert!(poses.next_valid().unwrap().is_some_and(|p| p.instants.tracked > 0));
    let field = fields.receive().unwrap().expect("a field");
    assert!(field.payload()[..64].iter().all(|b| *b == 9) && field.header() == &header);
    assert_eq!(vitreo_close(driver), 0);
}

#[test]
fn wrong_ways_to_open_are_told_apart() {
    let (run, name) = run("open");
    let mut driver = 0;
    let text = CString::new(name.clone()).unwrap();
    // SAFETY: texts with their ends, NULL, and places of this function.
    let tries = |instance, name, roles, layout, to| {
        let code = unsafe { vitreo_open(instance, name, roles, layout, 0, to) };
        (code, words())
    };
    let t = text.as_ptr();
    assert_eq!(tries(null(), t, SENDS_BLOBS, LAYOUT, &mut driver).0, Code::Null as i32);
    assert_eq!(tries(t, null(), SENDS_BLOBS, LAYOUT, &mut driver).0, Code::Null as i32);
    assert_eq!(tries(t, t, SENDS_BLOBS, LAYOUT, null_mut()).0, Code::Null as i32);
    let other = tries(t, t, SENDS_BLOBS, LAYOUT ^ 1, &mut driver);
    assert!(other.0 == Code::Header as i32 && other.1.contains("another version"), "{other:?}");
    let unknown = tries(t, t, 1 << 20, LAYOUT, &mut driver);
    assert!(unknown.0 == Code::Argument as i32 && unknown.1.contains("0x100000"), "{unknown:?}");
    assert_eq!(tries(t, t, 0, LAYOUT, &mut driver).0, Code::Argument as i32);
    run.invite(&["pedal"]).unwrap();
    let uninvited = tries(t, t, SENDS_BLOBS | SENDS_HANDLES, LAYOUT, &mut driver);
    assert!(uninvited.0 == Code::NotInvited as i32, "{uninvited:?}");
    assert!(uninvited.1.contains("--external blobs,handles"), "{uninvited:?}");
    drop(run);
    let absent = tries(t, t, SENDS_BLOBS, LAYOUT, &mut driver);
    assert!(absent.0 == Code::NoRun as i32 && absent.1.contains(&name), "{absent:?}");
    let odd = CString::new("NO/NAME").unwrap();
    assert_eq!(tries(odd.as_ptr(), t, SENDS_BLOBS, LAYOUT, &mut driver).0, Code::Argument as i32);
}

/// `pedal` as another version of vitreo has it.
#[repr(C)]
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable, protocol::wire::Wire)]
struct OtherPedal {
    depth: f64,
}

impl Message for OtherPedal {
    const CHANNEL: &'static str = "pedal";
    const VERSION: u32 = 3;
    const QUEUE: usize = 256;

    fn validate(&self) -> Result<(), protocol::message::Invalid> {
        Ok(())
    }
}

#[test]
fn a_run_of_another_version_is_refused_in_words() {
    let (run, name) = run("other");
    let _pedal = run.receiver::<OtherPedal>(Queue::InOrder).unwrap();
    let (code, _) = open(&name, SENDS_PEDAL);
    assert_eq!(code, Code::Schema as i32);
    assert!(words().contains("channel pedal") && words().contains("another version"), "{}", words());
}

#[test]
fn a_driver_belongs_to_its_thread_and_stops_with_its_run() {
    let (run, name) = run("stop");
    let (code, driver) = open(&name, SENDS_BLOBS | READS_POSES);
    assert_eq!((code, vitreo_check(driver)), (0, 0), "{}", words());
    let elsewhere = std::thread::spawn(move || vitreo_check(driver)).join().unwrap();
    assert_eq!(elsewhere, Code::Closed as i32);
    drop(run);
    let mut frame = bytemuck::Zeroable::zeroed();
    // SAFETY: a block of its size. Waits for ever, and ends with the run.
    let ended = unsafe { vitreo_next_poses(driver, &mut frame, size_of::<TrackerFrame>(), -1) };
    assert_eq!((ended, vitreo_check(driver)), (Code::Stop as i32, Code::Stop as i32));
    assert_eq!(words(), "the run has ended");
    assert_eq!(vitreo_close(driver), 0);
}

/// Waits for a heartbeat.
fn wait_for(health: &mut Receiver<Health>, wanted: &dyn Fn(&Health) -> bool) {
    loop {
        ipc::wait(&[&*health], 100_000_000);
        while let Some(beat) = health.next_valid().unwrap() {
            if wanted(&beat) {
                return;
            }
        }
    }
}

#[test]
fn an_instant_of_another_clock_is_refused_counted_and_shown_until_the_next_is_right() {
    use protocol::health::{Process, STATE_DEGRADED, STATE_RUNNING};
    const S: u64 = 1_000_000_000;
    let (run, name) = run("clock");
    let mut health = run.receiver::<Health>(Queue::InOrder).unwrap();
    let (code, driver) = open(&name, SENDS_BLOBS | SENDS_POSES | SENDS_PEDAL);
    assert_eq!(code, 0, "{}", words());
    let mut until = |wanted: &dyn Fn(&Health) -> bool| wait_for(&mut health, wanted);
    // SAFETY: blocks of their sizes.
    let send = |exposed_ns: u64| unsafe {
        vitreo_send_blobs(driver, &BlobField { exposed_ns, ..blobs() }, size_of::<BlobField>())
    };
    let poses = |exposed_ns: u64| {
        let mut frame: TrackerFrame = bytemuck::Zeroable::zeroed();
        frame.instants.exposed = exposed_ns;
        frame.bodies.iter_mut().for_each(|b| b.world_from_body = protocol::geometry::Pose::IDENTITY);
        // SAFETY: a block of its size.
        unsafe { vitreo_send_poses(driver, &frame, size_of::<TrackerFrame>()) }
    };
    let invalid = Code::Invalid as i32;
    assert_eq!(send(vitreo_now() + 3_600 * S), invalid);
    assert!(
        words().starts_with("BlobField.exposed_ns: expected the last 10 s of vitreo_now, found 3"),
        "{}",
        words()
    );
    assert!(words().ends_with(" s ahead"), "{}", words());
    assert_eq!(send(vitreo_now().saturating_sub(11 * S).max(1)), invalid);
    assert!(words().ends_with(" s ago"), "{}", words());
    assert_eq!(send(vitreo_now() + ipc::clock::realtime_offset_ns()), invalid, "CLOCK_REALTIME");
    // Exposed before it is sent; poses may be predicted.
    assert_eq!((send(vitreo_now() + S / 2), poses(vitreo_now() + S / 2)), (invalid, 0), "{}", words());
    assert_eq!(poses(vitreo_now() + 3_600 * S), invalid);
    assert!(words().starts_with("TrackerFrame.instants.exposed: "), "{}", words());
    let pedal = PedalState { instant_ns: vitreo_now() + 60 * S, ..bytemuck::Zeroable::zeroed() };
    // SAFETY: a block of its size.
    assert_eq!(unsafe { vitreo_send_pedal(driver, &pedal, size_of::<PedalState>()) }, invalid);
    let of_blobs = |beat: &Health| beat.process == Process::BlobsDriver as u32;
    until(&|beat| {
        of_blobs(beat)
            && beat.state == STATE_DEGRADED
            && beat.refused == 4
            && beat.sent == 0
            && beat.text().starts_with("test: BlobField.exposed_ns: expected the last 10 s")
    });
    assert_eq!(send(vitreo_now()), 0, "{}", words());
    until(&|beat| {
        of_blobs(beat) && beat.state == STATE_RUNNING && beat.refused == 4 && beat.text() == "test"
    });
    assert_eq!(vitreo_close(driver), 0);
}

#[test]
fn a_panic_ends_in_a_code() {
    assert_eq!(guarded(|| panic!("as planned")), Code::Defect as i32);
    assert!(words().contains("defect"));
}

#[test]
fn a_driver_is_a_process_of_the_run_and_obeys_it() {
    use protocol::control::{Answer, Command, Request};
    use protocol::health::{Process, STATE_DEGRADED, STATE_FINISHED};
    let (run, name) = run("heart");
    let mut health = run.receiver::<Health>(Queue::InOrder).unwrap();
    let mut answers = run.receiver::<Answer>(Queue::InOrder).unwrap();
    let mut requests = run.sender::<Request>().unwrap();
    let (code, driver) = open(&name, SENDS_BLOBS | SENDS_PEDAL);
    assert_eq!(code, 0, "{}", words());
    let mut until = |wanted: &dyn Fn(&Health) -> bool| wait_for(&mut health, wanted);
    until(&|beat| beat.process == Process::PedalDriver as u32 && beat.text() == "test");
    let pedal = bytemuck::Zeroable::zeroed();
    let text = CString::new("no power").unwrap();
    // SAFETY: a block of its size, and a text with its end.
    unsafe {
        assert_eq!(vitreo_send_pedal(driver, &pedal, size_of::<PedalState>()), 0);
        assert_eq!(vitreo_tell(driver, 1, text.as_ptr()), 0);
    }
    until(&|beat| beat.state == STATE_DEGRADED && beat.text() == "test: no power" && beat.sent == 1);
    assert_eq!(vitreo_finish(driver), 0);
    until(&|beat| beat.state == STATE_FINISHED && beat.process == Process::BlobsDriver as u32);
    let ask = |seq, target, command| Request { seq, argument: 0, target, command: command as u32 };
    requests.send(&ask(1, Process::PedalDriver as u32, Command::Ping)).unwrap();
    requests.send(&ask(2, Process::BlobsDriver as u32, Command::Shutdown)).unwrap();
    let mut seen = Vec::new();
    while seen.len() < 2 {
        ipc::wait(&[&answers], 100_000_000);
        seen.extend(std::iter::from_fn(|| answers.next_valid().unwrap()).map(|a| (a.seq, a.process)));
    }
    assert_eq!(seen, [(1, Process::PedalDriver as u32), (2, Process::BlobsDriver as u32)]);
    while vitreo_check(driver) == 0 {
        std::thread::yield_now();
    }
    assert_eq!(
        (vitreo_check(driver), words()),
        (Code::Stop as i32, "the run asks this program to end".into())
    );
    assert_eq!(vitreo_close(driver), 0);
}

#[test]
fn a_channel_takes_one_driver_at_a_time() {
    let (_run, name) = run("seat");
    let (code, first) = open(&name, SENDS_BLOBS | SENDS_PEDAL);
    assert_eq!(code, 0, "{}", words());
    for roles in [SENDS_PEDAL, SENDS_HANDLES | SENDS_BLOBS] {
        assert_eq!(open(&name, roles).0, Code::Taken as i32);
        assert!(words().contains("the driver 'test' (process"), "{}", words());
    }
    // What the refused one had taken is free again, and who only reads takes nothing.
    let others = [SENDS_HANDLES, READS_POSES, READS_POSES].map(|roles| open(&name, roles));
    assert!(others.iter().all(|(code, _)| *code == 0), "{others:?}: {}", words());
    assert_eq!(vitreo_close(first), 0);
    let (code, second) = open(&name, SENDS_BLOBS);
    assert_eq!(code, 0, "{}", words());
    others.iter().for_each(|(_, driver)| assert_eq!(vitreo_close(*driver), 0));
    assert_eq!(vitreo_close(second), 0);
}
