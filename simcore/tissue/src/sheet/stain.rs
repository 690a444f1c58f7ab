//! Dye on the membrane: what a needle that injects before it colours, so that a surgeon sees the
//! sheet that is to be peeled.
//!
//! Each node within [`REACH_MM`] of the needle's tip takes dye while the syringe is pressed, the
//! more the nearer it is and the harder the foot presses; whole numbers, so that no order of sums
//! matters. Dye stays where it is: it is washed out in minutes, which no attempt takes. It changes
//! no force.

use crate::sheet::state::SheetState;
use nalgebra::Vector3;
use protocol::scene::NODE_DEAD;
use serde::{Deserialize, Serialize};

/// How far a jet of dye colours, mm: a heavy dye sinks onto the macula and spreads over it.
pub const REACH_MM: f64 = 2.5;
/// A node right before the needle is coloured fully after this time, s, with the foot fully pressed.
const FULL_S: f64 = 0.6;
/// Full dye: so fine that a short, weak jet at the end of its reach counts too.
const FULL: u16 = u16::MAX;
/// A node counts as stained from so much dye on.
const SEEN: u16 = FULL / 4;
/// The share is reported each time it has grown by this much, percent.
const REPORT_PERCENT: u32 = 10;

/// Dye of every node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StainState {
    /// 0 none, [`FULL`] full.
    #[serde(with = "crate::pod_serde::list")]
    pub dye: Vec<u16>,
    /// Steps of the share that were reported.
    pub reported: u32,
}

impl StainState {
    /// No dye on any of `nodes` nodes.
    pub fn new(nodes: usize) -> Self {
        StainState { dye: vec![0; nodes], reported: 0 }
    }

    /// A jet from a tip (eye frame, mm) for `dt_s`, `share` of the full pressure. Returns whether
    /// it reached anything.
    pub fn wash(&mut self, membrane: &SheetState, tip: &Vector3<f64>, share: f64, dt_s: f64) -> bool {
        let mut reached = false;
        for (node, dye) in self.dye.iter_mut().enumerate() {
            let away = (membrane.position(node).map(f64::from) - tip).norm();
            if membrane.flag[node] == NODE_DEAD || away >= REACH_MM {
                continue;
            }
            reached = true;
            let more = f64::from(FULL) * (dt_s / FULL_S) * share * (1.0 - away / REACH_MM);
            *dye = dye.saturating_add((more + 0.5) as u16);
        }
        reached
    }

    /// Share of the living nodes that are stained, percent.
    pub fn percent(&self, membrane: &SheetState) -> f64 {
        let living = || (0..self.dye.len()).filter(|&n| membrane.flag[n] != NODE_DEAD);
        let stained = living().filter(|&n| self.dye[n] >= SEEN).count();
        100.0 * stained as f64 / living().count().max(1) as f64
    }

    /// The share, if it has grown by another step since the last report.
    pub fn report(&mut self, membrane: &SheetState) -> Option<f64> {
        let percent = self.percent(membrane);
        let steps = percent as u32 / REPORT_PERCENT;
        let grown = steps > self.reported;
        self.reported = self.reported.max(steps);
        grown.then_some(percent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sheet::mesh::SheetMesh;
    use scene::SceneFile;

    #[test]
    fn dye_reaches_what_is_near_and_no_more_and_is_reported_in_steps() {
        let membrane = SheetMesh::new(&SceneFile::load("erm").unwrap()).unwrap().start();
        let mut stain = StainState::new(membrane.nodes());
        let tip = Vector3::new(1.0, 0.0, -10.0);
        assert!(!stain.wash(&membrane, &Vector3::new(0.0, 0.0, -5.0), 1.0, 0.02));
        let mut reported = Vec::new();
        for _ in 0..100 {
            assert!(stain.wash(&membrane, &tip, 0.5, 0.02));
            reported.extend(stain.report(&membrane));
        }
        for node in 0..membrane.nodes() {
            let away = (membrane.position(node).map(f64::from) - tip).norm();
            assert_eq!(stain.dye[node] > 0, away < REACH_MM, "node {node}, {away} mm away");
            // Two seconds at half the pressure bring 1 / 0.6 of full dye at the needle, falling to
            // none at its reach.
            let seen = (1.0 - away / REACH_MM) / 0.6 > 0.25;
            assert_eq!(stain.dye[node] >= SEEN, seen, "node {node}, {away} mm away");
        }
        assert!(
            reported.len() >= 2 && reported.windows(2).all(|w| w[1] as u32 / 10 > w[0] as u32 / 10),
            "{reported:?}"
        );
        let percent = stain.percent(&membrane);
        assert_eq!(reported.last().map(|&t| t as u32 / 10), Some(percent as u32 / 10));
        assert!((20.0..80.0).contains(&percent), "{percent}");
    }
}
