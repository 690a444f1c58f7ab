//! The launcher: starts the processes of a simulator, supervises them, and records their channels.
//!
//! It starts the programs of the other crates and does not link those crates.

pub mod budgets;
pub mod certify;
pub mod children;
pub mod cli;
pub mod config;
pub mod ctl;
pub mod doctor;
pub mod exit;
pub mod forward;
pub mod machine;
pub mod manual;
pub mod memory_file;
pub mod modules;
pub mod play;
pub mod programs;
pub mod run;
pub mod runtime;
