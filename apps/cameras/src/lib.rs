//! Live cameras of a rig whose pictures come through pipes or from files, in place of the virtual rig
//! (`docs/cameras.md`).
//!
//! Each source is read by a thread of its own as YUV4MPEG2 ([`stream`]) and numbered by when its
//! pictures come ([`timing`]); what is wrong with it is told in words and counted ([`condition`],
//! [`tally`]). Only [`process`] knows the clock, the channels and the pipes.

pub mod condition;
pub mod config;
pub mod process;
pub mod stream;
pub mod tally;
pub mod timing;
