//! Poses of a running simulator for other programs, and those of another tracker for a run, by OpenIGTLink; and all
//! that viewers show of it.
//!
//! Outwards, one process which reads channels as a recorder does and delays no other process:
//! - [`run`]: waits for a simulator, reads its poses, and continues when it is started again
//! - [`transforms`]: a frame of the tracker as messages; pure
//! - [`clients`]: sockets; a client that reads slowly misses messages, one that does not read is closed
//! - [`viewers`]: the server of Foxglove's protocol
//!
//! Inwards, a driver of poses:
//! - [`map`]: which transform is which body; [`incoming`]: transforms become frames; [`motion`]: and velocities; pure
//! - [`receive`]: the connection, and the run

pub mod clients;
pub mod incoming;
pub mod map;
pub mod motion;
pub mod receive;
pub mod run;
pub mod transforms;
pub mod viewers;
