//! Enhanced ChainMail: moves of some elements spread through the gel, as through mail, link by
//! link.
//!
//! Gibson (1997) moves an element and lets every neighbour whose link is over its limits follow by
//! the least way that mends the link. Schill, Gibson, Bender and Männer (1998) always take the
//! element with the largest violation next, which makes the method right for inhomogeneous gels.
//!
//! All limits are on differences of one coordinate of two neighbours, `low ≤ x_j − x_i ≤ high`, so
//! the three coordinates are three systems of difference constraints, and of such systems the
//! following is known. Let x be places within all limits, and let some elements s be raised to X_s.
//! Every element must at least be raised to L_j = max over s of X_s − d(s, j), where d is the
//! length of the shortest path with the links' slack as lengths; and max(x, L) is within all
//! limits, because the larger of two solutions is a solution. The violation of element j is L_j −
//! x_j. Along a path it can only shrink, so taking the largest first (Dijkstra's order) finds each
//! exactly, moves each element once, and the result depends on no order among equals. Lowering is
//! the mirror image.
//!
//! Elements that hold to the retina, or would leave the eye, take part as if they were free and are
//! then taken back, by the same method downwards: min(max(x, L), C) with C the most that the held
//! ones allow. It is within all limits, moves no held element, and brings what pushes as far as it
//! can go. How far a held element would have gone is kept: it is what the retina feels.

use super::lattice::{COMPRESS, LINKS, Lattice, SHEAR, STRETCH};
use super::state::VitreousState;

/// Longest way of a move, µm: more is done in several moves. Places of 16 bits then never overflow,
/// since displacements end within twice the eye's radius of at most 16 mm.
pub const MAX_WAY_UM: i32 = 700;

const NONE: u32 = u32::MAX;

/// What a move did.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Outcome {
    /// Moves of elements, per axis, those that were taken back included.
    pub moved: u32,
    /// Way by which a held element was dragged before it was taken back, the largest, µm; 0 if none
    /// was.
    pub held_back_um: u16,
    /// That element.
    pub held_at: u32,
}

impl Outcome {
    /// Both of two moves.
    pub fn and(self, other: Outcome) -> Outcome {
        let most = if other.held_back_um > self.held_back_um { other } else { self };
        Outcome { moved: self.moved + other.moved, ..most }
    }
}

/// An element and its way along the axis of the move, µm.
pub type Seed = (u32, i16);

/// The gel as a move sees it.
#[derive(Debug, Clone, Copy)]
pub struct Mail<'a> {
    /// At rest.
    pub lattice: &'a Lattice,
    /// Links of living elements.
    pub links: &'a [u8],
}

/// The work space: elements waiting, by violation.
#[derive(Debug, Clone)]
pub struct Chainmail {
    /// Violation of an element that waits, µm.
    overdue_um: Vec<u16>,
    /// Newest entry of each violation.
    heads: Vec<u32>,
    /// Entries: element, and the entry below it.
    entries: Vec<[u32; 2]>,
    /// Largest violation that may have entries.
    top: usize,
    /// What the last spreading moved, in its order.
    moved: Vec<(u32, u16)>,
    /// What is to be taken back.
    back: Vec<(u32, u16)>,
}

impl Chainmail {
    /// Room for a lattice.
    pub fn new(lattice: &Lattice) -> Self {
        // An element enters when it is pushed and at most once over each link.
        let most = (LINKS + 1) * lattice.len();
        Chainmail {
            overdue_um: vec![0; lattice.len()],
            heads: vec![NONE; MAX_WAY_UM as usize + 1],
            entries: Vec::with_capacity(most),
            top: 0,
            moved: Vec::with_capacity(lattice.len()),
            back: Vec::with_capacity(lattice.len()),
        }
    }

    /// Moves elements along `axis` by their ways, at most [`MAX_WAY_UM`], and whatever their links
    /// drag along: first those that go up, then those that go down. Elements that are gone are left
    /// out; held ones stay and are counted. Calls `changed` for every element that moved.
    pub fn push(
        &mut self,
        mail: Mail,
        state: &mut VitreousState,
        axis: usize,
        seeds: &[Seed],
        changed: &mut impl FnMut(usize),
    ) -> Outcome {
        let mut outcome = Outcome::default();
        for up in [true, false] {
            for &(element, way) in seeds {
                let way = if up { i32::from(way) } else { -i32::from(way) };
                if way <= 0 || !state.is_alive(element as usize) {
                    continue;
                }
                let way = way.min(MAX_WAY_UM) as u16;
                if state.is_adhered(element as usize) {
                    outcome = outcome.and(Outcome { moved: 0, held_back_um: way, held_at: element });
                } else {
                    self.wait(element, way);
                }
            }
            outcome = outcome.and(self.push_one_way(mail, state, axis, up, changed));
        }
        outcome
    }

    fn push_one_way(
        &mut self,
        mail: Mail,
        state: &mut VitreousState,
        axis: usize,
        up: bool,
        changed: &mut impl FnMut(usize),
    ) -> Outcome {
        self.spread(mail, &mut state.shift_um[axis], axis, up);
        let mut outcome = Outcome { moved: self.moved.len() as u32, ..Outcome::default() };
        self.back.clear();
        for &(element, way) in &self.moved {
            changed(element as usize);
            if state.is_adhered(element as usize) {
                self.back.push((element, way));
                outcome = outcome.and(Outcome { moved: 0, held_back_um: way, held_at: element });
            } else {
                let over = beyond_um(mail.lattice, state, element as usize, axis, up);
                if over > 0 {
                    self.back.push((element, over));
                }
            }
        }
        for i in 0..self.back.len() {
            let (element, way) = self.back[i];
            self.wait(element, way);
        }
        self.spread(mail, &mut state.shift_um[axis], axis, !up);
        outcome.moved += self.moved.len() as u32;
        outcome
    }

    /// Puts an element into the queue unless it waits with a larger violation.
    fn wait(&mut self, element: u32, violation_um: u16) {
        let known = &mut self.overdue_um[element as usize];
        if violation_um > *known {
            *known = violation_um;
            let head = &mut self.heads[violation_um as usize];
            self.entries.push([element, *head]);
            *head = self.entries.len() as u32 - 1;
            self.top = self.top.max(violation_um as usize);
        }
    }

    /// The element with the largest violation.
    fn next(&mut self) -> Option<(u32, u16)> {
        while self.top > 0 {
            let head = self.heads[self.top];
            if head == NONE {
                self.top -= 1;
                continue;
            }
            let [element, below] = self.entries[head as usize];
            self.heads[self.top] = below;
            let violation = &mut self.overdue_um[element as usize];
            // Another violation means that it was done with a larger one.
            if usize::from(*violation) == self.top {
                *violation = 0;
                return Some((element, self.top as u16));
            }
        }
        None
    }

    /// Moves what waits, and what follows, the largest violation first.
    fn spread(&mut self, mail: Mail, shift: &mut [i16], axis: usize, up: bool) {
        self.moved.clear();
        let slack: [&[u16]; LINKS] = std::array::from_fn(|k| {
            let ahead = (k % 2 == 1) == up;
            let kind = match (k / 2 == axis, ahead) {
                (false, _) => SHEAR,
                (true, true) => COMPRESS,
                (true, false) => STRETCH,
            };
            mail.lattice.limit[k / 2][kind].as_slice()
        });
        let sign = if up { 1 } else { -1 };
        while let Some((element, violation)) = self.next() {
            let e = element as usize;
            shift[e] += sign as i16 * violation as i16;
            self.moved.push((element, violation));
            let here = sign * i32::from(shift[e]);
            let steps = &mail.lattice.rows[mail.lattice.row_of[e] as usize].steps;
            let links = mail.links[e];
            for k in 0..LINKS {
                if links >> k & 1 == 0 {
                    continue;
                }
                let other = (e as i32 + steps[k]) as usize;
                let lower = if k % 2 == 1 { e } else { other };
                let behind = here - sign * i32::from(shift[other]) - i32::from(slack[k][lower]);
                if behind > 0 {
                    self.wait(other as u32, behind as u16);
                }
            }
        }
        self.entries.clear();
    }
}

/// How far an element is out of the eye after it moved along `axis`, µm; before, it was inside.
fn beyond_um(lattice: &Lattice, state: &VitreousState, element: usize, axis: usize, up: bool) -> u16 {
    if lattice.has_room(element, state.shift(element)) {
        return 0;
    }
    let place = state.place_um(lattice, element);
    if lattice.is_inside(place) {
        return 0;
    }
    let square = |c: i32| i64::from(c) * i64::from(c);
    let others: i64 = (0..3).filter(|&c| c != axis).map(|c| square(place[c])).sum();
    let mut most = (square(lattice.radius_um) - others).max(0).isqrt() as i32;
    if axis == 2 && up {
        most = most.min(lattice.front_um);
    }
    let outwards = if up { place[axis] } else { -place[axis] };
    (outwards - most).clamp(0, MAX_WAY_UM) as u16
}

#[cfg(test)]
mod tests {
    use super::super::lattice::PAD;
    use super::super::state::{ADHERED, ALIVE, broken_link, check, living_links};
    use super::super::tests::{lattice, scene};
    use super::*;
    use proptest::prelude::*;

    /// Lowest places above `x` within all limits that raise the seeds: the same demand link after
    /// link until nothing changes (Bellman and Ford), which shares nothing with the queue.
    fn brute_raise(mail: Mail, x: &[i32], axis: usize, sign: i32, seeds: &[(usize, i32)]) -> Vec<i32> {
        let mut y: Vec<i32> = x.iter().map(|v| sign * v).collect();
        seeds.iter().for_each(|&(e, to)| y[e] = y[e].max(sign * to));
        loop {
            let mut changed = false;
            for e in mail.lattice.numbers() {
                for k in (0..LINKS).filter(|k| mail.links[e] >> k & 1 == 1) {
                    let other = mail.lattice.neighbour(e, k);
                    let lower = e.min(other);
                    let plus = if sign > 0 { other > e } else { other < e };
                    let kind = if k / 2 != axis {
                        SHEAR
                    } else if plus {
                        COMPRESS
                    } else {
                        STRETCH
                    };
                    let least = y[e] - i32::from(mail.lattice.limit[k / 2][kind][lower]);
                    if y[other] < least {
                        (y[other], changed) = (least, true);
                    }
                }
            }
            if !changed {
                return y.into_iter().map(|v| sign * v).collect();
            }
        }
    }

    fn values(state: &VitreousState, axis: usize) -> Vec<i32> {
        state.shift_um[axis].iter().map(|&v| i32::from(v)).collect()
    }

    fn kill(state: &mut VitreousState, element: usize) {
        if state.is_alive(element) {
            state.status[element] = 0;
            state.shift_um.iter_mut().for_each(|s| s[element] = 0);
            state.removed += 1;
        }
    }

    #[test]
    fn a_chain_follows_step_by_step_as_gibson_describes() {
        // One row of a homogeneous gel, its neighbours cut away: pulled at its end, each element
        // follows when its link is stretched to the limit, not before; pushed, when it is
        // compressed to the limit.
        let mut scene = scene(12);
        let vitreous = scene.vitreous.as_mut().unwrap();
        vitreous.zones.clear();
        (vitreous.gel.stretch[0], vitreous.gel.compress[0]) = (0.5, 0.25);
        let lattice = Lattice::new(&scene, scene.vitreous.as_ref().unwrap());
        let row = lattice.rows[lattice.row_of[lattice.element([6, 6, 6]).unwrap()] as usize];
        let mut state = VitreousState::new(&lattice);
        let mine = row.start as usize..row.start as usize + row.len as usize;
        lattice.numbers().filter(|e| !mine.contains(e)).for_each(|e| kill(&mut state, e));
        mine.clone().for_each(|e| state.status[e] = ALIVE);
        let links = living_links(&lattice, &state);
        let mail = Mail { lattice: &lattice, links: &links };
        let mut chainmail = Chainmail::new(&lattice);
        // The spacing is 1,918 µm, so limits are 2·(1918·0.5/2) = 958 and 2·(1918·0.25/2) = 478 µm
        // (halves are whole).
        assert_eq!(lattice.pitch_um, 1918);
        let first = row.start;
        let mut pull = |state: &mut VitreousState, way: i16| {
            chainmail.push(mail, state, 0, &[(first + 4, way)], &mut |_| ())
        };
        let at = |state: &VitreousState, i: usize| state.shift_um[0][first as usize + i];
        pull(&mut state, 400);
        assert_eq!([3, 4, 5].map(|i| at(&state, i)), [0, 400, 0], "within the limits nothing follows");
        pull(&mut state, 600);
        assert_eq!([2, 3, 4, 5, 6].map(|i| at(&state, i)), [0, 42, 1000, 522, 44]);
        pull(&mut state, 700);
        assert_eq!([2, 3, 4, 5, 6, 7].map(|i| at(&state, i)), [0, 742, 1700, 1222, 744, 266]);
        for _ in 0..2 {
            pull(&mut state, -700);
        }
        assert_eq!([3, 4, 5, 6].map(|i| at(&state, i)), [742, 300, 1222, 744], "back within the play");
        assert_eq!(broken_link(&lattice, &state), None);
    }

    #[test]
    fn a_held_element_stops_the_push_where_the_links_are_taut() {
        let lattice = lattice(16);
        let mut state = VitreousState::new(&lattice);
        let links = living_links(&lattice, &state);
        let mail = Mail { lattice: &lattice, links: &links };
        let mut chainmail = Chainmail::new(&lattice);
        let middle = lattice.element([8, 8, 8]).unwrap() as u32;
        let mut last = Outcome::default();
        for _ in 0..60 {
            last = chainmail.push(mail, &mut state, 0, &[(middle, 500)], &mut |_| ());
        }
        assert!(last.held_back_um > 0 && state.is_adhered(last.held_at as usize));
        let stopped = state.shift(middle as usize)[0];
        chainmail.push(mail, &mut state, 0, &[(middle, 500)], &mut |_| ());
        assert_eq!(state.shift(middle as usize)[0], stopped, "taut links give no further");
        assert_eq!(check(&lattice, &state), Ok(()));
    }

    #[test]
    fn mirrored_moves_give_mirrored_results() {
        let mut scene = scene(16);
        let vitreous = scene.vitreous.as_mut().unwrap();
        vitreous.zones.clear();
        let lattice = Lattice::new(&scene, scene.vitreous.as_ref().unwrap());
        let links = living_links(&lattice, &VitreousState::new(&lattice));
        let mail = Mail { lattice: &lattice, links: &links };
        let mut chainmail = Chainmail::new(&lattice);
        let n = lattice.cells as i32;
        let cells = [[5, 6, 7], [6, 6, 7], [9, 4, 5]];
        for axis in 0..2 {
            let [mut a, mut b] = [VitreousState::new(&lattice), VitreousState::new(&lattice)];
            let mirror = |mut c: [i32; 3]| {
                c[axis] = n - 1 - c[axis];
                lattice.element(c).unwrap()
            };
            for way in [650, 500, 700] {
                let seeds = |way: i16, f: &dyn Fn([i32; 3]) -> usize| cells.map(|c| (f(c) as u32, way));
                let plain = |c: [i32; 3]| lattice.element(c).unwrap();
                chainmail.push(mail, &mut a, axis, &seeds(way, &plain), &mut |_| ());
                chainmail.push(mail, &mut b, axis, &seeds(-way, &mirror), &mut |_| ());
            }
            for e in lattice.numbers() {
                assert_eq!(a.shift_um[axis][e], -b.shift_um[axis][mirror(lattice.cell(e))]);
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn every_move_is_the_least_one_within_all_limits(
            cells in 8u32..12,
            dead in proptest::collection::vec(0usize..500, 0..40),
            freed in proptest::collection::vec(0usize..500, 0..60),
            moves in proptest::collection::vec(
                (0usize..3, proptest::collection::vec((0usize..500, -700i16..=700), 1..6)), 1..14),
        ) {
            let lattice = lattice(cells);
            let mut state = VitreousState::new(&lattice);
            let number = |i: usize| PAD + i % lattice.elements();
            dead.iter().for_each(|&i| kill(&mut state, number(i)));
            for i in freed {
                state.status[lattice.walls[i % lattice.walls.len()].element as usize] &= !ADHERED;
            }
            let links = living_links(&lattice, &state);
            let mail = Mail { lattice: &lattice, links: &links };
            let mut chainmail = Chainmail::new(&lattice);
            for (axis, seeds) in moves {
                // One direction at a time, so that the least move is defined.
                let up = seeds[0].1 > 0;
                let seeds: Vec<Seed> = seeds.iter()
                    .map(|&(i, way)| (number(i) as u32, if (way > 0) == up { way } else { -way }))
                    .collect();
                let before = values(&state, axis);
                let mut changed = vec![false; lattice.len()];
                chainmail.push(mail, &mut state, axis, &seeds, &mut |e| changed[e] = true);
                let after = values(&state, axis);
                prop_assert_eq!(check(&lattice, &state), Ok(()));
                prop_assert!(lattice.numbers().all(|e| changed[e] || before[e] == after[e]));

                // Raised as far as asked for, then no farther than what is held allows, each by
                // brute force.
                let sign = if up { 1 } else { -1 };
                let free = seeds.iter().map(|&(e, way)| (e as usize, i32::from(way)));
                let free = free.filter(|&(e, _)| state.is_alive(e) && !state.is_adhered(e));
                let targets: Vec<_> = free.map(|(e, way)| (e, before[e] + way)).collect();
                let raised = brute_raise(mail, &before, axis, sign, &targets);
                let mut caps = Vec::new();
                for e in lattice.numbers().filter(|&e| state.is_alive(e)) {
                    let mut place = state.place_um(&lattice, e);
                    place[axis] += raised[e] - after[e];
                    let mut most = raised[e];
                    while !lattice.is_inside(place) {
                        place[axis] -= sign;
                        most -= sign;
                    }
                    caps.push((e, if state.is_adhered(e) { before[e] } else { most }));
                }
                let expected = brute_raise(mail, &raised, axis, -sign, &caps);
                for e in lattice.numbers().filter(|&e| state.is_alive(e)) {
                    prop_assert_eq!(after[e], expected[e], "element {}", e);
                }
            }
        }
    }
}
