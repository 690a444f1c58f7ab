//! What happened to a sheet.

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

    /// Adds those of a later phase.
    pub fn merge(&mut self, later: Tally) {
        self.add(later.count, later.node as usize);
    }
}

/// What happened to a sheet, added up so that a step raises one event of a kind.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SheetCounts {
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
    /// Area cut away by each instrument, µm².
    pub cut_um2: [u64; INSTRUMENTS],
    /// What became of the bonds.
    pub parting: Parting,
}

impl SheetCounts {
    /// Adds those of a later phase.
    pub fn merge(&mut self, later: &SheetCounts) {
        self.torn.merge(later.torn);
        self.disabled.merge(later.disabled);
        self.detached.merge(later.detached);
        if later.rim_un.0 > self.rim_un.0 {
            self.rim_un = later.rim_un;
        }
        for i in 0..INSTRUMENTS {
            self.lost_grip[i] |= later.lost_grip[i];
            self.cut_um2[i] += later.cut_um2[i];
        }
        self.parting.add(&later.parting);
    }
}
