//! Live cameras of a rig: cameras of this machine, pipes and files, in place of the virtual rig
//! (`docs/cameras.md`).
//!
//! Each source is read by a thread of its own: a pipe or a file as YUV4MPEG2 ([`stream`]), a camera by
//! Video4Linux2 ([`device`]). Its fields are numbered by when its pictures come, or by when its camera says
//! that it took them ([`timing`], [`stamps`]); its problems are reported in words and counted
//! ([`condition`], [`tally`]). Only [`process`] and [`commands`] know the clock, the channels and the pipes.

pub mod commands;
pub mod condition;
pub mod config;
pub mod device;
pub mod process;
pub mod stamps;
pub mod stream;
pub mod tally;
pub mod timing;
