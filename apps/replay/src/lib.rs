//! Recordings again, in one process and without a clock: through tracker and simulation ([`engine`]),
//! through the simulation alone ([`resimulate`]); drawn ([`film`]), scored ([`score`]), and what
//! trainees achieved in them ([`results`]). A scene's script is played by a surgeon who sees the
//! simulated eye ([`perception`]).
//!
//! What the tracker made of blobs is printed and drawn by [`residuals`] and [`inspect`], from [`matched`].
//!
//! [`frames`] knows which camera-fields a frame consumed, [`steps`] does steps from what each consumed;
//! both take the items of a recording as they come.

pub mod blocks;
pub mod check;
pub mod command;
pub mod cut;
pub mod diff;
pub mod engine;
pub mod exit;
pub mod export;
pub mod film;
pub mod frames;
pub mod import;
pub mod info;
mod info_pixels;
pub mod inspect;
pub mod interactive;
pub mod likely_cause;
pub mod matched;
pub mod merge;
mod misfits;
pub mod new_recording;
pub mod other_build;
pub mod pace;
pub mod perception;
pub mod pixels;
pub mod recover;
pub mod report;
pub mod residuals;
pub mod resimulate;
pub mod results;
pub mod score;
pub mod screen;
pub mod snapshot;
pub mod steps;
pub mod stop;
pub mod suite;
pub mod sweep;
pub mod terminal;
#[cfg(test)]
mod test_runs;
pub mod timeline;
pub mod trace;
pub mod transport;
pub mod verify;
pub mod viewer;
pub mod what_if;
