//! Instants. Pure code takes them as arguments; only process shells call [`now`].

use bytemuck::{Pod, Zeroable};

/// Nanoseconds of `CLOCK_MONOTONIC`. Zero means "not yet".
pub type Nanos = u64;

/// The present instant of `CLOCK_MONOTONIC`, ns. For process shells only.
pub fn now() -> Nanos {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
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

/// The instants a field passes on its way from the sensor to the end of the simulation step, ns.
///
/// Stamped once and carried unchanged by every later message; zero where not reached yet.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct Instants {
    /// Middle of the exposure of the reference camera.
    pub exposed: Nanos,
    /// Last line of the last used field left the sensor.
    pub read_out: Nanos,
    /// The last used field's blobs were sent.
    pub blobs_out: Nanos,
    /// The tracker had every blob it used for this frame (`tracked - taken` is tracking proper).
    pub taken: Nanos,
    /// The tracker published the poses.
    pub tracked: Nanos,
    /// The simulation finished the step.
    pub stepped: Nanos,
}
