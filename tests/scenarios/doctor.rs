//! `vitreo doctor` on a machine on which a process runs by hand.

use ipc::clock::now;
use ipc::{Instance, instance_directory, shared_memory_prefix};
use std::path::Path;
use std::process::{Command, Stdio};
use vitreo_tests::{WATCHDOG, binaries, instance_name, kill, vitreo};

/// What is found of leftovers, and what is offered for them.
fn leftovers() -> (String, String) {
    // Something else may be amiss on this machine.
    let told = vitreo(&["doctor", "--json"]).stdout;
    let checks: Vec<serde_json::Value> = serde_json::from_str(&told).expect("JSON");
    let check = checks.iter().find(|c| c["name"] == "leftovers").expect("the check");
    let text = |key: &str| check[key].as_str().unwrap_or_default().to_owned();
    (text("found"), text("mend"))
}

#[test]
fn the_directory_of_a_process_run_by_hand_is_not_offered_for_removal() {
    let name = instance_name();
    let directory = instance_directory(&name).expect("a name").display().to_string();
    let mut simulation = Command::new(binaries().join("vitreo-simcore"));
    let simulation = simulation.args(["--instance", &name]).stdout(Stdio::null()).stderr(Stdio::null());
    let mut simulation = simulation.spawn().expect("the simulation starts");
    let in_use = format!("{directory} is in use by {} vitreo-simcore", simulation.id());
    // Nothing of the instance is opened here: processes that other tests start would inherit it.
    let deadline = now() + WATCHDOG.as_nanos() as u64;
    let mend = loop {
        let (found, mend) = leftovers();
        if found.contains(&in_use) {
            break mend;
        }
        assert!(now() < deadline, "not in use: {found}");
    };
    kill(simulation.id());
    simulation.wait().expect("it has ended");
    assert!(!mend.contains(&directory), "{mend}");
    let (_, mend) = leftovers();
    let shared = shared_memory_prefix(Path::new(&directory)).map(|p| p.display().to_string());
    assert!(mend.contains(&directory), "nobody uses it any more: {mend}");
    assert!(mend.contains(&shared.unwrap_or_default()), "nor its memory: {mend}");
    drop(Instance::own(&name).expect("an owner clears up"));
}
