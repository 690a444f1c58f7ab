//! Transport over shared memory. The only module that names iceoryx2.
//!
//! An [`Instance`] is a private directory on tmpfs, with a token in it that names its segments; every
//! channel of a simulator lives in it, so that several simulators or tests run side by side.
//! [`Sender`]s and [`Receiver`]s carry fixed blocks, [`BlockSender`]s and [`BlockReceiver`]s a header
//! with a payload of variable size, both without a copy where they are built in the lent block
//! ([`Sender::fill`], [`Sender::lend`], [`BlockSender::send`]) and read in the sample
//! ([`Receiver::next_sample`]). A slow receiver blocks no sender: the oldest blocks are overwritten
//! and counted. [`wait`] sleeps until one of several channels has something new.
//!
//! Two builds that disagree about a block's layout do not connect: the service carries the schema
//! hash of [`Message::SCHEMA`](protocol::message::Message::SCHEMA) and the error names the channel.
//!
//! Rules taken from measurements of iceoryx2 0.10.0: data first, then the notification; a
//! listener is drained until empty; every wait is bounded; subscribers are looked at after any
//! wake-up, because a notification may be lost but the data is not.

#![allow(unsafe_code)] // wire wrappers and borrowed file descriptors; each use has its SAFETY note

pub mod awake;
mod block;
mod channel;
pub mod checkpoints;
pub mod clock;
mod controls;
mod instance;
pub mod logging;
mod open_limit;
pub mod outbox;
pub mod outside;
mod port;
pub mod programs;
mod segments;
pub mod shell;
pub mod signals;
pub mod trace;
mod wake;
mod whole;

pub use block::{BlockReceiver, BlockSample, BlockSender, Loan};
pub use channel::{Counts, Lease, Received, Receiver, Sample, Sender};
pub use controls::ControlSender;
pub use instance::{Instance, instance_directory, shared_memory_prefix};
pub use wake::{Bell, BellRope, Listener, MAX_SOURCES, Wakes, wait, wait_beside};
pub use whole::{write_whole, write_whole_json};

/// How a receiver wants its blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Queue {
    /// Every block, in order, as far as the queue reaches; what was overwritten is counted.
    InOrder,
    /// Only the newest.
    Newest,
}

/// Why a channel or an instance cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum IpcError {
    /// The name cannot be a directory name.
    #[error("instance name '{0}': expected 1 to 18 of a–z, 0–9 and '-'")]
    InstanceName(String),
    /// Another simulator runs under this name.
    #[error("instance '{0}' is in use by another running vitreo; choose another with --instance NAME")]
    InUse(String),
    /// The directory belongs to somebody else or cannot be made.
    #[error("shared memory directory {path}: {problem}")]
    Directory {
        /// The directory.
        path: String,
        /// What is wrong.
        problem: String,
    },
    /// Too little shared memory is free.
    #[error(
        "/dev/shm has {free_mib} MiB free, {needed_mib} MiB are needed; remove files there or enlarge it \
         (mount -o remount,size=256M /dev/shm; in a container, --shm-size=256m)"
    )]
    SharedMemoryFull {
        /// Free.
        free_mib: u64,
        /// Needed.
        needed_mib: u64,
    },
    /// The other side was built with another layout of the block.
    #[error(
        "channel {channel}: the running process was built with another version of this block \
         (schema here {schema:016x}); rebuild both with the same version of vitreo"
    )]
    SchemaDiffers {
        /// The channel.
        channel: &'static str,
        /// Schema hash of this build.
        schema: u64,
    },
    /// Something in the transport failed.
    #[error("channel {channel}: {operation}: {problem}")]
    Transport {
        /// The channel, or "node".
        channel: &'static str,
        /// What was tried.
        operation: &'static str,
        /// The library's answer.
        problem: String,
    },
    /// A block does not fit.
    #[error("channel {channel}: {bytes} bytes do not fit the capacity of {capacity} bytes")]
    TooLarge {
        /// The channel.
        channel: &'static str,
        /// Wanted.
        bytes: usize,
        /// There is room for.
        capacity: usize,
    },
}

/// Makes an error of the library's answer to an operation on a channel.
fn transport<E: std::fmt::Debug>(
    channel: &'static str,
    operation: &'static str,
) -> impl FnOnce(E) -> IpcError {
    move |answer| IpcError::Transport { channel, operation, problem: format!("{answer:?}") }
}
