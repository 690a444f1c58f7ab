//! Software twin of vitreo's camera hardware: pixels in, blobs out.
//!
//! Blobs are extracted line by line as the hardware does it ([`scan`], [`colours`]), from fields
//! that cameras or the virtual rig publish ([`camera_extractor`]); only [`process`] knows the clock
//! and the channels. The sub-commands ([`commands`]) run the same extraction over pictures and
//! clips ([`input`]), and write the hardware's registers ([`hardware`]) and test vectors
//! ([`vectors`]).

pub mod camera_extractor;
pub mod colours;
pub mod commands;
pub mod config;
pub mod hardware;
pub mod input;
pub mod pixels;
pub mod process;
pub mod scan;
pub mod vectors;
