//! `CLOCK_MONOTONIC`. Only process shells read it; pure code takes instants as arguments.

use protocol::time::Nanos;

/// The present instant, ns.
pub fn now() -> Nanos {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}

/// `CLOCK_REALTIME` less `CLOCK_MONOTONIC` now, ns: what is added to an instant to get wall-clock time since
/// 1970. It changes where the wall clock is set.
pub fn realtime_offset_ns() -> u64 {
    let before = now();
    let t = rustix::time::clock_gettime(rustix::time::ClockId::Realtime);
    let between = before + (now() - before) / 2;
    (t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64).wrapping_sub(between)
}

/// Processor time that this process has used, ns.
pub fn cpu_ns() -> u64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}

/// Sleeps until the absolute instant `deadline_ns`; returns at once if it has passed.
pub fn sleep_until(deadline_ns: Nanos) {
    let at = rustix::time::Timespec {
        tv_sec: (deadline_ns / 1_000_000_000) as i64,
        tv_nsec: (deadline_ns % 1_000_000_000) as _,
    };
    while rustix::thread::clock_nanosleep_absolute(rustix::thread::ClockId::Monotonic, &at)
        == Err(rustix::io::Errno::INTR)
    {}
}
