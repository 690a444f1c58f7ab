//! The simulation alone in one process, without cameras and without a clock: a recording is
//! resimulated ([`resimulate`]), also to be drawn again ([`recorded_film`]); a scene's script is
//! played for a film ([`film`]) by a surgeon who sees the simulated eye ([`perception`]).

pub mod blocks;
pub mod film;
pub mod perception;
pub mod recorded_film;
pub mod resimulate;
