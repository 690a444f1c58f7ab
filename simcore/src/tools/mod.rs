//! What each tool does to tissue, beyond pushing it.

pub mod forceps;
