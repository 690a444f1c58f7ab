//! The launcher: starts the processes of a simulator, watches them, records and replays.
//!
//! It starts the other crates' binaries and never links them.

pub mod budgets;
pub mod children;
pub mod cli;
pub mod config;
pub mod ctl;
pub mod doctor;
pub mod exit;
pub mod film;
pub mod forward;
pub mod fundus;
pub mod inputs;
pub mod machine;
pub mod manual;
pub mod memory_file;
pub mod modules;
pub mod objects;
pub mod play;
pub mod results;
pub mod run;
pub mod runtime;
pub mod score;
pub mod score_batch;
pub mod score_shards;
