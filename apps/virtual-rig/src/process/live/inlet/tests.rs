//! Tests of pipes, ports and standard input.

use super::*;
use std::process::Command;

/// What comes until something other than nothing does, or the watchdog's time has passed.
fn next(inlet: &mut Inlet) -> String {
    for _ in 0..20_000 {
        let got = format!("{:?}", inlet.next(false).unwrap());
        if got != "Nothing" {
            return got;
        }
        inlet.rest(|files| {
            let mut fds: Vec<_> = files.iter().map(|f| PollFd::from_borrowed_fd(*f, PollFlags::IN)).collect();
            let _ = poll(&mut fds, Some(&Timespec { tv_sec: 0, tv_nsec: 5_000_000 }));
        });
    }
    panic!("nothing came");
}

fn bytes(text: &str) -> String {
    format!("{:?}", Got::Bytes(text.as_bytes()))
}

#[test]
fn a_fifo_is_opened_again_for_every_writer() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fifo");
    assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
    let mut inlet = Inlet::open(&BlobSource::of(&path).unwrap()).unwrap();
    assert!(inlet.name().starts_with("FIFO ") && inlet.name().ends_with("/fifo"), "{}", inlet.name());
    assert!(matches!(inlet.next(false).unwrap(), Got::Nothing), "no writer is waited for");
    for text in ["one\n", "two\n"] {
        let mut writer = File::options().write(true).open(&path).unwrap();
        writer.write_all(text.as_bytes()).unwrap();
        assert_eq!([next(&mut inlet), next(&mut inlet)], ["Came".to_owned(), bytes(text)]);
        assert!(inlet.has_writer());
        drop(writer);
        assert_eq!(next(&mut inlet), "Gone");
    }
    // A writer that sends nothing is not reported, and wakes no thread.
    drop(File::options().write(true).open(&path).unwrap());
    (0..3).for_each(|_| assert!(matches!(inlet.next(false).unwrap(), Got::Nothing)));
    inlet.rest(|files| assert_eq!(state(files[0]).unwrap(), (false, false)));
}

#[test]
fn a_port_hears_one_writer_at_a_time_and_says_so() {
    let mut inlet = Inlet::open(&BlobSource::of(Path::new("tcp:0")).unwrap()).unwrap();
    let address = inlet.name().strip_prefix("tcp:").unwrap().to_owned();
    assert!(!address.ends_with(":0"), "the port is named");
    let taken = Inlet::open(&BlobSource::Tcp(address.clone())).unwrap_err();
    assert!(format!("{taken:#}").contains(&address), "{taken:#}");
    let mut first = TcpStream::connect(&address).unwrap();
    assert_eq!(next(&mut inlet), "Came");
    let mut second = TcpStream::connect(&address).unwrap();
    assert!(next(&mut inlet).starts_with("TurnedAway"));
    let mut told = String::new();
    second.read_to_string(&mut told).unwrap();
    assert_eq!(told.as_bytes(), BUSY);
    first.write_all(b"one\n").unwrap();
    assert_eq!(next(&mut inlet), bytes("one\n"));
    drop(first);
    assert_eq!(next(&mut inlet), "Gone");
    let mut third = TcpStream::connect(&address).unwrap();
    third.write_all(b"three").unwrap();
    assert_eq!([next(&mut inlet), next(&mut inlet)], ["Came".to_owned(), bytes("three")]);
}

#[test]
fn a_connection_that_is_dead_gives_way() {
    let mut inlet = Inlet::open(&BlobSource::of(Path::new("tcp:0")).unwrap()).unwrap();
    let address = inlet.name().strip_prefix("tcp:").unwrap().to_owned();
    let _dead = TcpStream::connect(&address).unwrap();
    assert_eq!(next(&mut inlet), "Came");
    assert!(matches!(inlet.next(true).unwrap(), Got::Nothing), "no other client is connected");
    let _other = TcpStream::connect(&address).unwrap();
    let mut got = Vec::new();
    for _ in 0..20_000 {
        let next = format!("{:?}", inlet.next(got.is_empty()).unwrap());
        if next != "Nothing" {
            got.push(next);
        }
        if got.len() == 2 {
            break;
        }
        inlet.rest(|files| {
            let mut fds = [PollFd::from_borrowed_fd(files[0], PollFlags::IN)];
            let _ = poll(&mut fds, Some(&Timespec { tv_sec: 0, tv_nsec: 5_000_000 }));
        });
    }
    assert_eq!(got, ["Gone", "Came"]);
}

#[test]
fn the_end_of_a_pipe_without_a_name_is_the_end() {
    let (reader, mut writer) = std::io::pipe().unwrap();
    let path = format!("/proc/self/fd/{}", std::os::fd::AsRawFd::as_raw_fd(&reader));
    let mut inlet = Inlet::open(&BlobSource::Path(path.into())).unwrap();
    writer.write_all(b"one\n").unwrap();
    assert_eq!([next(&mut inlet), next(&mut inlet)], ["Came".to_owned(), bytes("one\n")]);
    drop(writer);
    assert_eq!(next(&mut inlet), "Ended");
    assert!(matches!(inlet.next(false).unwrap(), Got::Nothing));
}
