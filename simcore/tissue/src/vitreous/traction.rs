//! What the retina feels: the stress of the gel where it holds to the wall, and where it lets go.
//!
//! An element of the wall is pulled by its living neighbours. Over a link of rest length h, a
//! neighbour that is farther by Δ along the link stretches it (stress E Δ/h, with E = 3 G for a gel
//! that keeps its volume), and one that slipped by Δ across it shears it (stress G Δ/h). The sum
//! over the links, a vector, is the stress on the retina in Pa; times h² it is a force in µN.
//! Strains are bounded by the limits, so the stress is at most that of taut links.

use super::chainmail::Mail;
use super::lattice::{LINKS, Wall};
use super::state::{ADHERED, VitreousState};

/// Young's modulus over shear modulus of a gel that keeps its volume.
const YOUNG: i32 = 3;

/// The greatest stress of a kind.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Stress {
    /// Pa.
    pub pa: f32,
    /// On which element.
    pub element: u32,
}

impl Stress {
    fn raise(&mut self, pa: f32, element: u32) {
        if pa > self.pa {
            *self = Stress { pa, element };
        }
    }
}

/// What the retina feels at an instant.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Traction {
    /// Greatest stress anywhere on the wall.
    pub greatest: Stress,
    /// Greatest stress on the vitreous base.
    pub base: Stress,
    /// Elements that let go.
    pub released: u32,
    /// One of them.
    pub released_at: u32,
}

/// Stress on an element of the wall, Pa.
pub fn stress_pa(mail: Mail, state: &VitreousState, element: usize) -> f32 {
    let mut strain = [0i32; 3];
    let (links, here) = (mail.links[element], state.shift(element));
    let steps = &mail.lattice.rows[mail.lattice.row_of[element] as usize].steps;
    for k in (0..LINKS).filter(|k| links >> k & 1 == 1) {
        let there = state.shift((element as i32 + steps[k]) as usize);
        for (c, strain) in strain.iter_mut().enumerate() {
            *strain += (there[c] - here[c]) * if c == k / 2 { YOUNG } else { 1 };
        }
    }
    let [x, y, z] = strain.map(|s| s as f32 / mail.lattice.pitch_um as f32);
    mail.lattice.modulus_pa[element] * (x * x + y * y + z * z).sqrt()
}

/// Looks at all elements that hold, and lets go those that are pulled too hard; calls `released`
/// for each.
pub fn look(mail: Mail, state: &mut VitreousState, mut released: impl FnMut(usize)) -> Traction {
    let mut traction = Traction::default();
    for &Wall { element, release_pa, base, .. } in &mail.lattice.walls {
        let e = element as usize;
        if !state.is_adhered(e) {
            continue;
        }
        let pa = stress_pa(mail, state, e);
        traction.greatest.raise(pa, element);
        if base {
            traction.base.raise(pa, element);
        } else if pa > release_pa {
            state.status[e] &= !ADHERED;
            state.released += 1;
            (traction.released, traction.released_at) = (traction.released + 1, element);
            released(e);
        }
    }
    traction
}

#[cfg(test)]
mod tests {
    use super::super::state::living_links;
    use super::super::tests::lattice;
    use super::*;

    #[test]
    fn a_stretched_and_a_sheared_link_pull_by_their_moduli() {
        let lattice = lattice(24);
        let mut state = VitreousState::new(&lattice);
        let links = living_links(&lattice, &state);
        let mail = Mail { lattice: &lattice, links: &links };
        // At the posterior pole, where the only link inwards is +z.
        let wall = lattice
            .walls
            .iter()
            .map(|w| w.element as usize)
            .find(|&e| lattice.cell(e)[..2] == [12, 12] && lattice.rest_um(e)[2] < 0);
        let wall = wall.unwrap();
        let inner = lattice.neighbour(wall, 5);
        assert_eq!(stress_pa(mail, &state, wall), 0.0);
        let (h, g) = (lattice.pitch_um as f32, lattice.modulus_pa[wall]);
        state.shift_um[2][inner] = 90;
        assert!((stress_pa(mail, &state, wall) - g * 3.0 * 90.0 / h).abs() < 1e-5);
        state.shift_um[2][inner] = 0;
        state.shift_um[0][inner] = -60;
        assert!((stress_pa(mail, &state, wall) - g * 60.0 / h).abs() < 1e-5);
    }

    #[test]
    fn what_is_pulled_too_hard_lets_go_but_never_the_base() {
        let lattice = lattice(24);
        let mut state = VitreousState::new(&lattice);
        let links = living_links(&lattice, &state);
        let mail = Mail { lattice: &lattice, links: &links };
        let inner = |base: bool| {
            let wall = lattice.walls.iter().find(|w| w.base == base).unwrap().element as usize;
            let k = (0..LINKS)
                .find(|k| links[wall] >> k & 1 == 1 && !state.is_adhered(lattice.neighbour(wall, *k)));
            (wall, k.map(|k| lattice.neighbour(wall, k)))
        };
        let (posterior, at_posterior) = inner(false);
        let (base, at_base) = inner(true);
        // Far beyond what moves allow: the limits are not this module's.
        for e in [at_posterior.unwrap(), at_base.unwrap()] {
            state.shift_um[2][e] = 10_000;
        }
        let mut released = Vec::new();
        let traction = look(mail, &mut state, |e| released.push(e));
        assert!(released.contains(&posterior) && !released.contains(&base));
        assert_eq!((traction.released as usize, state.released as usize), (released.len(), released.len()));
        assert!(traction.base.pa > 0.0 && traction.greatest.pa >= traction.base.pa);
        assert!(!state.is_adhered(posterior) && state.is_adhered(base));
    }
}
