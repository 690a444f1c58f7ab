//! `frames` and `pictures`: the displayed frames and their instants.

use crate::message::{Invalid, Message, require};
use crate::time::{Instants, Nanos};
use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};

/// `displayed` is an estimate, because the display server did not say when it showed the picture.
pub const DISPLAY_ESTIMATED: u32 = 1;
/// The quality governor changed the tier with this frame.
pub const TIER_CHANGED: u32 = 2;
/// A body was not tracked and was drawn faded.
pub const TRACKING_LOST_SHOWN: u32 = 4;
/// The machine could not hold the least picture to train with (2×320×256 with shadows): this frame
/// breaks the rendering budget, however quickly it was drawn.
pub const BELOW_FLOOR: u32 = 8;
/// `drawn` comes from the graphics device's own clock.
pub const DEVICE_CLOCK: u32 = 16;
/// No new scene had come for a while, and the picture said so.
pub const PICTURE_HELD: u32 = 32;
/// `displayed` is the display server's word: when the picture began to be shown.
pub const DISPLAY_REPORTED: u32 = 64;
/// The flags carry a [`TierReason`] from this bit on, four bits wide.
const REASON_SHIFT: u32 = 8;

/// Reason for the renderer's quality tier.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum TierReason {
    /// Not recorded, as by former versions.
    Unknown = 0,
    /// Where devices of this kind begin.
    Start = 1,
    /// Fixed on the command line.
    Fixed = 2,
    /// Several of the last five frames were over the budget.
    Overload = 3,
    /// More than one frame in a hundred was over the budget or close to it.
    Slow = 4,
    /// Whole windows of frames left room for a better picture.
    Room = 5,
}

impl TierReason {
    /// The reason that a record's flags carry.
    pub fn of_flags(flags: u32) -> Self {
        use TierReason::{Fixed, Overload, Room, Slow, Start, Unknown};
        let code = flags >> REASON_SHIFT & 15;
        [Start, Fixed, Overload, Slow, Room].into_iter().find(|&r| r as u32 == code).unwrap_or(Unknown)
    }

    /// The bits that carry it in a record's flags.
    pub fn flags(self) -> u32 {
        (self as u32) << REASON_SHIFT
    }

    /// For people.
    pub fn text(self) -> &'static str {
        match self {
            TierReason::Unknown => "no reason given",
            TierReason::Start => "initial tier of such a device",
            TierReason::Fixed => "fixed by --tier",
            TierReason::Overload => "frames over the budget",
            TierReason::Slow => "more than one frame in a hundred at the budget",
            TierReason::Room => "room for a better picture",
        }
    }
}

/// Instants and figures of one displayed stereo frame.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct FrameRecord {
    /// Counts up by one since the renderer started.
    #[wire(tag = 1)]
    pub frame: u64,
    /// Field of the pose that was latched.
    #[wire(tag = 2)]
    pub field: u64,
    /// Field of the scene that was drawn.
    #[wire(tag = 3)]
    pub scene_field: u64,
    /// Instants of the latched pose (`stepped` is that of the scene drawn).
    #[wire(tag = 4)]
    pub instants: Instants,
    /// The renderer began with this frame.
    #[wire(tag = 5)]
    pub frame_start: Nanos,
    /// It took the newest pose.
    #[wire(tag = 6)]
    pub latched: Nanos,
    /// The GPU had finished.
    #[wire(tag = 7)]
    pub drawn: Nanos,
    /// When the display showed it, by its own word (`DISPLAY_REPORTED`) or estimated (`DISPLAY_ESTIMATED`); headless:
    /// picture complete.
    #[wire(tag = 8)]
    pub displayed: Nanos,
    /// Instant to which the poses were predicted.
    #[wire(tag = 9)]
    pub predicted_to: Nanos,
    /// Frames that could not be shown in time since the start.
    #[wire(tag = 10)]
    pub missed: u64,
    /// Quality tier, 0 is the best.
    #[wire(tag = 11)]
    pub tier: u32,
    /// Width of one channel, px.
    #[wire(tag = 12)]
    pub width_px: u32,
    /// Height of one channel, px.
    #[wire(tag = 13)]
    pub height_px: u32,
    /// Bits `DISPLAY_ESTIMATED`, `TIER_CHANGED`, `TRACKING_LOST_SHOWN`, `BELOW_FLOOR`,
    /// `DEVICE_CLOCK`, `PICTURE_HELD`, `DISPLAY_REPORTED`, and a [`TierReason`].
    #[wire(tag = 14)]
    pub flags: u32,
    /// Host's time of the calls that upload the tissue's vertices and triangles for this frame, ns;
    /// 0 in recordings of builds that did not measure it. The device copies later, within the frame.
    #[wire(tag = 15, columns = "")]
    pub transfer_ns: u64,
}

impl Message for FrameRecord {
    const CHANNEL: &'static str = "frames";
    /// 2: time of the transfer.
    const VERSION: u32 = 2;
    const QUEUE: usize = 512;

    fn validate(&self) -> Result<(), Invalid> {
        let ordered = self.frame_start <= self.drawn && self.drawn <= self.displayed;
        require(ordered, "FrameRecord", "drawn", "frame_start ≤ drawn ≤ displayed", self.drawn as f64)
    }
}

/// Header of a small picture of both channels side by side; the payload is a JPEG.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Wire, Zeroable)]
#[wire(name = "Picture")]
pub struct PictureHeader {
    /// Frame shown.
    #[wire(tag = 1)]
    pub frame: u64,
    /// Field shown.
    #[wire(tag = 2)]
    pub field: u64,
    /// When it was complete.
    #[wire(tag = 3)]
    pub displayed: Nanos,
    /// Bytes of the payload in use.
    #[wire(tag = 4, payload = "jpeg")]
    pub bytes: u64,
}

impl Message for PictureHeader {
    const CHANNEL: &'static str = "pictures";
    const VERSION: u32 = 1;
    const QUEUE: usize = 1;

    fn validate(&self) -> Result<(), Invalid> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_travel_beside_the_other_flags() {
        for reason in [TierReason::Start, TierReason::Overload, TierReason::Room] {
            let flags = BELOW_FLOOR | DISPLAY_ESTIMATED | reason.flags();
            assert_eq!(TierReason::of_flags(flags), reason);
            assert_eq!(flags & BELOW_FLOOR, BELOW_FLOOR);
        }
        assert_eq!(TierReason::of_flags(BELOW_FLOOR), TierReason::Unknown, "a record of before");
    }
}
