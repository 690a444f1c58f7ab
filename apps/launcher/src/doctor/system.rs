//! Checks for processors, kernel, shared memory, scheduling, limits, terminal and programs.

use super::Check;
use crate::children::realtime_allowed;
use crate::machine::Machine;
use crate::programs::{BRIDGE, CALIBRATION, COMMISSION, REPLAY, STREAMS};
use ipc::programs;
use protocol::health::Process;
use rustix::process::{Resource, getrlimit};
use std::io::IsTerminal;

/// Free shared memory that a run needs, MiB.
const SHM_NEEDED_MIB: u64 = 96;
/// Free shared memory below which a second simulator or a checker may not fit, MiB.
const SHM_COMFORT_MIB: u64 = 256;
/// Lockable memory below which a warning is given, bytes.
const MEMLOCK: u64 = 64 << 20;

pub(super) fn checks() -> Vec<Check> {
    let machine = Machine::detect();
    let mut checks = vec![
        processors(machine.cpus, &machine.cpu),
        Check::ok("kernel", format!("{} on {}", machine.kernel, machine.architecture)),
        shared_memory(shm_mib()),
        realtime(realtime_allowed(), limit(Resource::Rtprio)),
        memory_lock(limit(Resource::Memlock)),
        terminal(std::io::stderr().is_terminal()),
    ];
    checks.extend(Process::ALL.map(|p| binary(p.binary())));
    checks.extend([STREAMS, CALIBRATION, COMMISSION, REPLAY, BRIDGE].map(binary));
    checks
}

fn processors(cpus: usize, name: &str) -> Check {
    let found = format!("{cpus} × {name}");
    match cpus {
        0 | 1 => Check::warn(
            "processors",
            found,
            "use a machine with two or more processors; all processes share this one",
        ),
        _ => Check::ok("processors", found),
    }
}

/// Size and free space of shared memory, MiB; `None` if it is missing.
fn shm_mib() -> Option<(u64, u64)> {
    let vfs = rustix::fs::statvfs("/dev/shm").ok()?;
    Some(((vfs.f_blocks * vfs.f_frsize) >> 20, (vfs.f_bavail * vfs.f_frsize) >> 20))
}

fn shared_memory(size_and_free_mib: Option<(u64, u64)>) -> Check {
    let name = "shared memory";
    let enlarge = "sudo mount -o remount,size=512M /dev/shm   (in a container: docker run --shm-size=512m)";
    match size_and_free_mib {
        None => Check::fail(name, "/dev/shm is absent", "sudo mount -t tmpfs -o size=512M tmpfs /dev/shm"),
        Some((size, free)) => {
            let found = format!("/dev/shm {size} MiB, {free} MiB free");
            match free {
                _ if free < SHM_NEEDED_MIB => Check::fail(name, found, enlarge),
                _ if free < SHM_COMFORT_MIB => Check::warn(name, found, enlarge),
                _ => Check::ok(name, found),
            }
        }
    }
}

/// The soft limit of a resource; `None` if unlimited.
fn limit(resource: Resource) -> Option<u64> {
    getrlimit(resource).current
}

fn realtime(allowed: bool, limit: Option<u64>) -> Check {
    let name = "real-time priority";
    if allowed {
        return Check::ok(name, "granted");
    }
    let limit =
        limit.map_or("unlimited, but not granted (is chrt installed?)".into(), |l| format!("limit {l}"));
    Check::warn(
        name,
        format!("{limit}: tracker and simulation share the processor like any program"),
        "sudo apt-get install util-linux; echo \"$USER - rtprio 50\" | sudo tee /etc/security/limits.d/vitreo.conf   (then log in again)",
    )
}

fn memory_lock(limit: Option<u64>) -> Check {
    let name = "lockable memory";
    match limit {
        Some(limit) if limit < MEMLOCK => Check::warn(
            name,
            format!("limit {} KiB", limit >> 10),
            "echo \"$USER - memlock 65536\" | sudo tee -a /etc/security/limits.d/vitreo.conf   (then log in again)",
        ),
        Some(limit) => Check::ok(name, format!("limit {} MiB", limit >> 20)),
        None => Check::ok(name, "unlimited"),
    }
}

fn terminal(is_terminal: bool) -> Check {
    let found = if is_terminal {
        "interactive: a run shows its status"
    } else {
        "not interactive: a run prints a status line every 10 s"
    };
    Check::ok("terminal", found)
}

fn binary(name: &'static str) -> Check {
    match programs::find(name) {
        Ok(path) => Check::ok(name, path.display().to_string()),
        Err(_) => Check::fail(name, "not found next to vitreo", "cargo build --release --workspace"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::State;

    #[test]
    fn shared_memory_is_judged_by_what_is_free() {
        assert_eq!(shared_memory(None).state, State::Fail);
        assert_eq!(shared_memory(Some((64, 60))).state, State::Fail);
        assert_eq!(shared_memory(Some((1024, 100))).state, State::Warn);
        assert_eq!(shared_memory(Some((1024, 1000))).state, State::Ok);
    }

    #[test]
    fn every_program_of_the_package_is_looked_for() {
        let names: Vec<&str> = checks().iter().map(|check| check.name).collect();
        let makefile = include_str!("../../../../Makefile").replace("\\\n", " ");
        let (_, listed) = makefile.split_once("INSTALLED = ").expect("the list");
        let listed = listed.lines().next().expect("a line");
        let programs = listed.split(|c: char| c.is_whitespace() || ",()".contains(c));
        for program in programs.filter(|word| word.starts_with("vitreo-")) {
            assert!(names.contains(&program), "{program}: {names:?}");
        }
    }

    #[test]
    fn limits_are_judged() {
        assert_eq!(realtime(false, Some(0)).state, State::Warn);
        assert_eq!(realtime(true, Some(0)).state, State::Ok, "root needs no limit");
        assert_eq!(memory_lock(Some(8 << 20)).state, State::Warn);
        assert_eq!(memory_lock(None).state, State::Ok);
        assert_eq!(processors(1, "x").state, State::Warn);
    }
}
