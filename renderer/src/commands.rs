//! Sub-commands of the renderer's binary, each a shell of its own.

pub mod bench;
