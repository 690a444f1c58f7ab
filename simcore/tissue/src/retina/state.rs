//! What the next step must know about the retina.

use super::figures::{MAX_BLEBS, MAX_HOLES};
use crate::sheet::state::{NODE_PINNED, SheetState, is_bound};
use nalgebra::{UnitVector3, Vector3};
use protocol::limits::INSTRUMENTS;
use protocol::scene::NODE_FREE;
use serde::{Deserialize, Serialize};

/// The retina.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct RetinaState {
    /// Its mesh. `NODE_PINNED` is a node that lies on the choroid and holds there; free and bound
    /// ones are **loose**.
    pub sheet: SheetState,
    /// For each node the number of its bleb + 1; 0 for a node that is not loose. Blebs count in the
    /// order of their first nodes.
    #[serde(with = "crate::pod_serde::list")]
    pub bleb_of: Vec<u8>,
    /// Connected pieces of loose retina, each with the fluid under it.
    pub blebs: Vec<Bleb>,
    /// Holes that needles left; the oldest gives way to a new one when all places are taken.
    pub holes: Vec<Hole>,
    /// The fluid since the start.
    pub account: Account,
    /// The instruments as needles.
    pub needles: [NeedleState; INSTRUMENTS],
    /// The eye is filled with air: holes stay open, and what comes to lie on the choroid stays
    /// there.
    pub air: bool,
}

/// Retina that came off in one piece, and the fluid under it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Bleb {
    /// Fluid that must be there, mm³; the mesh is kept at it.
    pub volume_mm3: f64,
    /// Pressure over the vitreous that keeps it there, Pa; smoothed over
    /// [`super::figures::PRESSURE_S`].
    pub pressure_pa: f64,
    /// Gaps torn into it, mm².
    pub torn_mm2: f64,
}

/// A hole that a needle made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Hole {
    /// The nearest node.
    pub node: u32,
    /// Open area, mm².
    pub open_mm2: f64,
    /// Where it is, eye frame, mm, when it was made.
    pub at_mm: [f64; 3],
}

/// Fluid since the start; `injected` = Σ blebs + `leaked`, always.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Account {
    /// Through needles, mm³.
    pub injected_mm3: f64,
    /// Net out of the blebs through holes and tears (what a lifted retina sucks in counts against
    /// it), and the films that the choroid took up where retina came to lie on it again, mm³.
    pub leaked_mm3: f64,
}

/// An instrument that pierces.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct NeedleState {
    /// Its tip is behind the retina.
    pub inside: bool,
    /// The node nearest to where it went in.
    pub node: u32,
    /// Where it went in (x₀ of the paper), eye frame, mm.
    pub entry_mm: [f64; 3],
    /// Speed of the tip along the retina, smoothed, mm/s.
    pub speed_mm_s: f64,
    /// The warning about the speed is out.
    pub warned: bool,
    /// The warning about the flow is out.
    pub flow_warned: bool,
    /// Distance from the entry within which its injection has taken the retina off, mm.
    pub detached_mm: f64,
    /// Way at tearing speed since the last spring tore, mm.
    pub dragged_mm: f64,
    /// Injected since it went in, mm³.
    pub injected_mm3: f64,
}

impl RetinaState {
    /// Fluid under the retina by the accounts, mm³.
    pub fn under_mm3(&self) -> f64 {
        self.blebs.iter().map(|b| b.volume_mm3).sum()
    }

    /// So much of a bleb's fluid has leaked, mm³; below 0 it was sucked in.
    pub(super) fn leak(&mut self, bleb: usize, lost_mm3: f64) {
        self.blebs[bleb].volume_mm3 -= lost_mm3;
        self.account.leaked_mm3 += lost_mm3;
    }

    /// True if a node is off the choroid.
    pub fn is_loose(&self, node: usize) -> bool {
        let flag = self.sheet.flag[node];
        flag == NODE_FREE || is_bound(flag)
    }

    /// How far the retina that came off at any time has turned about `axis` from the eye's centre,
    /// rad; counter-clockwise seen against it. `home_mm` is where the nodes lay at the start. It is
    /// the turn that leaves the least sum of squared distances.
    pub fn turn_about_rad(&self, home_mm: &[Vector3<f32>], axis: &UnitVector3<f64>) -> f64 {
        let (mut sine, mut cosine) = (0.0, 0.0);
        for (node, home) in home_mm.iter().enumerate() {
            let (h, now) = (home.map(f64::from), self.sheet.position(node).map(f64::from));
            if self.is_loose(node) || (now - h).norm_squared() > 0.0 {
                sine += h.cross(&now).dot(axis);
                cosine += h.dot(&now) - h.dot(axis) * now.dot(axis);
            }
        }
        if sine == 0.0 { 0.0 } else { libm::atan2(sine, cosine) }
    }

    /// The turn about the axis from the fovea to the lens, counter-clockwise seen from the inside,
    /// rad.
    pub fn turn_rad(&self, home_mm: &[Vector3<f32>]) -> f64 {
        self.turn_about_rad(home_mm, &Vector3::z_axis())
    }

    /// Gives every list its full capacity, so that no step allocates.
    pub fn reserve(&mut self) {
        self.blebs.reserve_exact(MAX_BLEBS - self.blebs.len());
        self.holes.reserve_exact(MAX_HOLES - self.holes.len());
        self.sheet.reserve();
    }

    /// Whether the numbers of the fluid make sense.
    ///
    /// # Errors
    /// If one is out of range.
    pub fn check(&self) -> Result<(), &'static str> {
        let nodes = self.sheet.nodes();
        let numbers = self.blebs.iter().flat_map(|b| [b.volume_mm3, b.pressure_pa, b.torn_mm2]);
        let holes = self.holes.iter().flat_map(|h| [h.open_mm2, h.at_mm[0], h.at_mm[1], h.at_mm[2]]);
        let needles =
            self.needles.iter().flat_map(|n| [n.speed_mm_s, n.detached_mm, n.dragged_mm, n.injected_mm3]);
        let entries = self.needles.iter().flat_map(|n| n.entry_mm);
        let account = [self.account.injected_mm3, self.account.leaked_mm3];
        let mut all = numbers.chain(holes).chain(needles).chain(entries).chain(account);
        let nodes_ok = self.holes.iter().map(|h| h.node).chain(self.needles.iter().map(|n| n.node));
        let counts = self.blebs.len() <= MAX_BLEBS && self.holes.len() <= MAX_HOLES;
        let labels = self.bleb_of.iter().all(|&b| usize::from(b) <= self.blebs.len());
        let labelled = self.bleb_of.len() == nodes && labels;
        if labelled && counts && all.all(f64::is_finite) && nodes_ok.into_iter().all(|n| (n as usize) < nodes)
        {
            Ok(())
        } else {
            Err("its blebs, holes or needles are out of range")
        }
    }
}

/// The retina before anything happened: every node holds.
pub fn start(mut sheet: SheetState) -> RetinaState {
    sheet.flag.fill(NODE_PINNED);
    let mut state = RetinaState { bleb_of: vec![0; sheet.nodes()], sheet, ..RetinaState::default() };
    state.reserve();
    state
}
