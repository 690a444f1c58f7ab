//! The launcher: starts the processes of a simulator, watches them, records and replays.
//!
//! It starts the other crates' binaries and never links them.

pub mod children;
pub mod cli;
pub mod config;
pub mod ctl;
pub mod doctor;
pub mod exit;
pub mod export;
pub mod film;
pub mod forward;
pub mod fundus;
pub mod import;
pub mod info;
pub mod inputs;
pub mod machine;
pub mod manual;
pub mod memory_file;
pub mod modules;
pub mod play;
pub mod poses_csv;
pub mod progress;
pub mod recover;
pub mod replay;
pub mod results;
pub mod run;
pub mod runtime;
pub mod score;
pub mod score_batch;
pub mod span;
pub mod trace;
mod tracking;
