//! Poses of a running simulator for other programs, by OpenIGTLink.
//!
//! One process, which reads the channel `poses` as a recorder does and delays nobody:
//! - [`run`]: waits for a simulator, reads its poses, and goes on when it is started anew
//! - [`transforms`]: a frame of the tracker as messages; pure
//! - [`clients`]: sockets; a client that reads slowly misses messages, one that does not read is closed

pub mod clients;
pub mod run;
pub mod transforms;
