//! Every capacity and deadline that crosses a process border, with the relations between them.

/// Blobs carried by one camera-field; the rest is counted in `BlobField::blobs_left_out`.
pub const MAX_BLOBS: usize = 64;
/// Cameras a rig may have.
pub const MAX_CAMERAS: usize = 8;
/// Instruments in the eye.
pub const INSTRUMENTS: usize = 2;
/// Tracked bodies: two instruments, then the eye.
pub const BODIES: usize = INSTRUMENTS + 1;
/// Camera-fields that one tracker frame may consume.
pub const MAX_FIELDS_USED: usize = 16;
/// Tremor oscillators in a predictor's state.
pub const OSCILLATORS: usize = 2;
/// Markers on one body.
pub const MAX_MARKERS: usize = 16;

/// How long the tracker waits for a late camera after the first field of a frame arrived, ns.
pub const CAMERA_WAIT_NS: u64 = 3_000_000;
/// Period of a field of the shipped cameras, 50 Hz, ns; of any rig it is `Rig::field_period_ns`.
pub const FIELD_PERIOD_NS: u64 = 20_000_000;
/// Time that passes in the eye from one tick to the next, ns, whatever the cameras' rate: what is slow (the gel,
/// dye, light) moves, and what is judged over time (ways of tips, tremor, pulls that ebb) is looked at, once a tick.
/// It is the period of the shipped cameras, so that a step of theirs is a tick.
pub const TICK_NS: u64 = 20_000_000;
/// Substep of the simulation, ns.
pub const SUBSTEP_NS: u64 = 1_000_000;
/// Longest time a single step may advance; a longer gap is a pause, ns.
pub const MAX_STEP_NS: u64 = 200_000_000;
/// Longest time any process sleeps without looking at its queues, ms.
pub const MAX_WAIT_MS: u64 = 5;
/// Period of the heartbeat of each process, ns.
pub const HEARTBEAT_NS: u64 = 100_000_000;
/// A process without a heartbeat for this long is taken for hung, ns.
pub const HEARTBEAT_LOST_NS: u64 = 3_000_000_000;
/// Time between two checkpoints of the tracker, and the longest between two of the simulation, ns; which
/// frames that means is defined in [`crate::checkpoints`].
pub const CHECKPOINT_NS: u64 = 2_000_000_000;
/// Time spent on steps after which the simulation makes one earlier, ns: a restarted simulation makes the
/// steps again before it goes on.
pub const CHECKPOINT_WORK_NS: u64 = 100_000_000;
/// Shortest time between a checkpoint of the simulation and one that comes earlier, ns.
pub const CHECKPOINT_LEAST_NS: u64 = 500_000_000;

/// Largest scene block, bytes.
pub const MAX_SCENE_BYTES: usize = 4 << 20;
/// Largest checkpoint, bytes.
pub const MAX_CHECKPOINT_BYTES: usize = 4 << 20;
/// Largest picture block, bytes.
pub const MAX_PICTURE_BYTES: usize = 256 << 10;
/// Bytes of a text carried in a fixed block.
pub const TEXT_BYTES: usize = 112;

const _: () = assert!(CAMERA_WAIT_NS < FIELD_PERIOD_NS, "a frame must close before the next begins");
const _: () = assert!(MAX_FIELDS_USED >= MAX_CAMERAS, "a frame must hold a field of every camera");
const _: () = assert!(FIELD_PERIOD_NS.is_multiple_of(SUBSTEP_NS), "a regular step is whole substeps");
const _: () = assert!(TICK_NS.is_multiple_of(SUBSTEP_NS), "a tick is whole substeps");
const _: () =
    assert!(CHECKPOINT_LEAST_NS < CHECKPOINT_NS, "heavy steps are saved after more often than light ones");
const _: () = assert!(HEARTBEAT_LOST_NS > 10 * HEARTBEAT_NS);
const _: () = assert!(MAX_SCENE_BYTES.is_multiple_of(16) && MAX_PICTURE_BYTES.is_multiple_of(16));
