//! Description of this machine for reports and `vitreo doctor`.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use serde::Serialize;
use std::fs::read_to_string;

/// Maximum number of files that the launcher of a run has open: its ends of all channels, including those to
/// restarted processes. 250 were measured with a picture.
const OPEN_FILES: u64 = 384;

/// Description of a machine.
#[derive(Debug, Clone, Serialize)]
pub struct Machine {
    /// Logical processors this process may use.
    pub cpus: usize,
    /// Name of the processor.
    pub cpu: String,
    /// Operating system and kernel.
    pub kernel: String,
    /// Processor architecture this program was built for.
    pub architecture: &'static str,
    /// Main memory, MiB.
    pub memory_mib: u64,
}

/// Raises this process's limit of open files to what a run needs.
///
/// # Errors
/// If the system does not allow that many open files, or refuses the new limit.
pub fn allow_open_files() -> anyhow::Result<()> {
    let limit = getrlimit(Resource::Nofile);
    let Some(raised) = raised(limit.current, limit.maximum)? else { return Ok(()) };
    Ok(setrlimit(Resource::Nofile, Rlimit { current: Some(raised), ..limit })?)
}

/// The limit to set; `None` if it need not be raised. A limit of `None` is unlimited.
fn raised(current: Option<u64>, maximum: Option<u64>) -> anyhow::Result<Option<u64>> {
    if current.is_none_or(|current| current >= OPEN_FILES) {
        return Ok(None);
    }
    match maximum {
        Some(most) if most < OPEN_FILES => {
            anyhow::bail!("too few open files allowed: {most}, at least {OPEN_FILES} needed (ulimit -n)")
        }
        _ => Ok(Some(OPEN_FILES)),
    }
}

/// The value of a line `key : value` in a file of `/proc`.
fn value_of<'t>(text: &'t str, key: &str) -> Option<&'t str> {
    let lines = text.lines().filter_map(|l| l.split_once(':'));
    let mut found = lines.filter(|(k, _)| k.trim() == key);
    found.next().map(|(_, v)| v.trim())
}

/// Value in MiB of a line such as `MemTotal: 123 kB`.
fn mib_of(meminfo: &str, key: &str) -> Option<u64> {
    let kib = value_of(meminfo, key)?.split_whitespace().next()?;
    kib.parse::<u64>().ok().map(|k| k / 1024)
}

impl Machine {
    /// Describes this machine. Unreadable values are "unknown" or 0.
    pub fn detect() -> Self {
        let read = |path: &str| read_to_string(path).unwrap_or_default();
        let (cpuinfo, release) = (read("/proc/cpuinfo"), read("/proc/sys/kernel/osrelease"));
        let names = ["model name", "Model", "Hardware"];
        let cpu = names.iter().find_map(|k| value_of(&cpuinfo, k)).unwrap_or("unknown");
        Machine {
            cpus: std::thread::available_parallelism().map_or(1, |n| n.get()),
            cpu: cpu.into(),
            kernel: format!("{} {}", std::env::consts::OS, release.trim()),
            architecture: std::env::consts::ARCH,
            memory_mib: mib_of(&read("/proc/meminfo"), "MemTotal").unwrap_or(0),
        }
    }
}

/// True if a graphical display is configured in the environment.
pub fn has_display() -> bool {
    ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|v| std::env::var_os(v).is_some_and(|t| !t.is_empty()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_of_open_files_is_raised_or_told() {
        assert_eq!(raised(Some(1024), Some(4096)).unwrap(), None);
        assert_eq!(raised(None, None).unwrap(), None);
        assert_eq!(raised(Some(64), Some(4096)).unwrap(), Some(OPEN_FILES));
        assert_eq!(raised(Some(64), None).unwrap(), Some(OPEN_FILES));
        let told = raised(Some(64), Some(64)).unwrap_err().to_string();
        assert_eq!(told, "too few open files allowed: 64, at least 384 needed (ulimit -n)");
    }

    #[test]
    fn lines_of_proc_are_read() {
        let text = "processor\t: 0\nmodel name\t: Some CPU @ 2 GHz\nMemTotal:       2048 kB\n";
        assert_eq!(value_of(text, "model name"), Some("Some CPU @ 2 GHz"));
        assert_eq!(value_of(text, "absent"), None);
        assert_eq!(mib_of(text, "MemTotal"), Some(2));
        assert_eq!(mib_of("MemTotal: lots", "MemTotal"), None);
    }

    #[test]
    fn this_machine_has_a_processor_and_memory() {
        let machine = Machine::detect();
        assert!(machine.cpus >= 1 && machine.memory_mib > 0, "{machine:?}");
    }
}
