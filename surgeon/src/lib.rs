//! Scripted surgeons: what they mean to do ([`plan`]), how well they do it ([`skill`]), the movements that come of it
//! ([`script`]), and a scene's whole script played without cameras ([`rehearsal`]). Everything here is pure: no clock, and no
//! randomness without a seed.

mod attempt;
pub mod motion;
pub mod plan;
pub mod rehearsal;
pub mod script;
pub mod skill;
pub mod tremor;

pub use attempt::{compose, load};
