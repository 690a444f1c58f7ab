//! What trainees achieved: the store of their attempts ([`store`]), the learning curve ([`curve`]),
//! tables for other programs ([`table`], [`parquet_file`]), and the order in which a batch of
//! recordings is worked through ([`batch`]).
//!
//! The score itself is made elsewhere; here it is a name, a number and its deviation. See
//! `docs/results.md`.

pub mod attempt;
pub mod batch;
pub mod curve;
pub mod parquet_file;
pub mod plot;
pub mod schema;
pub mod store;
pub mod table;
pub mod terminal;

pub use attempt::{Attempt, Points, Stored};
pub use store::{Store, StoreError};
