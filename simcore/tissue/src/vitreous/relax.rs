//! Relaxation: elements go back towards the middle of their neighbours and their own rest place,
//! within the limits (Gibson 1997: the second half of the method, elastic where the first is only
//! geometric).
//!
//! An element at displacement u wants (Σ u_j) / (n + w), with its n neighbours' displacements u_j
//! and the weight w of its rest place, rounded towards zero. It goes a share of the way, at least
//! one µm, and stops at the limits of its links; its own place is within them, so there is always
//! room. Then:
//! - a limit is never broken, because the neighbours of an element of an even cell are odd and rest
//!   meanwhile;
//! - it converges: let M be the largest displacement along an axis. What an element wants is at
//!   most n·M/(n + w), so at most M − 1, and every limit gives at least 1 µm, so after an even and
//!   an odd pass no displacement is above M − 1. (An element that the wall of the eye stops waits;
//!   its neighbours go on.)
//!
//! The work is bounded: a call does a number of rows of the lattice and goes on there the next
//! time. Rows in which nothing moves any more sleep, until something moves in them or beside them.

use super::chainmail::Mail;
use super::lattice::{COMPRESS, LINKS, Lattice, PAD, Row, SHEAR, STRETCH, TOGETHER, block};
use super::set;
use super::state::{ADHERED, ALIVE, VitreousState};

/// Wakes a row in which something moved, and the rows beside it.
pub fn wake(lattice: &Lattice, state: &mut VitreousState, row: usize) {
    let beside = lattice.rows[row].beside.map(usize::from);
    for row in beside.into_iter().chain([row]) {
        state.awake.iter_mut().for_each(|awake| set(awake, row));
    }
}

/// How an element goes back.
#[derive(Debug, Clone, Copy)]
pub struct Relaxation {
    /// Share of the way at a time, in steps of 1/256.
    pub share: f32,
    /// Weight of the rest place beside one neighbour's.
    pub rest_weight: f32,
}

/// Work space for a row.
#[derive(Debug, Clone)]
pub struct Relaxer {
    simd: pulp::Arch,
    wanted: [[i16; PAD]; 3],
}

impl Default for Relaxer {
    fn default() -> Self {
        Relaxer { simd: pulp::Arch::new(), wanted: [[0; PAD]; 3] }
    }
}

impl Relaxer {
    /// Relaxes up to `rows` rows that are awake; elements with a mark in `held` stay. Calls
    /// `changed` for every row in which something moved.
    pub fn relax(
        &mut self,
        mail: Mail,
        state: &mut VitreousState,
        how: Relaxation,
        held: &[u8],
        rows: u32,
        changed: &mut impl FnMut(usize),
    ) {
        let all = mail.lattice.rows.len();
        let mut swept = 0;
        for _ in 0..rows {
            let parity = state.parity as usize;
            let Some(row) = next_awake(&state.awake[parity], state.cursor as usize, all) else {
                (state.cursor, state.parity) = (0, 1 - state.parity);
                swept += 1;
                if swept == 2 {
                    break;
                }
                continue;
            };
            state.cursor = row as u32 + 1;
            if self.relax_row(mail, state, how, held, row) {
                changed(row);
            } else {
                state.awake[parity][row / 64] &= !(1 << (row % 64));
            }
        }
    }

    /// One parity of a row; true if anything moved.
    fn relax_row(
        &mut self,
        mail: Mail,
        state: &mut VitreousState,
        how: Relaxation,
        held: &[u8],
        number: usize,
    ) -> bool {
        let row = &mail.lattice.rows[number];
        for (axis, wanted) in self.wanted.iter_mut().enumerate() {
            self.simd.dispatch(Want { mail, shift: &state.shift_um[axis], how, row, axis, wanted });
        }
        let (start, len) = (row.start as usize, usize::from(row.len));
        let odd = u32::from(row.x0) + u32::from(row.yz[0]) + u32::from(row.yz[1]) + state.parity;
        let (mut moved, first) = (false, mail.lattice.rest_um(start));
        for i in ((odd & 1) as usize..len).step_by(2) {
            let e = start + i;
            let free = state.status[e] & (ALIVE | ADHERED) == ALIVE && held[e] == 0;
            let [x, y, z] = &mut state.shift_um;
            let to = [self.wanted[0][i], self.wanted[1][i], self.wanted[2][i]];
            if !free || to == [x[e], y[e], z[e]] {
                continue;
            }
            let along = i as i32 * mail.lattice.pitch_um;
            let [x1, y1, z1] = to.map(i32::from);
            let place = [first[0] + along + x1, first[1] + y1, first[2] + z1];
            if mail.lattice.is_inside(place) {
                (x[e], y[e], z[e]) = (to[0], to[1], to[2]);
                moved = true;
            }
        }
        if moved {
            wake(mail.lattice, state, number);
        }
        moved
    }
}

/// Where the elements of a row want to go along an axis, within their links' limits. Plain loops
/// over a number of elements that the compiler knows, so that it takes all of them at a time and
/// keeps them in registers; whole numbers and one division, so that every instruction set gives the
/// same. What comes out behind the row's end, which the lattice's padding allows, is not used.
struct Want<'a> {
    mail: Mail<'a>,
    shift: &'a [i16],
    how: Relaxation,
    row: &'a Row,
    axis: usize,
    wanted: &'a mut [i16; PAD],
}

impl pulp::NullaryFnOnce for Want<'_> {
    type Output = ();

    #[inline(always)]
    fn call(mut self) {
        let len = usize::from(self.row.len).min(PAD);
        for from in (0..len).step_by(TOGETHER) {
            self.together(from);
        }
    }
}

/// `x as i32` for what is below 2²⁴, and for what is not a number; a conversion that saturates
/// would be done one by one.
#[inline(always)]
fn towards_zero(x: f32) -> i32 {
    let bits = x.to_bits();
    let places = 150u32.wrapping_sub(bits >> 23 & 0xff).min(31);
    let whole = ((bits & 0x7f_ffff | 0x80_0000) >> places) as i32;
    if bits >> 31 == 0 { whole } else { -whole }
}

impl Want<'_> {
    #[inline(always)]
    fn together(&mut self, from: usize) {
        let start = self.row.start as usize + from;
        let links = block(self.mail.links, start);
        let (mut low, mut high) = ([i16::MIN; TOGETHER], [i16::MAX; TOGETHER]);
        let mut sum = [0i32; TOGETHER];
        for k in 0..LINKS {
            let other = (start as i32 + self.row.steps[k]) as usize;
            let lower = if k % 2 == 1 { start } else { other };
            let limits = &self.mail.lattice.limit[k / 2];
            // Up to where it may go over and under the neighbour: towards it the link is
            // compressed.
            let (over, under) = match (k / 2 == self.axis, k % 2 == 1) {
                (false, _) => (SHEAR, SHEAR),
                (true, true) => (COMPRESS, STRETCH),
                (true, false) => (STRETCH, COMPRESS),
            };
            let (over, under) = (block(&limits[over], lower), block(&limits[under], lower));
            let shift = block(self.shift, other);
            for i in 0..TOGETHER {
                let mask = -i16::from(links[i] >> k & 1);
                let top = shift[i].saturating_add(over[i] as i16);
                let bottom = shift[i].saturating_sub(under[i] as i16);
                high[i] = high[i].min(top & mask | i16::MAX & !mask);
                low[i] = low[i].max(bottom & mask | i16::MIN & !mask);
                sum[i] += i32::from(shift[i] & mask);
            }
        }
        let now = block(self.shift, start);
        let share = (self.how.share * 256.0) as i32;
        let wanted = &mut self.wanted[from..][..TOGETHER];
        for i in 0..TOGETHER {
            let neighbours = links[i].count_ones() as f32;
            let middle = towards_zero(sum[i] as f32 / (neighbours + self.how.rest_weight));
            let way = middle - i32::from(now[i]);
            // Rounded away from zero, and never past the middle: the share is at most 1.
            let part = (way.abs() * share + 255) >> 8;
            let to = i32::from(now[i]) + if way < 0 { -part } else { part };
            wanted[i] = (to as i16).max(low[i]).min(high[i]);
        }
    }
}

/// The first row from `from` on whose bit is set.
fn next_awake(bits: &[u64], from: usize, rows: usize) -> Option<usize> {
    let mut word = from / 64;
    let mut rest = bits.get(word)? & (u64::MAX << (from % 64));
    while rest == 0 {
        word += 1;
        rest = *bits.get(word)?;
    }
    let row = word * 64 + rest.trailing_zeros() as usize;
    (row < rows).then_some(row)
}

#[cfg(test)]
mod tests {
    use super::super::chainmail::Chainmail;
    use super::super::state::{check, living_links};
    use super::super::tests::lattice;
    use super::*;
    use proptest::prelude::*;

    const HOW: Relaxation = Relaxation { share: 0.5, rest_weight: 0.05 };

    fn largest(state: &VitreousState) -> i32 {
        state.shift_um.iter().flatten().map(|&s| i32::from(s).abs()).max().unwrap()
    }

    #[test]
    fn a_single_element_goes_back_by_the_formula() {
        let lattice = lattice(12);
        let mut state = VitreousState::new(&lattice);
        let links = living_links(&lattice, &state);
        let mail = Mail { lattice: &lattice, links: &links };
        let e = lattice.element([5, 6, 6]).unwrap();
        state.shift_um[1][e] = 100;
        wake(&lattice, &mut state, usize::from(lattice.row_of[e]));
        let held = vec![0; lattice.len()];
        let mut relaxer = Relaxer::default();
        // 5 + 6 + 6 is odd: the first pass moves its even neighbours, the second moves it.
        let mut pass = |state: &mut VitreousState| {
            let parity = state.parity;
            while state.parity == parity {
                relaxer.relax(mail, state, HOW, &held, 1, &mut |_| ());
            }
        };
        pass(&mut state);
        // Neighbours wanted 100/6.05 = 16.5, so 16, and went half of that.
        assert_eq!((0..LINKS).map(|k| state.shift(lattice.neighbour(e, k))[1]).collect::<Vec<_>>(), [8; 6]);
        assert_eq!(state.shift(e), [0, 100, 0]);
        pass(&mut state);
        // It wanted 6·8/6.05 = 7.9, so 7, and went half of the 93, rounded up.
        assert_eq!(state.shift(e), [0, 53, 0]);
    }

    #[test]
    fn held_elements_stay() {
        let lattice = lattice(12);
        let mut state = VitreousState::new(&lattice);
        let links = living_links(&lattice, &state);
        let mail = Mail { lattice: &lattice, links: &links };
        let e = lattice.element([6, 6, 6]).unwrap();
        state.shift_um[0][e] = 90;
        wake(&lattice, &mut state, usize::from(lattice.row_of[e]));
        let mut held = vec![0; lattice.len()];
        held[e] = 1;
        Relaxer::default().relax(mail, &mut state, HOW, &held, 2000, &mut |_| ());
        assert_eq!(state.shift(e), [90, 0, 0]);
    }

    #[test]
    fn every_instruction_set_gives_the_same() {
        let lattice = lattice(24);
        let mut states = [VitreousState::new(&lattice), VitreousState::new(&lattice)];
        let links = living_links(&lattice, &states[0]);
        let mail = Mail { lattice: &lattice, links: &links };
        let mut chainmail = Chainmail::new(&lattice);
        let plain = Relaxer { simd: pulp::Arch::Scalar, ..Relaxer::default() };
        for (state, mut relaxer) in states.iter_mut().zip([Relaxer::default(), plain]) {
            for (axis, way) in [(0, 700), (1, -650), (2, 433)] {
                let e = lattice.element([12, 11, 9]).unwrap() as u32;
                let mut rows = Vec::new();
                let note = &mut |e: usize| rows.push(usize::from(lattice.row_of[e]));
                chainmail.push(mail, state, axis, &[(e, way), (e + 3, way)], note);
                rows.into_iter().for_each(|row| wake(&lattice, state, row));
                relaxer.relax(mail, state, HOW, &vec![0; lattice.len()], 300, &mut |_| ());
            }
        }
        assert!(states[0] == states[1] && largest(&states[0]) > 0);
    }

    proptest! {
        #[test]
        fn towards_zero_is_the_conversion(x in -16_777_215.9f32..16_777_215.9, near in -3.0f32..3.0) {
            for x in [x, near, x.trunc(), near.trunc(), 0.0, -0.0, f32::NAN] {
                prop_assert_eq!(towards_zero(x), x as i32);
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn it_never_breaks_a_limit_and_comes_to_rest(
            cells in 8u32..12,
            released in any::<bool>(),
            moves in proptest::collection::vec((0usize..3, 0usize..900, -700i16..=700), 1..20),
        ) {
            let lattice = lattice(cells);
            let mut state = VitreousState::new(&lattice);
            if released {
                state.status.iter_mut().for_each(|s| *s &= ALIVE);
            }
            let links = living_links(&lattice, &state);
            let mail = Mail { lattice: &lattice, links: &links };
            let mut chainmail = Chainmail::new(&lattice);
            for (axis, i, way) in moves {
                let e = (PAD + i % lattice.elements()) as u32;
                let mut moved = Vec::new();
                chainmail.push(mail, &mut state, axis, &[(e, way)], &mut |e| moved.push(e));
                moved.into_iter().for_each(|e| wake(&lattice, &mut state, usize::from(lattice.row_of[e])));
            }
            let held = vec![0; lattice.len()];
            let mut relaxer = Relaxer::default();
            let mut before = largest(&state);
            for round in 0..20_000 {
                relaxer.relax(mail, &mut state, HOW, &held, 40, &mut |_| ());
                let now = largest(&state);
                prop_assert!(now <= before, "the largest displacement never grows");
                before = now;
                if round % 50 == 0 {
                    prop_assert_eq!(check(&lattice, &state), Ok(()));
                }
                if state.awake.iter().flatten().all(|&a| a == 0) {
                    break;
                }
            }
            prop_assert_eq!(before, 0, "everything is back at rest");
            prop_assert!(state.awake.iter().flatten().all(|&a| a == 0), "and asleep");
        }
    }
}
