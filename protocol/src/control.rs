//! `control` and `answers`: the launcher asks, each process answers.

use crate::health::Process;
use crate::limits::TEXT_BYTES;
use crate::message::{Invalid, Message, require, text_of};
use crate::time::Nanos;
use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};

/// Command of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Command {
    /// Answer, to show that the queue is served.
    Ping = 0,
    /// Begin, or go on after a pause.
    Start = 1,
    /// Stand still.
    Pause = 2,
    /// Forget the past; begin as if just started.
    Reset = 3,
    /// The stream has ended: finish what is open.
    Flush = 4,
    /// End in order.
    Shutdown = 5,
    /// Save a still picture (renderer).
    Snapshot = 6,
    /// Read the scene file again, which now contains another scene, and restart (camera hardware). The
    /// argument is the new duration in ms, 0 for none.
    Load = 7,
    /// The module's next level (launcher).
    Next = 8,
    /// Show the help over the picture (argument 1) or hide it (0) (renderer). Whether it is open is the
    /// launcher's to know: a renderer that was restarted learns it so.
    Help = 9,
}

impl Command {
    /// From the wire.
    pub fn from_wire(code: u32) -> Option<Self> {
        use Command::*;
        [Ping, Start, Pause, Reset, Flush, Shutdown, Snapshot, Load, Next, Help].get(code as usize).copied()
    }
}

/// Addressed to every process.
pub const EVERY_PROCESS: u32 = u32::MAX;
/// Addressed to the launcher, which is none of the [`Process`]es; in answers, sent by it.
pub const LAUNCHER: u32 = u32::MAX - 1;

/// A request.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Wire, Zeroable)]
pub struct Request {
    /// Counts up by one.
    pub seq: u64,
    /// Meaning depends on the command.
    pub argument: u64,
    /// [`Process`] on the wire, or [`EVERY_PROCESS`].
    pub target: u32,
    /// [`Command`] on the wire.
    pub command: u32,
}

impl Request {
    /// True if `process` is addressed.
    pub fn is_for(&self, process: Process) -> bool {
        self.target == EVERY_PROCESS || self.target == process as u32
    }
}

impl Message for Request {
    const CHANNEL: &'static str = "control";
    /// 2: commands 7 and 8, and requests to the launcher; 3: command 9.
    const VERSION: u32 = 3;
    const QUEUE: usize = 32;

    fn validate(&self) -> Result<(), Invalid> {
        let command = f64::from(self.command);
        require(Command::from_wire(self.command).is_some(), "Request", "command", "0 to 9", command)
    }
}

/// What is wrong with the run, for the picture; the newest counts, an empty text for nothing.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Wire, Zeroable)]
pub struct Notice {
    /// When it was sent.
    pub instant_ns: Nanos,
    /// Zero-padded text.
    pub text: [u8; TEXT_BYTES],
}

impl Notice {
    /// The text.
    pub fn text(&self) -> String {
        text_of(&self.text)
    }
}

impl Message for Notice {
    const CHANNEL: &'static str = "notices";
    const VERSION: u32 = 1;
    const QUEUE: usize = 16;

    fn validate(&self) -> Result<(), Invalid> {
        Ok(())
    }
}

/// An answer.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Wire, Zeroable)]
pub struct Answer {
    /// `seq` of the request.
    pub seq: u64,
    /// [`Process`] on the wire, or [`LAUNCHER`].
    pub process: u32,
    /// 0: done; 1: not possible, for the reason in `text`.
    pub result: u32,
    /// Zero-padded text.
    pub text: [u8; TEXT_BYTES],
}

impl Answer {
    /// The text.
    pub fn text(&self) -> String {
        text_of(&self.text)
    }
}

impl Message for Answer {
    const CHANNEL: &'static str = "answers";
    /// 2: answers of the launcher.
    const VERSION: u32 = 2;
    const QUEUE: usize = 64;

    fn validate(&self) -> Result<(), Invalid> {
        let process = f64::from(self.process);
        let known = Process::from_wire(self.process).is_some() || self.process == LAUNCHER;
        require(known, "Answer", "process", "0 to 4, or the launcher", process)
    }
}
