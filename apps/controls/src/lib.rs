//! A real foot pedal and real handles in a run: devices of this machine to the channels `pedal` and
//! `handles` (`docs/controls.md`, `docs/handles.md`).
//!
//! A pedal's events ([`events`]) or reports say where its axes and buttons stand ([`inputs`]), and a
//! mapping what they mean ([`mapping`], [`learn`]). Handles send lines ([`encoder`]); the rig says how far
//! their jaws open. Problems of a device are reported in words and counted ([`condition`]). Only
//! [`process`] and [`commands`] know the clock, the channels and the devices.

pub mod commands;
pub mod condition;
pub mod config;
pub mod encoder;
pub mod events;
pub mod inputs;
pub mod learn;
pub mod mapping;
pub mod process;
