//! `health`: heartbeats of the processes.

use crate::limits::TEXT_BYTES;
use crate::message::{Invalid, Message, require, text_of};
use crate::time::Nanos;
use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};

/// The processes of a simulator. The desk takes the place of virtual rig, camera hardware and
/// tracker; the camera hardware runs where there are pixels to scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u32)]
#[allow(missing_docs)]
pub enum Process {
    FpgaModel = 0,
    Tracker = 1,
    Simcore = 2,
    Renderer = 3,
    Desk = 4,
    VirtualRig = 5,
}

impl Process {
    /// In the order of the data path.
    pub const ALL: [Process; 6] = {
        use Process::*;
        [VirtualRig, FpgaModel, Tracker, Simcore, Renderer, Desk]
    };

    /// From the wire.
    pub fn from_wire(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|&p| p as u32 == code)
    }

    /// Short name, as in messages.
    pub fn name(self) -> &'static str {
        match self {
            Process::FpgaModel => "fpga-model",
            Process::Tracker => "tracker",
            Process::Simcore => "simcore",
            Process::Renderer => "renderer",
            Process::Desk => "desk",
            Process::VirtualRig => "virtual-rig",
        }
    }

    /// Name of the binary.
    pub fn binary(self) -> &'static str {
        match self {
            Process::FpgaModel => "vitreo-fpga-model",
            Process::Tracker => "vitreo-tracker",
            Process::Simcore => "vitreo-simcore",
            Process::Renderer => "vitreo-renderer",
            Process::Desk => "vitreo-desk",
            Process::VirtualRig => "vitreo-virtual-rig",
        }
    }
}

/// Still starting; not ready for work.
pub const STATE_STARTING: u32 = 0;
/// Ready and working.
pub const STATE_RUNNING: u32 = 1;
/// Working with a limitation that `text` names.
pub const STATE_DEGRADED: u32 = 2;
/// Nothing more will come (end of a stream or of the duration).
pub const STATE_FINISHED: u32 = 3;

/// A heartbeat.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Wire, Zeroable)]
pub struct Health {
    /// Sender's instant.
    pub instant_ns: Nanos,
    /// Blocks it has taken in.
    pub received: u64,
    /// Blocks it has sent.
    pub sent: u64,
    /// Blocks it lost in its queues.
    pub lost: u64,
    /// Blocks it refused.
    pub refused: u64,
    /// CPU time it has used, ns.
    pub cpu_ns: u64,
    /// [`Process`] on the wire.
    pub process: u32,
    /// Its operating-system id.
    pub pid: u32,
    /// One of `STATE_…`.
    pub state: u32,
    /// 0; keeps the text aligned.
    pub reserved: u32,
    /// Zero-padded text: tier, degraded state and the like.
    pub text: [u8; TEXT_BYTES],
}

impl Health {
    /// The text.
    pub fn text(&self) -> String {
        text_of(&self.text)
    }
}

impl Message for Health {
    const CHANNEL: &'static str = "health";
    const VERSION: u32 = 1;
    const QUEUE: usize = 64;

    fn validate(&self) -> Result<(), Invalid> {
        let process = f64::from(self.process);
        require(Process::from_wire(self.process).is_some(), "Health", "process", "0 to 5", process)?;
        require(self.state <= STATE_FINISHED, "Health", "state", "0 to 3", f64::from(self.state))
    }
}
