//! The tissue solvers beside closed forms and independent solutions, a file a case;
//! `docs/validation.md` has the table.

pub mod balloon;
pub mod beam;
pub mod bleb;
pub mod case;
pub mod chain;
pub mod hencky;
pub mod lattice;
pub mod mesh;
pub mod modes;
pub mod net;
pub mod oscillator;
pub mod patch;
pub mod peel;
pub mod plot;
pub mod strip;
