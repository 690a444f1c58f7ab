//! Training: whether the trainee has done what a module asks for ([`task`]), and how well
//! ([`score`]). Everything here is pure: no clock, no file, no randomness. The simulation runs the
//! tasks live; the launcher scores recordings by the same code.
//!
//! A module is a folder of `assets/modules`; see `docs/modules.md`. What counts and how much:
//! `docs/score.md`.

pub mod sample;
pub mod score;
pub mod task;
