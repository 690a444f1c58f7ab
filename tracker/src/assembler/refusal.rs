//! Reasons for refusing a field.

use protocol::time::Nanos;

/// Why a field was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// The rig has no such camera.
    #[error("camera {0} is not in the rig")]
    UnknownCamera(u32),
    /// The field is invalid.
    #[error("the field's numbers contradict each other")]
    Invalid,
    /// The same field again, or one older than this camera's last.
    #[error("camera {camera}: exposure {exposed_ns} ns is not after its last one, {last_ns} ns")]
    NotNewer {
        /// Camera id.
        camera: u32,
        /// Of the field refused.
        exposed_ns: Nanos,
        /// Of the last field taken.
        last_ns: Nanos,
    },
    /// A field where the rig says whole frames, or the other way round.
    #[error(
        "camera {camera}: parity {parity}; the rig's scan is {scan}: 0 and 1 are interlaced, 2 is progressive"
    )]
    OtherScan {
        /// Camera id.
        camera: u32,
        /// Of the field refused.
        parity: u32,
        /// As the rig says.
        scan: &'static str,
    },
    /// Exposed after it was received.
    #[error("camera {0}: exposed in the future")]
    FromTheFuture(u32),
}
