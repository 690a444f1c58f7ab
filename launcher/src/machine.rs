//! What machine this is, as far as reports and `vitreo doctor` need it.

use serde::Serialize;
use std::fs::read_to_string;

/// The machine.
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

/// The value of a line `key : value` of a file in /proc.
fn value_of<'t>(text: &'t str, key: &str) -> Option<&'t str> {
    let lines = text.lines().filter_map(|l| l.split_once(':'));
    let mut found = lines.filter(|(k, _)| k.trim() == key);
    found.next().map(|(_, v)| v.trim())
}

/// Size in MiB of a line such as `MemTotal: 123 kB`.
fn mib_of(meminfo: &str, key: &str) -> Option<u64> {
    let kib = value_of(meminfo, key)?.split_whitespace().next()?;
    kib.parse::<u64>().ok().map(|k| k / 1024)
}

impl Machine {
    /// Reads what this machine is. What cannot be read is "unknown" or 0.
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

/// True if a graphical display can be reached.
pub fn has_display() -> bool {
    ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|v| std::env::var_os(v).is_some_and(|t| !t.is_empty()))
}

#[cfg(test)]
mod tests {
    use super::*;

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
