//! What happened to a sheet in a step.

use super::adhesion::Parting;
use protocol::limits::INSTRUMENTS;

/// A count of nodes, and one of them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tally {
    /// How many.
    pub count: u32,
    /// The last one.
    pub node: u32,
}

impl Tally {
    /// Counts `count` more, the last of them at `node`.
    pub fn add(&mut self, count: u32, node: usize) {
        if count > 0 {
            *self = Tally { count: self.count + count, node: node as u32 };
        }
    }
}

/// What happened to a sheet in a step, added up so that a step raises one event of a kind.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StepCounts {
    /// Springs and elements that tore.
    pub torn: Tally,
    /// Nodes disabled because their numbers ran away.
    pub disabled: Tally,
    /// Pinned nodes that came off.
    pub detached: Tally,
    /// Largest force on a node of the rim, µN, and that node.
    pub rim_un: (f32, usize),
    /// Instruments whose last held node was torn away.
    pub lost_grip: [bool; INSTRUMENTS],
    /// What became of the bonds.
    pub parting: Parting,
}
