//! Instants. Code that computes takes them as arguments; the clock is in crate `ipc`.

use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};

/// Nanoseconds of `CLOCK_MONOTONIC`. Zero means "not yet".
pub type Nanos = u64;

/// The instants a field passes on its way from the sensor to the end of the simulation step, ns.
///
/// Stamped once and carried unchanged by every later message; zero where not reached yet.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Wire, Zeroable)]
pub struct Instants {
    /// Middle of the exposure of the reference camera.
    #[wire(tag = 1)]
    pub exposed: Nanos,
    /// Last line of the last used field left the sensor.
    #[wire(tag = 2)]
    pub read_out: Nanos,
    /// The last used field's blobs were sent.
    #[wire(tag = 3)]
    pub blobs_out: Nanos,
    /// The tracker had every blob it used for this frame (`tracked - taken` is tracking proper).
    #[wire(tag = 4)]
    pub taken: Nanos,
    /// The tracker published the poses.
    #[wire(tag = 5)]
    pub tracked: Nanos,
    /// The simulation finished the step.
    #[wire(tag = 6)]
    pub stepped: Nanos,
}
