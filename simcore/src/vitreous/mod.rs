//! The vitreous body.
pub mod chainmail;
pub mod lattice;
pub mod relax;
pub mod state;
