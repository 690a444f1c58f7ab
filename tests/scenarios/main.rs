//! Checks across processes, and of the house itself.

mod architecture;
mod bad_input;
mod budgets;
mod crash;
mod record_replay;
mod streams;
