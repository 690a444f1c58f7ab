//! Training modules: what a trainee is asked to do ([`module`]), whether it is done ([`task`]), how well ([`score`]), and
//! scripted surgeons who do it ([`plan`], [`surgeon`]). Everything here is pure: no clock, no file but those that a caller
//! names, no randomness without a seed. The simulation runs the tasks live; the launcher scores recordings by the same code.
//!
//! A module is a folder of `assets/modules`; see `docs/modules.md`. What counts and how much: `docs/score.md`.

pub mod module;
pub mod plan;
pub mod random;
pub mod sample;
pub mod score;
pub mod surgeon;
pub mod task;
