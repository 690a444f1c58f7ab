//! Tests with a complete rig, and with rigs that lack one part each.

use super::*;
use crate::doctor::State;
use std::fs;

/// The checks of a machine with these settings.
fn said(settings: &str, display: bool) -> Vec<Check> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("vitreo.toml");
    fs::write(&file, settings).unwrap();
    let files = Files { paths: vec![file], log_variable: false, passed_over: None };
    match run_of_settings(&files) {
        Ok(run) => checks_of(&run, display, &Screen::default()),
        Err(problem) => vec![Check::fail("settings", problem, "-")],
    }
}

fn of<'c>(checks: &'c [Check], name: &str) -> Vec<&'c Check> {
    checks.iter().filter(|check| check.name.starts_with(name)).collect()
}

/// Settings of the shipped rig with a file in place of each device.
fn whole(folder: &Path) -> String {
    let rig = folder.join("rig.json");
    fs::write(&rig, include_str!("../../../../../assets/rig.json")).unwrap();
    let device = |name: &str| {
        let path = folder.join(name);
        fs::write(&path, "").unwrap();
        path.display().to_string()
    };
    let cameras = ["a", "b", "c"].map(|name| format!("y4m:{}", device(name))).join(",");
    let (pedal, rig) = (device("pedal"), rig.display());
    format!("[run]\nrig = \"{rig}\"\ncameras = \"{cameras}\"\npedal = \"evdev:{pedal}\"\n")
}

#[test]
fn a_rig_that_is_there_is_found_so() {
    let folder = tempfile::tempdir().unwrap();
    let checks = said(&whole(folder.path()), true);
    let told = |name: &str| of(&checks, name).iter().map(|c| c.state).collect::<Vec<_>>();
    assert_eq!(told("rig file"), [State::Ok], "{checks:?}");
    assert_eq!(told("cameras"), [State::Ok; 3], "{checks:?}");
    assert_eq!((told("pedal"), told("picture")), (vec![State::Ok], vec![State::Ok]), "{checks:?}");
    assert_eq!(told("handles"), [State::Warn], "none are set");
}

#[test]
fn a_machine_without_settings_is_told_each_of_them() {
    let checks = said("", false);
    let states: Vec<State> = checks.iter().map(|c| c.state).collect();
    assert_eq!(states, [State::Fail, State::Fail, State::Warn, State::Warn, State::Warn], "{checks:?}");
    assert!(checks.iter().all(|c| c.mend.is_some()));
    assert!(of(&checks, "cameras")[0].mend.as_ref().unwrap().contains("/etc/vitreo/vitreo.toml"));
}

#[test]
fn what_is_missing_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let settings = whole(folder.path());
    fs::remove_file(folder.path().join("b")).unwrap();
    let checks = said(&settings, true);
    let lost = of(&checks, "cameras")[1];
    assert!(lost.state == State::Fail && lost.found.ends_with("/b does not exist"), "{lost:?}");
    let two = settings.replace(&format!(",y4m:{}", folder.path().join("c").display()), "");
    let told = said(&two, true);
    assert!(of(&told, "cameras").last().unwrap().found.contains("2 are set, the rig has 3"), "{told:?}");
    let serial = format!("{settings}handles = \"serial:{}\"\n", folder.path().join("a").display());
    let told = said(&serial, true);
    assert!(of(&told, "handles")[0].found.contains("no calibration of the jaws"), "{told:?}");
    fs::write(folder.path().join("rig.json"), "{").unwrap();
    assert_eq!(of(&said(&settings, true), "rig file")[0].state, State::Fail);
    assert_eq!(of(&said(&format!("{settings}window = true\n"), false), "picture")[0].state, State::Fail);
    assert_eq!(said("[run]\nduration = \"long\"\n", true)[0].name, "settings");
}

#[test]
fn the_display_of_the_machine_is_found_and_what_it_lacks_is_named() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(connected(&folder.path().join("none")), None);
    for (name, status) in
        [("card0", None), ("card0-DP-1", Some("disconnected\n")), ("card0-HDMI-A-1", Some("connected\n"))]
    {
        fs::create_dir(folder.path().join(name)).unwrap();
        status.into_iter().for_each(|text| fs::write(folder.path().join(name).join("status"), text).unwrap());
    }
    let found = connected(folder.path());
    assert_eq!(found.as_deref(), Some("card0-HDMI-A-1"));
    let with = |connected: &Option<String>, has_cage| {
        on_the_machine("picture", &Screen { connected: connected.clone(), has_cage })
    };
    let [whole, bare, none] = [with(&found, true), with(&found, false), with(&None, true)];
    assert!(whole.state == State::Ok && whole.found.contains("card0-HDMI-A-1"), "{whole:?}");
    assert!(bare.state == State::Warn && bare.mend.unwrap().contains("install cage"), "{}", bare.found);
    assert!(none.state == State::Warn && none.found.contains("none is connected"), "{none:?}");
}
