//! Scripted surgeons: plan ([`plan`]), error model ([`skill`]), movement ([`script`], [`motion`]),
//! and rehearsal of a scene's script without cameras ([`rehearsal`]). Everything is pure: no clock,
//! and no randomness without a seed.

mod attempt;
pub mod motion;
pub mod plan;
pub mod rehearsal;
pub mod script;
pub mod skill;
pub mod tremor;

pub use attempt::{compose, load, longest_s};
