//! Which elements are near an instrument. Every row keeps the box around its elements; a row whose
//! box the searched capsule misses is skipped, so that a search looks at a few thousand elements
//! and not at all of them.

use super::lattice::{Lattice, TOGETHER, block};
use super::state::{ALIVE, VitreousState};
use super::{drain, set};
use nalgebra::Vector3;

/// A piece of a straight line with a thickness, eye frame, µm; of length 0 it is a ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Capsule {
    /// One end.
    pub from_um: Vector3<f64>,
    /// Direction to the other end, of length 1.
    pub along: Vector3<f64>,
    /// Distance of the ends.
    pub length_um: f64,
    /// Thickness.
    pub radius_um: f64,
}

impl Capsule {
    /// How far along the line the point of it nearest to `place` lies, µm, and the distance to it,
    /// squared.
    pub fn nearest(&self, place: Vector3<f64>) -> (f64, f64) {
        let t = (place - self.from_um).dot(&self.along).clamp(0.0, self.length_um);
        (t, (place - self.from_um - self.along * t).norm_squared())
    }

    /// The part of the line, by its distances from the first end, that may be within reach of a
    /// box. `inverse` has 1 over `along`.
    fn clip(&self, inverse: &Vector3<f64>, low: &[i16; 3], high: &[i16; 3]) -> Option<(f64, f64)> {
        let (mut t0, mut t1) = (0.0, self.length_um);
        for c in 0..3 {
            let bottom = f64::from(low[c]) - self.radius_um - self.from_um[c];
            let top = f64::from(high[c]) + self.radius_um - self.from_um[c];
            if self.along[c].abs() < 1e-9 {
                if bottom > 0.0 || top < 0.0 {
                    return None;
                }
                continue;
            }
            let (a, b) = (bottom * inverse[c], top * inverse[c]);
            let (near, far) = if a < b { (a, b) } else { (b, a) };
            t0 = if near > t0 { near } else { t0 };
            t1 = if far < t1 { far } else { t1 };
        }
        // Far above the rounding: what is found is looked at again, element by element.
        (t0 <= t1 + 1e-3).then_some((t0, t1))
    }
}

/// The boxes of the rows.
#[derive(Debug, Clone)]
pub struct Finder {
    /// Lowest and highest coordinates of a row's living elements, µm; the highest below the lowest
    /// if it has none.
    boxes: Vec<[[i16; 3]; 2]>,
    /// Rows whose box is out of date, a bit each.
    stale: Vec<u64>,
    simd: pulp::Arch,
}

impl Finder {
    /// All boxes out of date.
    pub fn new(lattice: &Lattice) -> Self {
        let rows = lattice.rows.len();
        Finder {
            boxes: vec![[[0; 3]; 2]; rows],
            stale: vec![u64::MAX; rows.div_ceil(64)],
            simd: pulp::Arch::new(),
        }
    }

    /// To be called for every row in which something moved or went.
    pub fn forget(&mut self, row: usize) {
        set(&mut self.stale, row);
    }

    /// To be called when everything changed.
    pub fn forget_all(&mut self) {
        self.stale.fill(u64::MAX);
    }

    fn renew(&mut self, lattice: &Lattice, state: &VitreousState) {
        let Finder { boxes, stale, simd } = self;
        drain(stale, |row| {
            if row < boxes.len() {
                boxes[row] = simd.dispatch(Bounds { lattice, state, row });
            }
        });
    }

    /// Calls `found` for every living element in the capsule with its place, how far along the line
    /// it lies and its distance from it, squared, µm; in the order of the elements.
    pub fn find(
        &mut self,
        lattice: &Lattice,
        state: &VitreousState,
        capsule: &Capsule,
        mut found: impl FnMut(usize, Vector3<f64>, f64, f64),
    ) {
        self.renew(lattice, state);
        let radius2 = capsule.radius_um * capsule.radius_um;
        let inverse = capsule.along.map(|c| 1.0 / c);
        for (row, [low, high]) in lattice.rows.iter().zip(&self.boxes) {
            if low[0] > high[0] {
                continue;
            }
            let Some((t0, t1)) = capsule.clip(&inverse, low, high) else { continue };
            let (x0, x1) = (capsule.along.x * t0, capsule.along.x * t1);
            let (x0, x1) = if x0 < x1 { (x0, x1) } else { (x1, x0) };
            let left = (capsule.from_um.x + x0 - capsule.radius_um) as i32 - 1;
            let right = (capsule.from_um.x + x1 + capsule.radius_um) as i32 + 1;
            let start = row.start as usize;
            let mut rest = lattice.rest_um(start);
            for e in start..start + usize::from(row.len) {
                let x = rest[0] + i32::from(state.shift_um[0][e]);
                if (left..=right).contains(&x) && state.is_alive(e) {
                    let shift = state.shift(e);
                    let place = Vector3::new(x, rest[1] + shift[1], rest[2] + shift[2]).map(f64::from);
                    let (t, d2) = capsule.nearest(place);
                    if d2 <= radius2 {
                        found(e, place, t, d2);
                    }
                }
                rest[0] += lattice.pitch_um;
            }
        }
    }
}

/// The box around the living elements of a row.
struct Bounds<'a> {
    lattice: &'a Lattice,
    state: &'a VitreousState,
    row: usize,
}

impl pulp::NullaryFnOnce for Bounds<'_> {
    type Output = [[i16; 3]; 2];

    #[inline(always)]
    fn call(self) -> [[i16; 3]; 2] {
        let Bounds { lattice, state, row } = self;
        let row = &lattice.rows[row];
        let (start, len) = (row.start as usize, usize::from(row.len));
        let rest = lattice.rest_um(start);
        let (mut low, mut high) = ([i16::MAX; 3], [i16::MIN; 3]);
        for from in (0..len).step_by(TOGETHER) {
            let status = block(&state.status, start + from);
            let mut there = [0; TOGETHER];
            for i in 0..TOGETHER {
                there[i] = -i16::from(status[i] & ALIVE) & -i16::from(from + i < len);
            }
            for c in 0..3 {
                let shift = block(&state.shift_um[c], start + from);
                // Along the row the places at rest go up by the spacing.
                let step = if c == 0 { lattice.pitch_um } else { 0 };
                let first = (rest[c] + from as i32 * step) as i16;
                for i in 0..TOGETHER {
                    let place =
                        first.wrapping_add((step as i16).wrapping_mul(i as i16)).saturating_add(shift[i]);
                    low[c] = low[c].min(place & there[i] | i16::MAX & !there[i]);
                    high[c] = high[c].max(place & there[i] | i16::MIN & !there[i]);
                }
            }
        }
        [low, high]
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::lattice;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn it_finds_what_looking_at_every_element_finds(
            from in proptest::array::uniform3(-9000.0f64..9000.0),
            towards in proptest::array::uniform3(-1.0f64..1.0),
            length in prop_oneof![Just(0.0), 0.0f64..20_000.0],
            radius in 100.0f64..3000.0,
            shifts in proptest::collection::vec((0usize..2000, 0usize..3, -900i16..900), 0..30),
            dead in proptest::collection::vec(0usize..2000, 0..30),
            flat in proptest::option::of(0usize..3),
        ) {
            let lattice = lattice(14);
            let mut state = VitreousState::new(&lattice);
            let number = |i: usize| super::super::lattice::PAD + i % lattice.elements();
            let mut finder = Finder::new(&lattice);
            let mut towards = Vector3::from(towards);
            flat.into_iter().for_each(|c| towards[c] = 0.0);
            prop_assume!(towards.norm() > 0.1);
            let along = towards.normalize();
            let capsule = Capsule { from_um: from.into(), along, length_um: length, radius_um: radius };
            finder.find(&lattice, &state, &capsule, |_, _, _, _| ());
            for (i, c, way) in shifts {
                state.shift_um[c][number(i)] = way;
                finder.forget(usize::from(lattice.row_of[number(i)]));
            }
            for i in dead {
                state.status[number(i)] = 0;
                finder.forget(usize::from(lattice.row_of[number(i)]));
            }
            let mut found = Vec::new();
            finder.find(&lattice, &state, &capsule, |e, _, _, _| found.push(e));
            let mut plain = Finder { simd: pulp::Arch::Scalar, ..Finder::new(&lattice) };
            plain.find(&lattice, &state, &capsule, |_, _, _, _| ());
            prop_assert!(plain.boxes == finder.boxes, "without lanes");
            let near = |e: &usize| {
                let place = Vector3::from(state.place_um(&lattice, *e)).map(f64::from);
                // By sampling the line, not by its formula; cases within a sample of the border are
                // left out.
                let distance = (0..=4000).map(|s| along * (length * f64::from(s) / 4000.0))
                    .map(|way| (place - capsule.from_um - way).norm())
                    .fold(f64::MAX, f64::min);
                ((distance - radius).abs() > 5.0).then_some(distance < radius)
            };
            for e in lattice.numbers().filter(|&e| state.is_alive(e)) {
                if let Some(near) = near(&e) {
                    prop_assert_eq!(found.contains(&e), near, "element {}", e);
                }
            }
            prop_assert!(found.iter().all(|&e| state.is_alive(e)));
        }
    }
}
