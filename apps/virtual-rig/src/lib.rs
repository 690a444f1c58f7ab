//! The virtual rig of vitreo: a scripted surgeon, a mechanical eye, and cameras that see both.
//!
//! The surgeon ([`surgeon::motion`]) moves the instruments and reacts to the simulation
//! ([`perception`]); the cameras ([`cameras`]) see coloured markers ([`projection`]) in interlaced
//! fields of pixels ([`painter`]), or as blobs with noise ([`direct`]). A recorded stream of blobs
//! can be played in their place ([`playback`]). Faults are injected into any of it ([`faults`]).
//! Only [`process`] knows the clock and the channels; [`schedule`] plans the exposures.

pub mod cameras;
pub mod config;
pub mod direct;
pub mod faults;
pub mod painter;
pub mod perception;
pub mod pixels;
pub mod playback;
pub mod process;
pub mod projection;
pub mod schedule;
