//! Checks for directories of simulators in shared memory that no launcher owns: left over from killed
//! simulators, or in use by processes that were started by hand.

use super::Check;
use ipc::shared_memory_prefix;
use std::fs;
use std::path::{Path, PathBuf};

pub(super) fn checks() -> Vec<Check> {
    vec![leftovers(Path::new("/dev/shm"))]
}

/// Directories of this user's simulators that no running launcher owns.
fn ownerless(shm: &Path) -> Vec<PathBuf> {
    let prefix = format!("vitreo-{}-", rustix::process::getuid().as_raw());
    let mine = |e: &fs::DirEntry| e.file_name().to_string_lossy().starts_with(&prefix);
    let entries = fs::read_dir(shm).into_iter().flatten().flatten().filter(mine).map(|e| e.path());
    entries.filter(|path| path.is_dir() && !is_owned(path)).collect()
}

/// True if a running launcher holds the directory's lock.
fn is_owned(directory: &Path) -> bool {
    let Ok(lock) = fs::File::open(directory.join("owner.lock")) else { return false };
    rustix::fs::flock(&lock, rustix::fs::FlockOperation::NonBlockingLockShared).is_err()
}

/// Processes, as id and program, that have a file of the instance open or mapped. Processes of other users
/// are not visible; they cannot use the instance.
fn users_of(directory: &Path) -> Vec<String> {
    let inside = format!("{}/", directory.display());
    let shared = shared_memory_prefix(directory).map(|p| p.display().to_string());
    let is_of_it = |text: &str| text.contains(&inside) || shared.as_ref().is_some_and(|s| text.contains(s));
    let uses = |process: &Path| {
        let open = fs::read_dir(process.join("fd")).into_iter().flatten().flatten();
        let mut open = open.filter_map(|e| fs::read_link(e.path()).ok());
        open.any(|file| is_of_it(&file.to_string_lossy()))
            || fs::read_to_string(process.join("maps")).is_ok_and(|maps| is_of_it(&maps))
    };
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    let processes = processes.filter(|e| e.file_name().to_string_lossy().parse::<u32>().is_ok());
    let mut users: Vec<String> = processes
        .filter(|e| uses(&e.path()))
        .map(|e| format!("{} {}", e.file_name().to_string_lossy(), program_of(&e.path())))
        .collect();
    users.sort();
    users
}

fn program_of(process: &Path) -> String {
    let program = fs::read_link(process.join("exe")).ok();
    let name = program.as_deref().and_then(Path::file_name).map(|n| n.to_string_lossy().into_owned());
    name.unwrap_or_else(|| "a process".into())
}

fn leftovers(shm: &Path) -> Check {
    let name = "leftovers";
    let (mut dead, mut used) = (Vec::new(), Vec::new());
    for directory in ownerless(shm) {
        let users = users_of(&directory);
        match users.is_empty() {
            true => dead.push(directory),
            false => used.push(format!("{} is in use by {}", directory.display(), users.join(", "))),
        }
    }
    let besides = if used.is_empty() { String::new() } else { format!("; {}", used.join("; ")) };
    if dead.is_empty() {
        return Check::ok(name, format!("none{besides}"));
    }
    let found: Vec<String> = dead.iter().map(|p| p.display().to_string()).collect();
    let found =
        format!("of simulators that were killed, or of processes run by hand: {}{besides}", found.join(", "));
    let remedy: Vec<String> = dead.iter().map(|p| remedy(p)).collect();
    Check::warn(name, found, format!("rm -rf {}", remedy.join(" ")))
}

/// Arguments for `rm`: the directory and its files in shared memory.
fn remedy(directory: &Path) -> String {
    let shared = shared_memory_prefix(directory).map(|p| format!(" {}*", p.display()));
    format!("{}{}", directory.display(), shared.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::State;
    use std::process::{Command, Stdio};

    fn directory(shm: &Path, name: &str) -> PathBuf {
        let path = shm.join(format!("vitreo-{}-{name}", rustix::process::getuid().as_raw()));
        fs::create_dir(&path).unwrap();
        fs::write(path.join("owner.lock"), "").unwrap();
        path
    }

    #[test]
    fn directories_without_an_owner_are_found() {
        let shm = tempfile::tempdir().unwrap();
        let [dead, alive] = ["dead", "alive"].map(|n| directory(shm.path(), n));
        let lock = fs::File::open(alive.join("owner.lock")).unwrap();
        rustix::fs::flock(&lock, rustix::fs::FlockOperation::NonBlockingLockExclusive).unwrap();
        assert_eq!(ownerless(shm.path()), std::slice::from_ref(&dead));
        let check = leftovers(shm.path());
        assert!(check.mend.unwrap().contains(&dead.display().to_string()));
    }

    #[test]
    fn what_a_running_process_uses_is_not_to_be_removed() {
        let shm = tempfile::tempdir().unwrap();
        let [used, _] = ["used", "use"].map(|n| directory(shm.path(), n));
        let lock = fs::File::open(used.join("owner.lock")).unwrap();
        // The process runs until it is killed below.
        let null = Stdio::null();
        let mut user =
            Command::new("tail").args(["-f", "/dev/null"]).stdin(lock).stdout(null).spawn().unwrap();
        let check = leftovers(shm.path());
        let (pid, mend) = (user.id(), check.mend.clone().unwrap());
        user.kill().and_then(|()| user.wait().map(drop)).unwrap();
        assert!(check.found.contains(&format!("-used is in use by {pid} ")), "{check:?}");
        assert!(mend.ends_with("-use"), "{mend}");
        let check = leftovers(shm.path());
        assert_eq!(check.state, State::Warn);
        assert!(check.mend.unwrap().contains("-used"), "its user has ended");
    }
}
