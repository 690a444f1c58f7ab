//! Clients that read, that do not, and that speak another language. Time is an argument.

use super::*;
use crate::transforms::Writer;
use bytemuck::Zeroable;
use protocol::poses::TrackerFrame;

/// Frames that together are larger than all buffers between two programs.
const LARGE: usize = 256 << 10;
const FRAMES: usize = 40;
const MS: u64 = 1_000_000;

fn listening(clients: usize) -> (Clients, Vec<TcpStream>) {
    let (mut all, address) = Clients::listen(&"0".parse().unwrap()).unwrap();
    let streams: Vec<TcpStream> = (0..clients).map(|_| TcpStream::connect(address).unwrap()).collect();
    while all.count() < clients.min(CLIENTS) {
        serve(&mut all, 0);
    }
    (all, streams)
}

/// Waits until somebody wants something, and serves.
fn serve(clients: &mut Clients, now: Nanos) {
    ipc::wait_beside(&[], &[clients.wants()], 1_000 * MS);
    clients.serve(now);
}

#[test]
fn a_frame_of_six_transforms_is_one_write_for_each_client() {
    const FRAMES: u64 = 200;
    let (mut clients, mut streams) = listening(2);
    let (mut writer, mut bytes) = (Writer::new(3), Vec::new());
    for field in 0..FRAMES {
        bytes.clear();
        let frame = TrackerFrame { field, ..TrackerFrame::zeroed() };
        writer.frame(&frame, 0, &mut bytes).unwrap();
        clients.send(&bytes, field);
        let mut heard = vec![0; bytes.len()];
        for stream in &mut streams {
            stream.read_exact(&mut heard).unwrap();
            assert!(heard == bytes, "frame {field} came as it was written");
        }
    }
    for client in clients.clients.values() {
        assert_eq!((client.sent, client.writes, client.missed), (FRAMES, FRAMES, 0));
    }
}

#[test]
fn one_that_does_not_read_is_closed_and_delays_no_other() {
    let (mut clients, mut streams) = listening(2);
    let mut reader = streams.pop().unwrap();
    let reading = std::thread::spawn(move || {
        let mut frame = vec![0; LARGE];
        for i in 0..FRAMES {
            reader.read_exact(&mut frame).unwrap();
            assert_eq!([frame[0], frame[LARGE - 1]], [i as u8; 2]);
        }
        reader
    });
    for i in 0..FRAMES {
        clients.send(&vec![i as u8; LARGE], MS);
    }
    while !reading.is_finished() {
        clients.serve(2 * MS);
    }
    let mut reader = reading.join().unwrap();
    assert_eq!(clients.count(), 2, "not yet");
    // Buffers take some more, and are full in the end.
    for i in 1.. {
        clients.serve(2 * MS + i * (PATIENCE_NS + MS));
        if clients.count() < 2 {
            break;
        }
    }
    assert_eq!(clients.count(), 1, "the one that reads is still there");
    clients.send(&[7], 0);
    let mut byte = [0];
    reader.read_exact(&mut byte).unwrap();
    assert_eq!(byte, [7]);
}

#[test]
fn a_slow_one_misses_whole_frames_and_never_a_part() {
    let (mut clients, mut streams) = listening(1);
    let total = 2 * WAITING;
    for i in 0..total {
        clients.send(&vec![i as u8; LARGE / 16], MS);
    }
    let mut stream = streams.pop().unwrap();
    let reading = std::thread::spawn(move || {
        let (mut frame, mut heard) = (vec![0; LARGE / 16], Vec::new());
        while heard.last() != Some(&((total - 1) as u8)) || heard.len() < WAITING {
            stream.read_exact(&mut frame).unwrap();
            assert!(frame.iter().all(|b| *b == frame[0]), "parts of two frames");
            heard.push(frame[0]);
        }
        // Not closed here: a client that is gone is not there to be asked.
        (heard.len() as u64, stream)
    });
    while !reading.is_finished() {
        clients.serve(2 * MS);
    }
    let (heard, _open) = reading.join().unwrap();
    let (_, client) = clients.clients.first_key_value().unwrap();
    assert_eq!((client.sent, client.sent + client.missed), (heard, total as u64));
    assert!(client.missed > 0);
}

#[test]
fn more_than_there_is_room_for_are_turned_away_and_a_place_becomes_free() {
    let (mut clients, mut streams) = listening(CLIENTS + 1);
    let mut last = streams.pop().unwrap();
    last.set_nonblocking(true).unwrap();
    // An end, or a reset.
    while last.read(&mut [0]).is_err_and(|e| e.kind() == ErrorKind::WouldBlock) {
        clients.serve(0);
    }
    assert_eq!(clients.count(), CLIENTS);
    streams.pop();
    while clients.count() == CLIENTS {
        serve(&mut clients, 0);
    }
    let _next = TcpStream::connect(clients.listener.local_addr().unwrap()).unwrap();
    while clients.count() < CLIENTS {
        serve(&mut clients, 0);
    }
    clients.end();
    assert_eq!(clients.count(), 0);
}

#[test]
fn one_that_speaks_another_language_is_closed() {
    let (mut clients, mut streams) = listening(1);
    streams[0].write_all(&b"GET / HTTP/1.1\r\n".repeat(8)).unwrap();
    while clients.count() > 0 {
        serve(&mut clients, 0);
    }
}
