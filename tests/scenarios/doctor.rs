//! `vitreo doctor` on a machine on which a process runs by hand.

use ipc::{Instance, instance_directory};
use protocol::health::Process;
use std::process::{Command, Stdio};
use vitreo_tests::{Observer, binaries, instance_name, kill, vitreo};

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
    let mut observer = Observer::join(&name);
    observer.health(Process::Simcore, |_| true);
    drop(observer);
    let (found, mend) = leftovers();
    kill(simulation.id());
    simulation.wait().expect("it has ended");
    let in_use = format!("{directory} is in use by {} vitreo-simcore", simulation.id());
    assert!(found.contains(&in_use), "{found}");
    assert!(!mend.contains(&directory), "{mend}");
    let (_, mend) = leftovers();
    assert!(mend.contains(&format!("{directory} /dev/shm/vitreo_")), "nobody uses it any more: {mend}");
    drop(Instance::own(&name).expect("an owner clears up"));
}
