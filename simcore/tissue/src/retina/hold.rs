//! Jaws on loose retina: what they hold moves with the instrument, and its pull on the rest is what slips a weak grip.
//! (The same as [`crate::forceps`] does to a membrane; retina that lies on the choroid cannot be grasped.)

use super::Retina;
use super::state::RetinaState;
use crate::constants::{MAX_HELD, SUBSTEP_S};
use crate::state::HeldNode;
use nalgebra::{Isometry3, Point3, Vector3};
use protocol::scene::{NODE_BOUND, NODE_DEAD, NODE_FREE};

/// Forgets held nodes that were torn away.
pub(super) fn drop_dead(state: &mut RetinaState) {
    let flag = &state.tissue.flag;
    state.held.iter_mut().for_each(|held| held.retain(|h| flag[h.node as usize] != NODE_DEAD));
}

impl Retina {
    /// Binds the loose nodes within `reach_mm` of the tip of instrument `i`; returns how many it holds now.
    pub fn grab(
        &mut self,
        state: &mut RetinaState,
        i: usize,
        eye_from_instrument: &Isometry3<f64>,
        reach_mm: f64,
    ) -> usize {
        let tip = eye_from_instrument.translation.vector;
        for &n in self.pieces.loose() {
            let p = state.tissue.position(n as usize).map(f64::from);
            let free = state.tissue.flag[n as usize] == NODE_FREE && state.held[i].len() < MAX_HELD;
            if free && (p - tip).norm_squared() <= reach_mm * reach_mm {
                let at = eye_from_instrument.inverse_transform_point(&Point3::from(p));
                let at_in_instrument_mm = at.coords.map(|c| c as f32).into();
                state.held[i].push(HeldNode { node: n, at_in_instrument_mm });
                state.tissue.flag[n as usize] = NODE_BOUND + i as u32;
            }
        }
        self.solver.refresh(&self.sheet, &state.tissue, &self.tissue);
        state.held[i].len()
    }

    /// Lets go of everything that instrument `i` holds; returns how many nodes that was.
    pub fn let_go(&mut self, state: &mut RetinaState, i: usize) -> usize {
        let count = state.held[i].len();
        for k in 0..count {
            let n = state.held[i][k].node;
            super::front::shift(&mut state.tissue, n, &Vector3::zeros(), None, self.figures.radius_mm);
            state.tissue.set_velocity(n as usize, Vector3::zeros());
            state.tissue.flag[n as usize] = NODE_FREE;
        }
        state.held[i].clear();
        if count > 0 {
            self.solver.refresh(&self.sheet, &state.tissue, &self.tissue);
        }
        count
    }

    /// Moves what instrument `i` holds with it, no deeper than the choroid.
    pub fn carry(&self, state: &mut RetinaState, i: usize, eye_from_instrument: &Isometry3<f64>) {
        for k in 0..state.held[i].len() {
            let held = state.held[i][k];
            let at = Point3::from(held.at_in_instrument_mm.map(f64::from));
            let before = state.tissue.position(held.node as usize).map(f64::from);
            let way = (eye_from_instrument * at).coords - before;
            super::front::shift(&mut state.tissue, held.node, &way, None, self.figures.radius_mm);
            let moved = state.tissue.position(held.node as usize).map(f64::from) - before;
            state.tissue.set_velocity(held.node as usize, (moved / SUBSTEP_S).map(|c| c as f32));
        }
    }

    /// Force of the springs on what instrument `i` holds, µN.
    pub fn pull_un(&self, state: &RetinaState, i: usize) -> f64 {
        let force = |n: u32| Vector3::from(self.solver.force_un.each_ref().map(|f| f64::from(f[n as usize])));
        state.held[i].iter().map(|h| force(h.node)).sum::<Vector3<f64>>().norm()
    }
}
