//! Output of the controls: handles and pedal.

use anyhow::Result;
use bytemuck::Zeroable;
use ipc::clock::now;
use ipc::{Instance, Sender};
use protocol::handles::{HandleState, PedalState, Tool};
use protocol::limits::INSTRUMENTS;
use surgeon::motion::MotionSource;

/// The pedal is sent when it changes, and at least so often, ns: 10 times a second.
const PEDAL_EVERY_NS: u64 = 100_000_000;

/// Jaws that hold nothing, rad: as scripted surgeons open them.
const OPEN_RAD: f64 = 0.5;

/// Jaws, tools and pedal at one exposure.
#[derive(Debug, Clone, Copy)]
pub(super) struct ControlSample {
    /// When they are sent, ns after the start.
    pub(super) due_ns: u64,
    field: u64,
    jaw_rad: [f64; INSTRUMENTS],
    tool: [Tool; INSTRUMENTS],
    /// Number and instant are set when it is sent.
    pedal: PedalState,
}

impl ControlSample {
    /// The controls `t_ns` after the start.
    pub(super) fn at(surgeon: &mut MotionSource, t_ns: u64, field: u64, due_ns: u64) -> Self {
        let motion = surgeon.at(t_ns);
        let pedal = surgeon.pedal_at(t_ns, 0, 0);
        ControlSample { due_ns, field, jaw_rad: motion.jaw_rad, tool: motion.tool, pedal }
    }

    /// The controls where nobody works them: the scene's first tools with open jaws, the pedal up.
    pub(super) fn at_rest(surgeon: &mut MotionSource, field: u64) -> Self {
        let tool = surgeon.at(0).tool;
        let pedal = PedalState::zeroed();
        ControlSample { due_ns: 0, field, jaw_rad: [OPEN_RAD; INSTRUMENTS], tool, pedal }
    }
}

/// The channels of handles and pedal.
pub(super) struct Controls {
    handles: Sender<HandleState>,
    pedal: Sender<PedalState>,
    /// When the pedal is next due, ns after the start.
    next_pedal_ns: u64,
    /// The pedal as sent last, without number and instant.
    last_pedal: PedalState,
}

impl Controls {
    pub(super) fn open(instance: &Instance) -> Result<Self> {
        let (handles, pedal) = (instance.sender()?, instance.sender()?);
        Ok(Controls { handles, pedal, next_pedal_ns: 0, last_pedal: PedalState::zeroed() })
    }

    /// Blocks sent so far.
    pub(super) fn sent(&self) -> u64 {
        self.handles.sent() + self.pedal.sent()
    }

    /// Sends the handles, and the pedal when it has changed or is due again.
    pub(super) fn send(&mut self, sample: &ControlSample) -> Result<()> {
        let instant_ns = now();
        for i in 0..INSTRUMENTS {
            self.handles.send(&HandleState {
                seq: self.handles.sent(),
                field: sample.field,
                instant_ns,
                instrument: i as u32,
                tool: sample.tool[i] as u32,
                jaw_rad: sample.jaw_rad[i],
            })?;
        }
        let changed = sample.pedal != self.last_pedal;
        if changed || sample.due_ns >= self.next_pedal_ns || sample.field == 0 {
            self.next_pedal_ns = sample.due_ns + PEDAL_EVERY_NS;
            self.last_pedal = sample.pedal;
            let seq = self.pedal.sent();
            self.pedal.send(&PedalState { seq, instant_ns, ..sample.pedal })?;
        }
        Ok(())
    }
}
