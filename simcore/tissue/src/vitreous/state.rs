//! The vitreous' share of the state: displacements in whole µm, so that every operation on them is
//! exact and a checkpoint is small (7 bytes an element).

use super::lattice::{COMPRESS, LINKS, Lattice, SHEAR, STRETCH};
use serde::{Deserialize, Serialize};

/// Bit of [`VitreousState::status`]: the element is there.
pub const ALIVE: u8 = 1;
/// Bit of [`VitreousState::status`]: the element holds to the retina.
pub const ADHERED: u8 = 2;

/// The vitreous, as arrays over the elements of a [`Lattice`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct VitreousState {
    /// Way from the rest place along x, y and z of the eye frame, µm.
    #[serde(with = "crate::pod_serde::lists")]
    pub shift_um: [Vec<i16>; 3],
    /// [`ALIVE`] and [`ADHERED`].
    #[serde(with = "crate::pod_serde::list")]
    pub status: Vec<u8>,
    /// Rows that may not be at rest, a bit each, for elements of even and odd cells.
    pub awake: [Vec<u64>; 2],
    /// Row at which relaxation goes on.
    pub cursor: u32,
    /// Cells it is at, even (0) or odd (1).
    pub parity: u32,
    /// Elements removed.
    pub removed: u64,
    /// Elements that came off the retina since the start.
    pub released: u64,
    /// Milestones of the removed volume that were reported.
    pub milestones: u64,
    /// No detachment is reported before this exposure, ns.
    pub quiet_until_ns: u64,
    /// The warning about traction is out.
    pub warned: bool,
    /// The warning about a tear at the base is out.
    pub tear_warned: bool,
}

impl VitreousState {
    /// The vitreous at rest.
    pub fn new(lattice: &Lattice) -> Self {
        let mut status = vec![0; lattice.len()];
        status[lattice.numbers()].fill(ALIVE);
        for wall in lattice.walls.iter().filter(|w| !w.detached) {
            status[wall.element as usize] |= ADHERED;
        }
        let words = lattice.rows.len().div_ceil(64);
        VitreousState {
            shift_um: std::array::from_fn(|_| vec![0; lattice.len()]),
            status,
            awake: [vec![0; words], vec![0; words]],
            ..VitreousState::default()
        }
    }

    /// Displacement of an element, µm.
    pub fn shift(&self, element: usize) -> [i32; 3] {
        let [x, y, z] = &self.shift_um;
        [i32::from(x[element]), i32::from(y[element]), i32::from(z[element])]
    }

    /// Place of an element, eye frame, µm.
    pub fn place_um(&self, lattice: &Lattice, element: usize) -> [i32; 3] {
        let (rest, shift) = (lattice.rest_um(element), self.shift(element));
        [rest[0] + shift[0], rest[1] + shift[1], rest[2] + shift[2]]
    }

    /// True if the element is there.
    pub fn is_alive(&self, element: usize) -> bool {
        self.status[element] & ALIVE != 0
    }

    /// True if the element holds to the retina.
    pub fn is_adhered(&self, element: usize) -> bool {
        self.status[element] & ADHERED != 0
    }

    /// Volume that was removed, µm³, to the last one.
    pub fn removed_um3(&self, lattice: &Lattice) -> u64 {
        self.removed * lattice.cell_um3()
    }

    /// Volume that is left, µm³, counted from the elements.
    pub fn remaining_um3(&self, lattice: &Lattice) -> u64 {
        self.status.iter().filter(|&&s| s & ALIVE != 0).count() as u64 * lattice.cell_um3()
    }
}

/// Links of living elements to living elements, a byte an element.
pub fn living_links(lattice: &Lattice, state: &VitreousState) -> Vec<u8> {
    let mut links = vec![0; lattice.len()];
    for e in lattice.numbers().filter(|&e| state.is_alive(e)) {
        for k in (0..LINKS).filter(|k| lattice.links[e] >> k & 1 == 1) {
            links[e] |= u8::from(state.is_alive(lattice.neighbour(e, k))) << k;
        }
    }
    links
}

/// The first living link that is over its limits: its element and axis.
pub fn broken_link(lattice: &Lattice, state: &VitreousState) -> Option<(usize, usize)> {
    for e in lattice.numbers().filter(|&e| state.is_alive(e)) {
        for axis in (0..3).filter(|a| lattice.links[e] & (2 << (2 * a)) != 0) {
            let other = lattice.neighbour(e, 2 * axis + 1);
            if !state.is_alive(other) {
                continue;
            }
            for c in 0..3 {
                let apart = i32::from(state.shift_um[c][other]) - i32::from(state.shift_um[c][e]);
                let (low, high) = if c == axis { (COMPRESS, STRETCH) } else { (SHEAR, SHEAR) };
                let [low, high] = [low, high].map(|kind| i32::from(lattice.limit[axis][kind][e]));
                if !(-low..=high).contains(&apart) {
                    return Some((e, axis));
                }
            }
        }
    }
    None
}

/// Refuses a state that does not fit the lattice, or that a run could not have reached.
///
/// # Errors
/// With the first thing that is wrong.
pub fn check(lattice: &Lattice, state: &VitreousState) -> Result<(), &'static str> {
    let words = lattice.rows.len().div_ceil(64);
    let lengths = state.shift_um.iter().all(|s| s.len() == lattice.len())
        && state.status.len() == lattice.len()
        && state.awake.iter().all(|a| a.len() == words);
    if !lengths {
        return Err("the vitreous has another size than the scene's");
    }
    let numbers = lattice.numbers();
    let unused = (0..lattice.len()).filter(|e| !numbers.contains(e));
    let unused_ok = unused.into_iter().all(|e| state.status[e] == 0 && state.shift(e) == [0; 3]);
    let known = state.status.iter().all(|&s| matches!(s, 0 | 1 | 3));
    let alive = state.status.iter().filter(|&&s| s & ALIVE != 0).count();
    let balanced = state.removed.checked_add(alive as u64) == Some(lattice.elements() as u64);
    let beyond = lattice.rows.len() % 64;
    let awake_ok = beyond == 0 || state.awake.iter().all(|a| a[words - 1] >> beyond == 0);
    if !unused_ok || !known || !balanced || !awake_ok {
        return Err("the counts of the vitreous's elements do not add up");
    }
    let walls = |e: usize| lattice.walls.binary_search_by_key(&(e as u32), |w| w.element).is_ok();
    let adhered = numbers.clone().filter(|&e| state.is_adhered(e));
    if state.cursor as usize > lattice.rows.len() || state.parity > 1 {
        return Err("the vitreous: its next row to relax is out of range");
    }
    if adhered.into_iter().any(|e| state.shift(e) != [0; 3] || !walls(e)) {
        return Err("an element of the vitreous is attached to the retina and away from it");
    }
    let places = numbers.filter(|&e| state.is_alive(e)).map(|e| state.place_um(lattice, e));
    if !places.into_iter().all(|p| lattice.is_inside(p)) || broken_link(lattice, state).is_some() {
        return Err("an element of the vitreous is out of its limits");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::tests::lattice;
    use super::*;

    #[test]
    fn a_state_at_rest_is_accepted_and_defects_are_refused() {
        let lattice = lattice(16);
        let state = VitreousState::new(&lattice);
        assert_eq!(check(&lattice, &state), Ok(()));
        let middle = lattice.element([8; 3]).unwrap();
        let wall = lattice.walls[5].element as usize;
        let defects: [&dyn Fn(&mut VitreousState); 9] = [
            &|s| s.shift_um[1][middle] = 20_000,
            &|s| s.shift_um[2][wall] = 1,
            &|s| s.status[middle] = 0,
            &|s| s.status[middle] = 3,
            &|s| s.status[0] = 1,
            &|s| s.removed = 1,
            &|s| s.cursor = 1 << 20,
            &|s| s.awake[1].push(0),
            &|s| s.shift_um[0].truncate(9),
        ];
        for (i, defect) in defects.iter().enumerate() {
            let mut broken = state.clone();
            defect(&mut broken);
            assert!(check(&lattice, &broken).is_err(), "defect {i}");
        }
    }
}
