//! Pedals as pipes and recorded files.

use super::*;
use crate::events::{ABS, KEY};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

const MS: u64 = 1_000_000;

fn event(ms: i64, kind: u16, code: u16, value: i32) -> [u8; 24] {
    Event { at_us: ms * 1_000, kind, code, value }.to_bytes()
}

fn device(interface: PedalInterface, path: &Path, mapping: &str) -> PedalDevice {
    let spec = PedalSpec { interface, path: path.to_owned(), mapping: Some(mapping.into()) };
    PedalDevice::new(&spec, Some(Mapping::load(mapping).unwrap()), true)
}

fn pipe(folder: &tempfile::TempDir) -> PathBuf {
    let path = folder.path().join("p");
    assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
    path
}

fn write(file: &mut File, blocks: &[[u8; 24]]) {
    file.write_all(&blocks.concat()).unwrap();
}

#[test]
fn a_pipe_of_events_is_a_pedal_until_its_writer_is_gone() {
    let folder = tempfile::tempdir().unwrap();
    let path = pipe(&folder);
    let mut pedal = device(PedalInterface::Evdev, &path, "keyboard-switch");
    assert_eq!(pedal.open_if_due(0), Ok(true));
    let mut writer = OpenOptions::new().write(true).open(&path).unwrap();
    write(&mut writer, &[event(5, KEY, 30, 1), event(5, 0, 0, 0), event(9, KEY, 46, 1)]);
    writer.write_all(&event(10, KEY, 30, 0)[..7]).unwrap();
    assert!(!pedal.take(0, None));
    assert_eq!((pedal.taken, pedal.inputs.get(Input::Key(30))), (2, Some(1)));
    drop(writer);
    assert!(pedal.take(0, None) && !pedal.is_there());
    assert_eq!(pedal.open_if_due(Nanos::MAX), Ok(true));
    assert_eq!(
        (pedal.bad, pedal.inputs.get(Input::Key(30))),
        (1, None),
        "half an event, and nothing is held"
    );
}

#[test]
fn a_recorded_file_is_played_with_its_spacing_from_the_beginning_of_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r");
    let mut file = File::create(&path).unwrap();
    write(&mut file, &[event(1_000, KEY, 30, 1), event(1_020, KEY, 30, 0), event(1_050, KEY, 48, 1)]);
    let mut pedal = device(PedalInterface::Evdev, &path, "keyboard-switch");
    assert_eq!(pedal.open_if_due(0), Ok(true));
    let mut at = |ms, from| {
        let gone = pedal.take(ms * MS, from);
        (gone, pedal.taken, pedal.is_there())
    };
    assert_eq!(at(100, None), (false, 0, true));
    assert_eq!(at(200, Some(200 * MS)), (false, 1, true));
    assert_eq!(at(219, Some(999)), (false, 1, true), "the first beginning counts");
    assert_eq!(at(220, Some(200 * MS)), (false, 2, true));
    assert_eq!(at(250, Some(200 * MS)), (false, 3, false));
    assert_eq!(pedal.open_if_due(Nanos::MAX), Ok(false), "it is over");
}

#[test]
fn reports_are_cut_by_their_length() {
    let folder = tempfile::tempdir().unwrap();
    let path = pipe(&folder);
    let mut pedal = device(PedalInterface::Hidraw, &path, "three-pedals");
    assert_eq!(pedal.open_if_due(0), Ok(true));
    let mut writer = OpenOptions::new().write(true).open(&path).unwrap();
    writer.write_all(&[1, 0, 0, 0, 4, 0, 2]).unwrap();
    pedal.take(0, None);
    assert_eq!((pedal.taken, pedal.inputs.report()), (3, &[4, 0][..]));
    writer.write_all(&[9]).unwrap();
    pedal.take(0, None);
    assert_eq!(pedal.inputs.report(), [2, 9]);
}

#[test]
fn what_cannot_be_a_pedal_is_refused_in_words() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("f");
    File::create(&path).unwrap();
    let told =
        |interface, path: &Path, mapping: &str| device(interface, path, mapping).open_if_due(0).unwrap_err();
    assert!(told(PedalInterface::Hidraw, &path, "three-pedals").contains("write it into a pipe"));
    assert!(told(PedalInterface::Evdev, &path, "analogue").contains("reports no range of ABS_Z"));
    assert!(told(PedalInterface::Evdev, Path::new("/dev/null"), "analogue").contains("not an input device"));
    let spec = PedalSpec { interface: PedalInterface::Evdev, path, mapping: None };
    assert!(PedalDevice::new(&spec, None, true).open_if_due(0).unwrap_err().contains("give a mapping"));
    assert_eq!(PedalDevice::new(&spec, None, false).open_if_due(0), Ok(true), "to be looked at");
}

#[test]
fn lost_events_make_a_device_be_asked_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = pipe(&folder);
    let mut pedal = device(PedalInterface::Evdev, &path, "keyboard-switch");
    pedal.open_if_due(0).unwrap();
    let mut writer = OpenOptions::new().write(true).open(&path).unwrap();
    write(&mut writer, &[event(0, KEY, 30, 1), event(1, SYN, SYN_DROPPED, 0)]);
    assert!(!pedal.take(0, None), "it is not gone");
    assert_eq!((pedal.open_if_due(0), pedal.bad), (Ok(true), 1));
    assert_eq!(pedal.inputs.get(Input::Key(30)), None);
    write(&mut writer, &[event(2, KEY, 30, 1), event(2, ABS, 0, 1)]);
    pedal.take(0, None);
    assert_eq!(pedal.inputs.get(Input::Key(30)), Some(1));
}
