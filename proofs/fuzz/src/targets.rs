//! The list of targets: every message of a channel, every reader of a file or an argument, and what
//! takes in whole streams of messages.

mod binary;
mod controls;
mod live;
mod pairs;
mod state;
mod text;
mod wire;

use protocol::wire::Layout;

/// What a target reads; it decides how many inputs a campaign is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The block of a message.
    Wire,
    /// A text of a file or of arguments.
    Text,
    /// A recording, or another file that is no text.
    Recording,
    /// A scene to be simulated, or a stream of messages into a process's core.
    Scene,
}

impl Kind {
    /// Name in tables and options.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Wire => "wire",
            Kind::Text => "text",
            Kind::Recording => "recording",
            Kind::Scene => "scene",
        }
    }

    /// Inputs that a whole campaign tries.
    pub fn asked(self) -> u64 {
        match self {
            Kind::Wire => 100_000_000,
            Kind::Text => 10_000_000,
            Kind::Recording | Kind::Scene => 1_000_000,
        }
    }
}

/// Something that takes any bytes.
#[derive(Clone, Copy)]
pub struct Target {
    /// Its name, also that of its folder of inputs.
    pub name: &'static str,
    /// What it reads.
    pub kind: Kind,
    /// Takes an input in; panics where that is wrong.
    pub run: fn(&[u8]),
    /// Inputs to begin with, made of real files and messages.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// Layout of the block, for messages.
    pub layout: Option<&'static Layout>,
    /// Longest input that is made, bytes.
    pub longest: usize,
}

/// Every target, in the order in which a campaign tries them.
pub fn all() -> Vec<Target> {
    let inputs = [text::targets(), live::targets(), controls::targets(), binary::targets()].concat();
    [wire::targets(), inputs, pairs::targets(), state::targets()].concat()
}

/// The target of this name.
pub fn named(name: &str) -> Option<Target> {
    all().into_iter().find(|t| t.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_target_has_a_name_of_its_own_and_something_to_begin_with() {
        let all = all();
        let names: BTreeSet<_> = all.iter().map(|t| t.name).collect();
        assert_eq!(names.len(), all.len());
        for target in all {
            let seeds = (target.seeds)();
            assert!(!seeds.is_empty(), "{}", target.name);
            let fit = |s: &Vec<u8>| target.layout.is_none_or(|l| s.len() == l.size);
            assert!(seeds.iter().all(fit), "{}", target.name);
            assert!(seeds.iter().any(|s| s.len() <= target.longest), "{}: longer than inputs", target.name);
        }
    }

    #[test]
    fn every_channel_has_a_target() {
        let doc = include_str!("../../../protocol/src/lib.rs");
        let rows = doc.lines().filter(|l| l.starts_with("//! | `")).count();
        let wire = all().iter().filter(|t| t.kind == Kind::Wire).count();
        assert_eq!(wire, rows, "a row of the channel table each");
    }
}
