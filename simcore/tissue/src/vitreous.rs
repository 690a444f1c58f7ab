//! The vitreous body: a gel of elements linked like chain mail, which instruments drag along and
//! the vitrector sucks and cuts away.
//!
//! ```text
//! carry, suck ──▶ find       which elements an instrument has to do with
//!            └──▶ chainmail  they move, and what their links drag along
//! bite ─────────▶ state      elements go, with their links
//! relax ────────▶ relax      the rest comes back
//! look ─────────▶ traction   the wall is pulled, and lets go
//! draw ─────────▶ haze       densities for the picture
//! ```
//!
//! Everything is in whole µm and exact; the state is displacements and flags ([`state`]), all else
//! follows from it and the scene. `docs/vitreous.md` has the method, its proofs and pictures.

pub mod chainmail;
pub mod find;
pub mod haze;
pub mod lattice;
pub mod relax;
pub mod state;
pub mod traction;

use chainmail::{Chainmail, Mail, Outcome, Seed};
use find::{Capsule, Finder};
use haze::Haze;
use lattice::{LINKS, Lattice};
use nalgebra::{Isometry3, Vector3};
use relax::{Relaxation, Relaxer};
use scene::SceneFile;
use state::VitreousState;
use traction::Traction;

/// Share of its way along itself with which a shaft drags the gel: it slips through lengthwise, and
/// the tip pushes.
const SLIP: f64 = 0.2;
/// Longest way at a time, µm: less than the spacing of the shipped lattice, so that nothing is
/// jumped over.
const PIECE_UM: f64 = 300.0;
/// A shaft touches at least the elements within this share of their spacing, so that one it goes
/// through is never missed: half the diagonal of a cell.
const TOUCH: f64 = 0.71;

/// A shaft on its way, eye frame, mm: from the tip along +z of the instrument.
#[derive(Debug, Clone, Copy)]
pub struct Shaft {
    /// `eye_from_instrument` before and after.
    pub way: [Isometry3<f64>; 2],
    /// Outer radius.
    pub radius_mm: f64,
}

/// The vitreous of a scene and the work space of its steps.
#[derive(Debug)]
pub struct Vitreous {
    lattice: Lattice,
    /// Links of living elements.
    links: Vec<u8>,
    chainmail: Chainmail,
    finder: Finder,
    relaxer: Relaxer,
    haze: Haze,
    /// Somebody draws the densities.
    seen: bool,
    how: Relaxation,
    rows: u32,
    slip_um: i16,
    /// Elements in an instrument: 1. They do not relax.
    held: Vec<u8>,
    held_list: Vec<u32>,
    seeds: [Vec<Seed>; 3],
    /// Rows in which something moved since the last picture, a bit each.
    changed: Vec<u64>,
    /// The same since the last look at what moved.
    fresh: Vec<u64>,
}

/// What follows from a state and would take longer to derive than to copy.
#[derive(Debug, Clone)]
pub struct DerivedVitreous {
    links: Vec<u8>,
    finder: Finder,
    /// Where somebody draws the densities.
    haze: Option<Haze>,
}

impl Vitreous {
    /// The vitreous of a scene; none if it has none.
    pub fn new(scene: &SceneFile) -> Option<Self> {
        let vitreous = scene.vitreous.as_ref()?;
        let lattice = Lattice::new(scene, vitreous);
        let words = lattice.rows.len().div_ceil(64);
        let relaxation = &vitreous.relaxation;
        let mut new = Vitreous {
            links: vec![0; lattice.len()],
            chainmail: Chainmail::new(&lattice),
            finder: Finder::new(&lattice),
            relaxer: Relaxer::default(),
            haze: Haze::new(&lattice),
            seen: true,
            how: Relaxation { share: relaxation.share as f32, rest_weight: relaxation.rest_weight as f32 },
            rows: relaxation.rows,
            slip_um: (vitreous.slip_mm * 1e3) as i16,
            held: vec![0; lattice.len()],
            held_list: Vec::with_capacity(lattice.len()),
            seeds: std::array::from_fn(|_| Vec::with_capacity(lattice.len())),
            changed: vec![0; words],
            fresh: vec![0; words],
            lattice,
        };
        new.refresh(&new.start());
        Some(new)
    }

    /// The state at rest.
    pub fn start(&self) -> VitreousState {
        VitreousState::new(&self.lattice)
    }

    /// The lattice.
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// The densities as they were drawn last.
    pub fn haze(&self) -> &Haze {
        &self.haze
    }

    /// Derives everything that follows from the state; to be called when another one took its
    /// place.
    pub fn refresh(&mut self, state: &VitreousState) {
        self.links = state::living_links(&self.lattice, state);
        self.finder.forget_all();
        self.free();
        self.fresh.fill(0);
        self.changed.fill(0);
        (0..self.lattice.rows.len()).for_each(|row| self.haze.follow(&self.lattice, state, row));
        self.haze.write();
    }

    /// A copy of what follows from the present state, between two steps.
    pub fn derived(&self) -> DerivedVitreous {
        let haze = self.seen.then(|| self.haze.clone());
        DerivedVitreous { links: self.links.clone(), finder: self.finder.clone(), haze }
    }

    /// As [`Self::refresh`], where a copy was made of what follows from `state`.
    pub fn refresh_from(&mut self, state: &VitreousState, derived: &DerivedVitreous) {
        if self.seen {
            let Some(haze) = &derived.haze else { return self.refresh(state) };
            self.haze.clone_from(haze);
        }
        self.links.clone_from(&derived.links);
        self.finder.clone_from(&derived.finder);
        self.free();
        self.fresh.fill(0);
        self.changed.fill(0);
    }

    /// Takes the gel along with a shaft and holds what is inside it until [`Self::free`].
    pub fn carry(&mut self, state: &mut VitreousState, shaft: &Shaft) -> Outcome {
        let length_um = 2.0 * f64::from(self.lattice.radius_um);
        let [tip0, tip1] = shaft.way.map(|pose| pose.translation.vector * 1e3);
        let [along0, along1] = shaft.way.map(|pose| pose.rotation * Vector3::z());
        let tip_way = (tip1 - tip0).norm();
        let end_way = (tip1 + along1 * length_um - tip0 - along0 * length_um).norm();
        let longest = if tip_way > end_way { tip_way } else { end_way };
        let pieces = (longest / PIECE_UM).ceil().clamp(1.0, 100.0) as u32;
        let mut outcome = Outcome::default();
        let pose = |s: f64| (tip0 + (tip1 - tip0) * s, (along0 + (along1 - along0) * s).normalize());
        for piece in 0..pieces {
            let ends = [piece, piece + 1].map(|end| pose(f64::from(end) / f64::from(pieces)));
            outcome = outcome.and(self.carry_piece(state, ends, shaft.radius_mm * 1e3, length_um));
        }
        outcome
    }

    fn carry_piece(
        &mut self,
        state: &mut VitreousState,
        [(tip0, along0), (tip1, along1)]: [(Vector3<f64>, Vector3<f64>); 2],
        shaft_um: f64,
        length_um: f64,
    ) -> Outcome {
        let touch_um = TOUCH * f64::from(self.lattice.pitch_um);
        let radius_um = shaft_um.max(touch_um);
        let capsule = Capsule { from_um: tip0, along: along0, length_um, radius_um };
        let Vitreous { finder, lattice, seeds, held, held_list, slip_um, .. } = self;
        finder.find(lattice, state, &capsule, |e, _, t, _| {
            let from = tip0 + along0 * t;
            let way = tip1 + along1 * t - from;
            let slips = if t < radius_um { 0.0 } else { 1.0 - SLIP };
            let to = from + way - along0 * (way.dot(&along0) * slips);
            add_seeds(seeds, e, from, to);
            for (axis, seeds) in seeds.iter_mut().enumerate() {
                let Some((_, way)) = seeds.last_mut().filter(|(last, _)| *last == e as u32) else { continue };
                *way = slipping(state.shift_um[axis][e], *way, *slip_um);
            }
            hold(held, held_list, e);
        });
        self.push(state)
    }

    /// Pulls elements within `reach_mm` of `port_mm` towards it, by `way_mm` of their place
    /// (nothing where that is `None`), and no farther than the port.
    pub fn suck(
        &mut self,
        state: &mut VitreousState,
        port_mm: Vector3<f64>,
        reach_mm: f64,
        way_mm: impl Fn(&Vector3<f64>) -> Option<f64>,
    ) -> Outcome {
        let ball = ball(port_mm, reach_mm);
        let Vitreous { finder, lattice, seeds, held, held_list, .. } = self;
        finder.find(lattice, state, &ball, |e, place, _, d2| {
            let Some(way_mm) = way_mm(&(place * 1e-3)) else { return };
            let distance = d2.sqrt();
            let way = (way_mm * 1e3).clamp(0.0, PIECE_UM).min(distance);
            if distance > 1.0 {
                add_seeds(seeds, e, place, place + (ball.from_um - place) * (way / distance));
                hold(held, held_list, e);
            }
        });
        self.push(state)
    }

    /// Moves what the seeds say.
    fn push(&mut self, state: &mut VitreousState) -> Outcome {
        let mut outcome = Outcome::default();
        let mail = Mail { lattice: &self.lattice, links: &self.links };
        let fresh = &mut self.fresh;
        for (axis, seeds) in self.seeds.iter_mut().enumerate() {
            let changed = &mut |e: usize| set(fresh, usize::from(mail.lattice.row_of[e]));
            outcome = outcome.and(self.chainmail.push(mail, state, axis, seeds, changed));
            seeds.clear();
        }
        self.note(state);
        outcome
    }

    /// Removes the elements within `reach_mm` of `at_mm`; returns how many.
    pub fn bite(&mut self, state: &mut VitreousState, at_mm: Vector3<f64>, reach_mm: f64) -> u32 {
        let Vitreous { finder, lattice, seeds, .. } = self;
        finder.find(lattice, state, &ball(at_mm, reach_mm), |e, _, _, _| seeds[0].push((e as u32, 0)));
        let mut removed = 0;
        while let Some((e, _)) = self.seeds[0].pop() {
            let e = e as usize;
            let links = self.links[e];
            for k in (0..LINKS).filter(|k| links >> k & 1 == 1) {
                self.links[self.lattice.neighbour(e, k)] &= !(1 << (k ^ 1));
            }
            (self.links[e], state.status[e]) = (0, 0);
            state.shift_um.iter_mut().for_each(|s| s[e] = 0);
            set(&mut self.fresh, usize::from(self.lattice.row_of[e]));
            removed += 1;
        }
        state.removed += u64::from(removed);
        self.note(state);
        removed
    }

    /// What instruments held is free again.
    pub fn free(&mut self) {
        self.held_list.drain(..).for_each(|e| self.held[e as usize] = 0);
    }

    /// Relaxes a share of the rows that are awake.
    pub fn relax(&mut self, state: &mut VitreousState) {
        let mail = Mail { lattice: &self.lattice, links: &self.links };
        let (finder, changed) = (&mut self.finder, &mut self.changed);
        self.relaxer.relax(mail, state, self.how, &self.held, self.rows, &mut |row| {
            finder.forget(row);
            set(changed, row);
        });
    }

    /// Looks at the pull on the retina; what is pulled too hard lets go.
    pub fn look(&mut self, state: &mut VitreousState) -> Traction {
        let mail = Mail { lattice: &self.lattice, links: &self.links };
        let fresh = &mut self.fresh;
        let lattice = &self.lattice;
        let traction = traction::look(mail, state, |e| set(fresh, usize::from(lattice.row_of[e])));
        self.note(state);
        traction
    }

    /// Stops updating the densities, for runs that draw no picture.
    pub fn leave_unseen(&mut self) {
        self.seen = false;
    }

    /// Brings the densities up to date, if anybody draws them; returns how many bricks changed.
    pub fn draw(&mut self, state: &VitreousState) -> usize {
        if !self.seen {
            return 0;
        }
        let (haze, lattice) = (&mut self.haze, &self.lattice);
        drain(&mut self.changed, |row| haze.follow(lattice, state, row));
        haze.write()
    }

    /// Marks which rows changed.
    fn note(&mut self, state: &mut VitreousState) {
        let Vitreous { fresh, changed, finder, lattice, .. } = self;
        drain(fresh, |row| {
            set(changed, row);
            finder.forget(row);
            relax::wake(lattice, state, row);
        });
    }
}

fn ball(centre_mm: Vector3<f64>, radius_mm: f64) -> Capsule {
    Capsule { from_um: centre_mm * 1e3, along: Vector3::z(), length_um: 0.0, radius_um: radius_mm * 1e3 }
}

/// A way along each axis, between rounded places, so that many short ways add up to the long one.
fn add_seeds(seeds: &mut [Vec<Seed>; 3], e: usize, from_um: Vector3<f64>, to_um: Vector3<f64>) {
    for (axis, seeds) in seeds.iter_mut().enumerate() {
        let way = to_um[axis].round() - from_um[axis].round();
        if way != 0.0 {
            seeds.push((e as u32, way as i16));
        }
    }
}

/// The part of a way that a shaft takes an element along before it slips: up to `slip_um` from its
/// rest place.
fn slipping(shift: i16, way: i16, slip_um: i16) -> i16 {
    if way > 0 {
        way.min(slip_um.saturating_sub(shift)).max(0)
    } else {
        way.max((-slip_um).saturating_sub(shift)).min(0)
    }
}

fn hold(held: &mut [u8], list: &mut Vec<u32>, e: usize) {
    if held[e] == 0 {
        held[e] = 1;
        list.push(e as u32);
    }
}

fn set(bits: &mut [u64], row: usize) {
    bits[row / 64] |= 1 << (row % 64);
}

/// Calls `each` for every bit that is set, and clears it.
fn drain(bits: &mut [u64], mut each: impl FnMut(usize)) {
    for (word, bits) in bits.iter_mut().enumerate() {
        while *bits != 0 {
            each(word * 64 + bits.trailing_zeros() as usize);
            *bits &= *bits - 1;
        }
    }
}

#[cfg(test)]
mod tests {
    //! What the tests of this folder begin with.

    use super::*;

    /// The shipped scene on a lattice of `cells`.
    pub fn scene(cells: u32) -> SceneFile {
        let mut scene = SceneFile::load("vitrectomy").unwrap();
        scene.vitreous.as_mut().unwrap().lattice = cells;
        scene
    }

    /// The shipped vitreous on a lattice of `cells`.
    pub fn lattice(cells: u32) -> Lattice {
        let scene = scene(cells);
        Lattice::new(&scene, scene.vitreous.as_ref().unwrap())
    }
}
