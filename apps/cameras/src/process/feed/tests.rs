//! Checks of one camera's fields.

use super::*;
use ipc::Bell;
use ipc::clock::now;
use settings::commands::cameras::Wanted;
use std::process::Command;
use std::sync::atomic::Ordering;

/// Grey levels of even and odd fields.
const LEVELS: [u8; 2] = [40, 50];

/// So many fields of a writer that begins with an even one.
fn clip(count: usize) -> Vec<u8> {
    let samples = 720 * 288;
    let field = |i: usize| [&b"FRAME\n"[..], &vec![LEVELS[i % 2]; samples], &vec![128; samples]].concat();
    [b"YUV4MPEG2 W720 H288 F50:1 Ip C422\n".to_vec(), (0..count).flat_map(field).collect()].concat()
}

/// Parity and grey level of each field that a pipe brings until its writer has closed it; the first one has `number`.
fn brought(feed: &mut Feed, number: u64) -> Vec<(u32, u8)> {
    let (mut clock, mut fields) = (None, Vec::new());
    while clock.is_none() || !feed.is_closed_pipe() {
        feed.listen(now());
        let first = feed.held.as_ref().map(|held| held.pictured.arrived_ns - number * feed.period_ns);
        clock = clock.or_else(|| first.map(|start_ns| feed.own_clock(start_ns)));
        let Some(clock) = clock else { continue };
        let due = feed.next(&clock).max(clock.read_out(number));
        let take = |field: &Field<'_>| {
            fields.push((field.header.parity, field.picture.luma[0]));
            Ok(())
        };
        feed.publish(&clock, 0, due, take).unwrap();
    }
    fields
}

#[test]
fn whoever_opens_a_pipe_begins_with_an_even_field_whatever_its_number() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pipe");
    assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
    let rig = Rig::load_or_shipped(None).unwrap();
    let (bell, stop) = (Bell::new().unwrap(), Arc::<AtomicBool>::default());
    let stream =
        Stream { kind: StreamKind::Y4m, path: path.clone(), parity: None, wanted: Wanted::default() };
    let mut feed = Feed::start(&rig, &rig.cameras()[0], &stream, bell.rope(), &stop, now()).unwrap();
    for number in [0, 10, 21, 33] {
        let path = path.clone();
        let writer = std::thread::spawn(move || std::fs::write(path, clip(3)).unwrap());
        let fields = brought(&mut feed, number);
        writer.join().unwrap();
        assert!(!fields.is_empty());
        for (parity, level) in fields {
            assert_eq!(level, LEVELS[parity as usize], "field {number}: parity {parity}");
        }
    }
    stop.store(true, Ordering::Relaxed);
}
