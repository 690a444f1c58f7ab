//! Instants. Code that computes takes them as arguments; the clock is in the crate `ipc`.

use bytemuck::{Pod, Zeroable};

/// Nanoseconds of `CLOCK_MONOTONIC`. Zero means "not yet".
pub type Nanos = u64;

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
