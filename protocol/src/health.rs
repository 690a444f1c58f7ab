//! `health`: heartbeats of the processes.

use crate::limits::TEXT_BYTES;
use crate::message::{Invalid, Message, require, text_of};
use crate::time::Nanos;
use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};

/// The processes of a simulator. The desk takes the place of virtual rig, camera hardware and
/// tracker; the camera hardware runs where there are pixels to scan, controls where pedal or handles are real.
/// Drivers are programs of other makers, which the launcher does not start; each is named for the channel that
/// it sends on.
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
    Controls = 6,
    BlobsDriver = 16,
    FieldsDriver = 17,
    HandlesDriver = 18,
    PedalDriver = 19,
    PosesDriver = 20,
}

impl Process {
    /// Programs of other makers, by what they send.
    pub const DRIVERS: [Process; 5] = {
        use Process::*;
        [BlobsDriver, FieldsDriver, HandlesDriver, PedalDriver, PosesDriver]
    };

    /// Ours, in the order of the data path.
    pub const ALL: [Process; 7] = {
        use Process::*;
        [VirtualRig, FpgaModel, Tracker, Simcore, Renderer, Desk, Controls]
    };

    /// From the wire.
    pub fn from_wire(code: u32) -> Option<Self> {
        Self::ALL.into_iter().chain(Self::DRIVERS).find(|&p| p as u32 == code)
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
            Process::Controls => "controls",
            Process::BlobsDriver => "blobs-driver",
            Process::FieldsDriver => "fields-driver",
            Process::HandlesDriver => "handles-driver",
            Process::PedalDriver => "pedal-driver",
            Process::PosesDriver => "poses-driver",
        }
    }

    /// The channel that a driver sends on; `None` for our own processes.
    pub fn drives(self) -> Option<&'static str> {
        Some(match self {
            Process::BlobsDriver => "blobs",
            Process::FieldsDriver => "fields",
            Process::HandlesDriver => "handles",
            Process::PedalDriver => "pedal",
            Process::PosesDriver => "poses",
            _ => return None,
        })
    }

    /// Name of the binary; of a driver, which is another's, what it is called.
    pub fn binary(self) -> &'static str {
        match self {
            Process::FpgaModel => "vitreo-fpga-model",
            Process::Tracker => "vitreo-tracker",
            Process::Simcore => "vitreo-simcore",
            Process::Renderer => "vitreo-renderer",
            Process::Desk => "vitreo-desk",
            Process::VirtualRig => "vitreo-virtual-rig",
            Process::Controls => "vitreo-controls",
            driver => driver.name(),
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
        require(
            Process::from_wire(self.process).is_some(),
            "Health",
            "process",
            "0 to 6, or of a driver 16 to 20",
            process,
        )?;
        require(self.state <= STATE_FINISHED, "Health", "state", "0 to 3", f64::from(self.state))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_process_leads_back_from_the_wire_and_drivers_say_what_they_send() {
        for process in Process::ALL.into_iter().chain(Process::DRIVERS) {
            assert_eq!(Process::from_wire(process as u32), Some(process));
            let driver = process.drives().map(|channel| format!("{channel}-driver"));
            assert_eq!(driver.is_some(), Process::DRIVERS.contains(&process));
            assert!(driver.is_none_or(|name| name == process.name() && name == process.binary()));
        }
        assert_eq!((Process::from_wire(15), Process::from_wire(21)), (None, None));
    }
}
