//! Handles and pedal where nothing is connected: the scene's tools with open jaws, and the pedal up.

use anyhow::{Context, Result};
use bytemuck::Zeroable;
use ipc::{ControlSender, Instance};
use protocol::handles::{PedalState, Tool};
use protocol::limits::INSTRUMENTS;
use protocol::time::Nanos;
use scene::{DEFAULT_SCENE, SceneFile};

/// The channels of handles and pedal.
pub(super) struct Controls {
    sender: ControlSender,
    tools: [Tool; INSTRUMENTS],
    /// When they are sent next.
    due_ns: Nanos,
}

impl Controls {
    pub(super) fn open(instance: &Instance, config: &crate::config::Config) -> Result<Self> {
        let scene = SceneFile::load(config.scene.name(DEFAULT_SCENE)).context("--scene")?;
        let sender = ControlSender::open(instance, config.leave.unwrap_or_default())?;
        Ok(Controls { sender, tools: std::array::from_fn(|i| scene.instruments[i].tool), due_ns: 0 })
    }

    /// Blocks sent so far.
    pub(super) fn sent(&self) -> u64 {
        self.sender.sent()
    }

    /// Sends what is due, every `period_ns` with the number of the newest field.
    pub(super) fn send_due(&mut self, field: u64, period_ns: u64, now: Nanos) -> Result<()> {
        if now < self.due_ns {
            return Ok(());
        }
        self.due_ns = if self.due_ns + period_ns > now { self.due_ns } else { now } + period_ns;
        self.sender.send_handles(field, self.tools, self.tools.map(Tool::open_rad))?;
        Ok(self.sender.send_pedal(&PedalState::zeroed())?)
    }
}
