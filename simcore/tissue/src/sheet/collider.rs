//! Instruments against a sheet: ZCOLL's look, which side the instrument is on, and what its push
//! moves.

use super::body::SheetBody;
use super::mesh::SheetMesh;
use super::state::{NODE_PINNED, Pierced, SheetContact, SheetState};
use crate::constants::{CHECKED_WAY_MM, NEEDLE_OUT_MM, SUBSTEP_S, UNDER_MARGIN_MM};
use crate::needle::Needle;
use collision::backend::{self, Backend, BackendChoice};
use collision::continuous::path_hits;
use collision::instrument_image::{InstrumentImage, NOTHING, Volume};
use collision::raster::DEPTH_STEPS;
use collision::surface::{CollisionError, Surface};
use collision::zcoll::{Contacts, Zcoll};
use nalgebra::{Isometry3, UnitVector3, Vector3};
use protocol::handles::{HOOK_THICKNESS_MM, JAW_LENGTH_MM, Tool};
use protocol::scene::{NODE_DEAD, NODE_FREE};
use scene::SceneFile;
use std::ops::Range;

/// What takes pushed tissue sideways with the tip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Friction {
    /// Coulomb: at most this share of the push, and no farther than the tip.
    Coulomb(f32),
    /// This share of the tip's way.
    Drag(f32),
}

/// How instruments meet a sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Sideways.
    pub friction: Friction,
    /// Pushed nodes become as fast as the tip.
    pub follows_tip: bool,
    /// An instrument under the sheet lifts it. One that is not lifted is left alone by what is
    /// under it.
    pub lifts: bool,
    /// Force at which a needle goes through, µN; `None` where needles are somebody else's.
    pub pierce_un: Option<f64>,
    /// Nothing meets triangles of which all nodes are pinned.
    pub without_pinned: bool,
}

impl Contact {
    /// True if instruments can meet a node of this flag.
    fn meets(&self, flag: u32) -> bool {
        flag != NODE_DEAD && !(self.without_pinned && flag == NODE_PINNED)
    }

    /// That of a scene's membrane.
    pub fn membrane(scene: &SceneFile) -> Self {
        Contact {
            friction: Friction::Coulomb(scene.contact.friction as f32),
            follows_tip: true,
            lifts: true,
            pierce_un: Some(scene.needle.unwrap_or_default().pierce_un),
            without_pinned: false,
        }
    }
}

/// An instrument in a substep, eye frame.
#[derive(Debug, Clone, Copy)]
pub struct Pusher<'a> {
    /// Number of the instrument.
    pub instrument: usize,
    /// What it is.
    pub tool: Tool,
    /// Its collision image.
    pub image: &'a InstrumentImage,
    /// Where it is.
    pub eye_from_instrument: Isometry3<f64>,
    /// Way of the tip in the substep, mm.
    pub tip_step_mm: Vector3<f64>,
    /// Way of tip and jaws in the substep, mm.
    pub travelled_mm: f64,
    /// Tip at the begin of the step, mm.
    pub tip_from_mm: Vector3<f64>,
    /// As a needle, if it is one.
    pub needle: Option<Needle>,
}

/// What a push did.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Pushed {
    /// What the looks found: ahead, and from the handle where the instrument is under the sheet.
    pub found: [Contacts; 2],
    /// Nodes that it lifts, where it has just begun to lift.
    pub hooked: Option<usize>,
    /// A needle has gone through against this force, µN.
    pub pierced_un: Option<f64>,
    /// A needle has come out.
    pub needle_out: bool,
}

/// What instruments meet of a sheet.
#[derive(Debug)]
pub struct Collider {
    zcoll: Zcoll,
    volume: Volume,
    contact: Contact,
    /// 1 for each triangle that instruments can meet.
    active: Vec<u8>,
    /// Numbers from the lowest to the highest of a node that they can meet; most of a sheet that is
    /// pinned is outside.
    span: Range<usize>,
    /// Nodes moved by the last push.
    moved: Vec<u32>,
}

impl Collider {
    /// Images of `volume`, lists for `mesh`.
    ///
    /// # Errors
    /// If the volume or the mesh cannot be drawn.
    pub fn new(volume: Volume, contact: Contact, mesh: &SheetMesh) -> Result<Self, CollisionError> {
        Ok(Collider {
            zcoll: Zcoll::new(volume, &mesh.triangles, mesh.nodes())?,
            volume,
            contact,
            active: vec![1; mesh.triangles.len()],
            span: 0..mesh.nodes(),
            moved: Vec::with_capacity(mesh.nodes()),
        })
    }

    /// The sheet as the collision queries see it.
    pub fn surface<'a>(&'a self, mesh: &'a SheetMesh, state: &'a SheetState) -> Surface<'a> {
        state.surface(mesh, &self.active)
    }

    /// 1 for each triangle that instruments can meet.
    pub fn active(&self) -> &[u8] {
        &self.active
    }

    /// Numbers from the lowest to the highest of a node that instruments can meet.
    pub fn span(&self) -> Range<usize> {
        self.span.clone()
    }

    /// Derives which triangles can be met.
    pub fn refresh(&mut self, mesh: &SheetMesh, state: &SheetState) {
        let contact = self.contact;
        self.active.copy_from_slice(&state.triangle_alive);
        for (active, nodes) in self.active.iter_mut().zip(&mesh.triangles) {
            *active &= u8::from(nodes.iter().any(|&n| contact.meets(state.flag[n as usize])));
        }
        let first = state.flag.iter().position(|&f| contact.meets(f)).unwrap_or(0);
        self.span = first..state.flag.iter().rposition(|&f| contact.meets(f)).map_or(first, |last| last + 1);
    }

    /// True if the box around the nodes that can be met comes within `reach_mm` of `point`, axis by
    /// axis.
    pub fn is_near(&self, state: &SheetState, point: &Vector3<f64>, reach_mm: f64) -> bool {
        let (contact, flags) = (self.contact, &state.flag[self.span.clone()]);
        (0..3).all(|axis| {
            let places = || state.position_mm[axis][self.span.clone()].iter().zip(flags);
            let places = || places().filter(|(_, flag)| contact.meets(**flag));
            let near = |side: f64| places().any(|(&p, _)| side * (f64::from(p) - point[axis]) < reach_mm);
            near(1.0) && near(-1.0)
        })
    }

    /// Of the pixels of hook and jaws in which the sheet was passed: does it lie above their middle
    /// in most? `None` where only shaft was.
    fn above_middle(&self, image: &InstrumentImage) -> Option<bool> {
        let (mut above, mut below) = (0, 0);
        for hit in self.zcoll.hits() {
            let pixel = hit.pixel as usize;
            let (bottom, back) = (image.depth[pixel], image.back().depth[pixel]);
            if back != NOTHING {
                let top = DEPTH_STEPS - back;
                let higher = 2 * (bottom + hit.depth) > bottom + top;
                (above, below) = (above + i32::from(higher), below + i32::from(!higher));
            }
        }
        (above + below > 0).then_some(above > below)
    }

    /// Contact that began on the far side of the instrument came round an edge: the instrument is
    /// **under** the sheet until it is clear. Where hook or jaws were passed, that is so if most
    /// pixels have the sheet above their middle; where only shaft was, if the first contact is
    /// deeper than the instrument's way since the last look.
    fn classify(&self, contact: &mut SheetContact, pusher: &Pusher, found: &Contacts) {
        let touching = found.pixels > 0;
        if !touching {
            (contact.under, contact.hooked) = (false, false);
        } else if !contact.in_contact {
            let deepest_mm = self.volume.depth_steps_mm(found.deepest);
            let deep = deepest_mm > pusher.travelled_mm + UNDER_MARGIN_MM;
            let above = if self.contact.lifts { self.above_middle(pusher.image) } else { None };
            contact.under = above.unwrap_or(deep);
        }
        contact.in_contact = touching;
    }

    /// Moves the colliding nodes along `along` (Eq. 1). Friction takes them sideways with the tip.
    fn displace(
        &mut self,
        state: &mut SheetState,
        along: &UnitVector3<f64>,
        tip_step_mm: &Vector3<f64>,
        radius: f32,
    ) {
        let speed = (tip_step_mm.dot(along) / SUBSTEP_S).max(0.0) as f32;
        let slide = (tip_step_mm - along.into_inner() * tip_step_mm.dot(along)).map(|c| c as f32);
        let ahead = along.map(|c| c as f32);
        for (node, steps) in self.zcoll.displaced() {
            if state.flag[node] != NODE_FREE {
                continue;
            }
            let way = self.volume.depth_steps_mm(steps) as f32;
            let v = state.velocity(node);
            let mut p = state.position(node) + ahead * way;
            match self.contact.friction {
                Friction::Coulomb(share) if share > 0.0 => {
                    p += dragged(&slide, &(v - ahead * v.dot(&ahead)), share * way);
                }
                Friction::Coulomb(_) => {}
                Friction::Drag(share) => p += slide * share,
            }
            let distance = p.norm();
            state.set_position(node, if distance > radius { p * (radius / distance) } else { p });
            let lacking = speed - v.dot(&ahead);
            if self.contact.follows_tip && lacking > 0.0 {
                state.set_velocity(node, v + ahead * lacking);
            }
            self.moved.push(node as u32);
        }
    }
}

/// Way of a node sideways in a substep by friction: towards the tip's own, at most `limit_mm`.
fn dragged(slide_mm: &Vector3<f32>, velocity_mm_s: &Vector3<f32>, limit_mm: f32) -> Vector3<f32> {
    let lag = slide_mm - velocity_mm_s * SUBSTEP_S as f32;
    let length = lag.norm();
    if length > limit_mm { lag * (limit_mm / length) } else { lag }
}

impl SheetBody {
    /// Chooses what makes the looks: the processor or a GPU. It changes no result.
    pub fn choose_collision(
        &mut self,
        state: &SheetState,
        wanted: Backend,
        image: &InstrumentImage,
        clock: &mut dyn FnMut() -> u64,
    ) -> BackendChoice {
        let Collider { zcoll, active, .. } = &mut self.collider;
        let surface = state.surface(&self.mesh, active);
        backend::choose_backend(zcoll, wanted, image, &surface, clock)
    }

    /// True if the box around the nodes that can be met comes within `reach_mm` of `point`, axis by
    /// axis.
    pub fn is_near(&self, state: &SheetState, point: &Vector3<f64>, reach_mm: f64) -> bool {
        self.collider.is_near(state, point, reach_mm)
    }

    /// Nodes that the last [`Self::push`] moved.
    pub fn moved(&self) -> &[u32] {
        &self.collider.moved
    }

    /// An instrument leaves the sheet alone.
    pub fn leave(&mut self, state: &mut SheetState, instrument: usize) {
        self.collider.moved.clear();
        state.contact[instrument] = SheetContact::default();
    }

    /// Pushes an instrument that holds nothing of the sheet into it, or lifts it where the
    /// instrument is under it.
    pub fn push(&mut self, state: &mut SheetState, pusher: &Pusher) -> Pushed {
        let (i, tip) = (pusher.instrument, pusher.eye_from_instrument.translation.vector);
        let mut pushed = Pushed::default();
        let skips_needles = self.collider.contact.pierce_un.is_none() && pusher.tool == Tool::Needle;
        let reach_mm = self.collider.volume.reach_mm();
        self.collider.moved.clear();
        if skips_needles || !state.held[i].is_empty() || !self.is_near(state, &tip, reach_mm) {
            state.contact[i] = SheetContact::default();
            return pushed;
        }
        let mut contact = state.contact[i];
        let Collider { zcoll, active, .. } = &mut self.collider;
        let surface = state.surface(&self.mesh, active);
        let found = zcoll.query(pusher.image, &pusher.eye_from_instrument.inverse(), &surface);
        pushed.found[0] = found;
        if found.pixels == 0 && self.jumped_through(state, pusher) {
            (contact.in_contact, contact.under) = (true, true);
        } else if self.pierces(state, &mut contact, pusher, &mut pushed) {
            (contact.in_contact, contact.under) = (true, false);
        } else {
            self.collider.classify(&mut contact, pusher, &found);
            self.displace(state, &mut contact, pusher, &mut pushed);
        }
        state.contact[i] = contact;
        pushed
    }

    fn displace(
        &mut self,
        state: &mut SheetState,
        contact: &mut SheetContact,
        pusher: &Pusher,
        pushed: &mut Pushed,
    ) {
        let handle = pusher.eye_from_instrument.rotation * Vector3::z_axis();
        let radius = self.material.radius_mm;
        if contact.in_contact && !contact.under {
            self.collider.displace(state, &-handle, &pusher.tip_step_mm, radius);
        } else if contact.under && self.collider.contact.lifts {
            let Collider { zcoll, active, .. } = &mut self.collider;
            let surface = state.surface(&self.mesh, active);
            let lifted = zcoll.query_reversed(pusher.image, &pusher.eye_from_instrument.inverse(), &surface);
            pushed.found[1] = lifted;
            // What lies deeper lies below hook and jaws.
            let jaws = pusher.tool == Tool::Forceps;
            let thick_mm = if jaws { JAW_LENGTH_MM } else { HOOK_THICKNESS_MM } + UNDER_MARGIN_MM;
            if lifted.pixels > 0 && self.collider.volume.depth_steps_mm(lifted.deepest) <= thick_mm {
                self.collider.displace(state, &handle, &pusher.tip_step_mm, radius);
                pushed.hooked = (!contact.hooked).then(|| self.collider.zcoll.displaced().count());
                contact.hooked = true;
            }
        }
    }

    /// True if a fast tip crossed the sheet on its way in this step so far, as the sheet lies now,
    /// and went so far beyond it that the collision volume no longer holds it. The instrument is
    /// then under the sheet.
    fn jumped_through(&self, state: &SheetState, pusher: &Pusher) -> bool {
        let (from, to) = (pusher.tip_from_mm, pusher.eye_from_instrument.translation.vector);
        let fast = self.collider.contact.lifts && (to - from).norm() > CHECKED_WAY_MM;
        fast && path_hits(from.into(), to.into(), &self.collider.surface(&self.mesh, state))
    }

    /// True if a needle has gone through the sheet, before or now: then it pushes nothing, and the
    /// hole follows its shaft.
    fn pierces(
        &self,
        state: &mut SheetState,
        contact: &mut SheetContact,
        pusher: &Pusher,
        pushed: &mut Pushed,
    ) -> bool {
        let (Some(needle), Some(pierce_un)) = (&pusher.needle, self.collider.contact.pierce_un) else {
            contact.pierced = None;
            return false;
        };
        if let Some(hole) = contact.pierced {
            if !self.drag_hole(state, &hole, needle) {
                contact.pierced = None;
                pushed.needle_out = true;
            }
            return true;
        }
        let resistance_un = self.resistance_un(&needle.axis_in_eye);
        if resistance_un <= pierce_un {
            return false;
        }
        // A look in every substep keeps the sheet just ahead of the tip that presses on it: the
        // tip's point lies there, too.
        let tip_in_eye_mm = needle.tip_in_eye_mm - needle.axis_in_eye.into_inner() * NEEDLE_OUT_MM;
        let inside = Needle { tip_in_eye_mm, ..*needle };
        let surface = self.collider.surface(&self.mesh, state);
        let found = inside.in_mesh(&surface, self.collider.volume.depth_mm);
        let Some(place) = found.and_then(|p| p.place) else { return false };
        contact.pierced = Some(Pierced { triangle: place.triangle, weights: place.weights });
        pushed.pierced_un = Some(resistance_un);
        true
    }

    /// Force with which the nodes that were passed press back along the shaft, µN. Added up in
    /// whole pN, so that the order of the nodes does not matter.
    fn resistance_un(&self, towards_handle: &UnitVector3<f64>) -> f64 {
        let force = |n: usize| Vector3::from(self.solver.force_un.each_ref().map(|f| f64::from(f[n])));
        let along = |n: usize| (force(n).dot(towards_handle) * 1e6) as i64;
        let sum = self.collider.zcoll.displaced().fold(0i64, |sum, (n, _)| sum.saturating_add(along(n)));
        sum as f64 * 1e-6
    }

    /// Moves the corners around a hole so that it lies on the needle's shaft; `false` if the needle
    /// is out of it, or the hole is gone.
    fn drag_hole(&self, state: &mut SheetState, hole: &Pierced, needle: &Needle) -> bool {
        if state.triangle_alive[hole.triangle as usize] == 0 {
            return false;
        }
        let nodes = self.mesh.triangles[hole.triangle as usize].map(|n| n as usize);
        let corner = |k: usize| state.position(nodes[k]).map(f64::from) * hole.weights[k];
        let at = corner(0) + corner(1) + corner(2);
        let way = needle.tip_in_eye_mm - at;
        let before_hole_mm = way.dot(&needle.axis_in_eye);
        if before_hole_mm > NEEDLE_OUT_MM {
            return false;
        }
        let aside = way - needle.axis_in_eye.into_inner() * before_hole_mm;
        let squares: f64 = hole.weights.iter().map(|w| w * w).sum();
        for (&node, weight) in nodes.iter().zip(hole.weights) {
            if state.flag[node] == NODE_FREE {
                let move_mm = (aside * (weight / squares)).map(|c| c as f32);
                state.set_position(node, state.position(node) + move_mm);
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Coulomb: what sticks goes with the tip, what slides is dragged by its share of the push, and
    /// what keeps up is left alone.
    #[test]
    fn friction_drags_no_farther_than_the_tip_and_no_more_than_its_share() {
        let slide = Vector3::new(0.003f32, -0.004, 0.0);
        let rest = Vector3::zeros();
        let stuck = dragged(&slide, &rest, 1.0);
        assert!((stuck - slide).norm() < 1e-7, "{stuck}");
        let limit = 0.4 * slide.norm();
        let slipping = dragged(&slide, &rest, limit);
        assert!((slipping.norm() - limit).abs() < 1e-7 && slipping.dot(&slide) > 0.0);
        let along = slide / SUBSTEP_S as f32;
        assert!(dragged(&slide, &along, 1.0).norm() < 1e-7);
    }
}
