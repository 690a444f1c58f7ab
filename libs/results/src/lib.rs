//! What trainees achieved: the store of their attempts ([`store`]), the learning curve ([`curve`]),
//! tables for other programs ([`table`], [`parquet_file`]), which recordings a batch is made of
//! ([`listing`]), the order in which they are worked through ([`batch`]), and the tables of its shards
//! put together again ([`shards`]).
//!
//! The score itself is made by `training`, here of recordings ([`scored`]), which become attempts
//! ([`keeping`]); everywhere else it is a name, a number and its deviation. See `docs/results.md`.

pub mod attempt;
pub mod batch;
pub mod curve;
pub mod keeping;
pub mod listing;
pub mod parquet_file;
pub mod parquet_read;
pub mod plot;
pub mod schema;
pub mod scored;
pub mod shards;
pub mod store;
pub mod table;
pub mod terminal;

pub use attempt::{Attempt, Points, Stored};
pub use store::{Store, StoreError};
