//! Hostile inputs for every reader and every message of vitreo.
//!
//! One list of targets ([`targets::all`]) serves two ends: the test that replays the kept inputs
//! (`proofs/fuzz/tests/corpora.rs`) and the engine of `make fuzz` ([`engine`], `docs/fuzzing.md`). A target takes any bytes and must neither panic, nor take longer than a second, nor hold more than
//! a gigabyte.
//!
//! The engine keeps an input that reaches a branch which none before it reached, and makes new ones
//! from those it keeps; for that our crates are compiled with a counter on every branch
//! (`proofs/fuzz/rustc-with-coverage`). Without the counters it varies the kept inputs blindly, and says so.
//! Messages are plain blocks, which it varies field by field.

pub mod campaign;
pub mod corpus;
pub mod coverage;
pub mod engine;
pub mod fields;
pub mod mutate;
pub mod random;
pub mod targets;
pub mod watch;
