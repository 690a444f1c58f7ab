//! Recordings again, in one process and without a clock: through tracker and simulation ([`engine`]),
//! through the simulation alone ([`resimulate`]); drawn ([`film`]), scored ([`score`]), and what
//! trainees achieved in them ([`results`]). A scene's script is played by a surgeon who sees the
//! simulated eye ([`perception`]).
//!
//! [`frames`] knows which camera-fields a frame consumed, [`steps`] does steps from what each consumed;
//! both take the items of a recording as they come.

pub mod blocks;
pub mod command;
pub mod diff;
pub mod engine;
pub mod exit;
pub mod export;
pub mod film;
pub mod frames;
pub mod import;
pub mod info;
pub mod line_plot;
pub mod pace;
pub mod perception;
pub mod plot;
pub mod recover;
pub mod report;
pub mod resimulate;
pub mod results;
pub mod score;
pub mod snapshot;
pub mod steps;
pub mod stop;
pub mod sweep;
#[cfg(test)]
mod test_runs;
pub mod trace;
pub mod verify;
pub mod what_if;
