//! Handles and pedal as they are at one exposure.

use bytemuck::Zeroable;
use protocol::handles::{PedalState, Tool};
use protocol::limits::INSTRUMENTS;
use surgeon::motion::MotionSource;

/// Jaws, tools and pedal at one exposure.
#[derive(Debug, Clone, Copy)]
pub(super) struct ControlSample {
    /// When they are sent, ns after the start.
    pub(super) due_ns: u64,
    pub(super) field: u64,
    pub(super) jaw_rad: [f64; INSTRUMENTS],
    pub(super) tool: [Tool; INSTRUMENTS],
    /// Number and instant are set when it is sent.
    pub(super) pedal: PedalState,
}

impl ControlSample {
    /// The controls `t_ns` after the start.
    pub(super) fn at(surgeon: &mut MotionSource, t_ns: u64, field: u64, due_ns: u64) -> Self {
        let motion = surgeon.at(t_ns);
        let pedal = surgeon.pedal_at(t_ns, 0, 0);
        ControlSample { due_ns, field, jaw_rad: motion.jaw_rad, tool: motion.tool, pedal }
    }

    /// The controls at rest: the scene's first tools with open jaws, the pedal up.
    pub(super) fn at_rest(surgeon: &mut MotionSource, field: u64) -> Self {
        let tool = surgeon.at(0).tool;
        let pedal = PedalState::zeroed();
        ControlSample { due_ns: 0, field, jaw_rad: tool.map(Tool::open_rad), tool, pedal }
    }
}
