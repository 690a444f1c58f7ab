//! Software twin of vitreo's camera hardware.
//!
//! A virtual surgeon ([`surgeon::motion`]) moves two instruments, sees what comes of it ([`onlooker`]) and turns the eye; the cameras of the rig see
//! coloured markers ([`sight`]) in interlaced fields ([`picture`]), from which blobs are extracted line by
//! line as the hardware does it ([`scan`], [`colours`]). Instead of pixels, blobs can be made straight from
//! the markers ([`direct`]) or come from a recorded stream ([`stream`]). Things go wrong on the way if asked
//! to ([`faults`]). Only [`process`] knows the clock and the channels; what is exposed and sent when, it asks
//! [`groups`], [`region`] and [`outbox`]. The sub-commands ([`commands`]) run the same extraction over pictures and clips from
//! elsewhere ([`input`]).

pub mod cameras;
pub mod colours;
pub mod commands;
pub mod config;
pub mod direct;
pub mod faults;
pub mod groups;
pub mod hardware;
pub mod input;
pub mod onlooker;
pub mod outbox;
pub mod picture;
pub mod process;
pub mod region;
pub mod scan;
pub mod sight;
pub mod stream;
pub mod vectors;
