//! What each tool does to tissue, beyond pushing it.

pub mod forceps;
pub mod needle;
pub mod vitrector;
