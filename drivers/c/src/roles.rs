//! What a driver sends and reads, as bits.

use crate::code::{Code, Failure, failure};
use protocol::health::Process;

/// Sends blobs: takes the place of cameras and camera hardware.
pub const SENDS_BLOBS: u32 = 1;
/// Sends fields of pixels: takes the place of cameras.
pub const SENDS_FIELDS: u32 = 2;
/// Sends what the handles of the instruments do.
pub const SENDS_HANDLES: u32 = 4;
/// Sends what the foot pedal does.
pub const SENDS_PEDAL: u32 = 8;
/// Sends poses: takes the place of cameras and tracker.
pub const SENDS_POSES: u32 = 16;
/// Reads poses.
pub const READS_POSES: u32 = 256;
/// Reads events.
pub const READS_EVENTS: u32 = 512;
/// Reads heartbeats.
pub const READS_HEALTH: u32 = 1024;

/// What can be sent, with the process of the run that does so.
pub(crate) const SENDERS: [(u32, Process); 5] = [
    (SENDS_BLOBS, Process::BlobsDriver),
    (SENDS_FIELDS, Process::FieldsDriver),
    (SENDS_HANDLES, Process::HandlesDriver),
    (SENDS_PEDAL, Process::PedalDriver),
    (SENDS_POSES, Process::PosesDriver),
];
const READS: u32 = READS_POSES | READS_EVENTS | READS_HEALTH;

/// The processes of the run that a driver with these bits is.
pub(crate) fn processes(roles: u32) -> impl Iterator<Item = Process> {
    SENDERS.into_iter().filter(move |(bit, _)| roles & bit != 0).map(|(_, process)| process)
}

/// Refuses unknown bits, and a value of 0.
pub(crate) fn check(roles: u32) -> Result<(), Failure> {
    let known = SENDERS.iter().fold(READS, |bits, (bit, _)| bits | bit);
    let refused = |problem: String| Err(failure(Code::Argument, format!("roles {roles:#x}: {problem}")));
    match (roles, roles & !known) {
        (0, _) => refused("expected one or more of VITREO_SENDS_… and VITREO_READS_…".into()),
        (_, 0) => Ok(()),
        (_, unknown) => refused(format!("bits {unknown:#x} are unknown to this library")),
    }
}
