//! Handles and pedal where there are none: the jaws are open and the pedal is up.

use anyhow::Result;
use bytemuck::Zeroable;
use ipc::{Instance, Sender};
use protocol::handles::{HandleState, PedalState, Tool};
use protocol::limits::INSTRUMENTS;
use protocol::time::Nanos;

/// Opening of forceps that nobody closes, rad: as at a desk.
const OPEN_RAD: f64 = 0.9;
/// The tools in the hands: forceps in the first, the light in the second.
const TOOLS: [Tool; INSTRUMENTS] = [Tool::Forceps, Tool::LightPipe];
/// Time between two messages of the pedal, ns.
const PEDAL_NS: u64 = 100_000_000;

/// The channels of handles and pedal.
pub(super) struct Controls {
    handles: Sender<HandleState>,
    pedal: Sender<PedalState>,
    /// When the handles are sent next.
    due_ns: Nanos,
    pedal_due_ns: Nanos,
}

impl Controls {
    pub(super) fn open(instance: &Instance) -> Result<Self> {
        Ok(Controls { handles: instance.sender()?, pedal: instance.sender()?, due_ns: 0, pedal_due_ns: 0 })
    }

    /// Blocks sent so far.
    pub(super) fn sent(&self) -> u64 {
        self.handles.sent() + self.pedal.sent()
    }

    /// Sends what is due, every `period_ns` with the number of the newest field.
    pub(super) fn send_due(&mut self, field: u64, period_ns: u64, now: Nanos) -> Result<()> {
        if now < self.due_ns {
            return Ok(());
        }
        self.due_ns = if self.due_ns + period_ns > now { self.due_ns } else { now } + period_ns;
        for (i, tool) in TOOLS.into_iter().enumerate() {
            let jaw_rad = if tool == Tool::Forceps { OPEN_RAD } else { 0.0 };
            let (seq, tool) = (self.handles.sent(), tool as u32);
            self.handles.send(&HandleState {
                seq,
                field,
                instant_ns: now,
                instrument: i as u32,
                tool,
                jaw_rad,
            })?;
        }
        if now >= self.pedal_due_ns {
            self.pedal_due_ns = now + PEDAL_NS;
            let seq = self.pedal.sent();
            self.pedal.send(&PedalState { seq, instant_ns: now, ..PedalState::zeroed() })?;
        }
        Ok(())
    }
}
