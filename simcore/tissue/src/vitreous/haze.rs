//! The vitreous as the renderer draws it: densities on the cells of the lattice at rest, in bricks
//! of 8³.
//!
//! Every living element gives its density to the eight cells around its place, in eighths along
//! each axis, as whole numbers: a sum of them does not depend on the order in which elements moved.
//! So only elements that moved by an eighth, or went, since the last picture are taken out and put
//! in again, and only their bricks are rewritten.

use super::lattice::{Lattice, PAD};
use super::state::{ALIVE, VitreousState};
use bytemuck::Zeroable;
use protocol::scene::SceneBrick;

/// Cells along a brick.
const BRICK: usize = 8;
/// Steps between two cells along an axis, as a power of two.
const FINE_BITS: u32 = 3;

/// The densities, and what they were made from.
#[derive(Debug, Clone)]
pub struct Haze {
    /// Sum of densities · 8³ of a cell, x fastest.
    sums: Vec<u32>,
    /// Bricks along an axis.
    along: usize,
    bricks: Vec<SceneBrick>,
    /// Brick in `bricks` by its place, x fastest; [`NO_BRICK`] where nothing can be.
    number: Vec<u32>,
    /// Bricks to rewrite.
    dirty: Vec<bool>,
    /// Where elements were when they were put in, eighths of a cell from rest along x, y and z.
    drawn_at: [Vec<i16>; 3],
    /// Eighths of a cell in a µm.
    fine_per_um: f32,
    /// [`ALIVE`] for elements that are put in.
    drawn: Vec<u8>,
    simd: pulp::Arch,
    row: RowNow,
}

/// A row as it is now, for its comparison with what was drawn.
#[derive(Debug, Clone)]
struct RowNow {
    at: [[i16; PAD]; 3],
    /// Not 0 for elements that moved or went.
    differs: [u8; PAD],
}

const NO_BRICK: u32 = u32::MAX;

impl Haze {
    /// Nothing drawn yet.
    pub fn new(lattice: &Lattice) -> Self {
        let along = lattice.cells.div_ceil(BRICK);
        let pitch_mm = lattice.pitch_um as f32 * 1e-3;
        let edge_mm = BRICK as f32 * pitch_mm;
        let corner = |c: usize| (c as f32 * BRICK as f32 - lattice.cells as f32 * 0.5) * pitch_mm;
        let radius = lattice.radius_um as f32 * 1e-3 + pitch_mm;
        let (mut bricks, mut number) = (Vec::new(), vec![NO_BRICK; along * along * along]);
        for (i, slot) in number.iter_mut().enumerate() {
            let corner_mm = [i % along, i / along % along, i / along / along].map(corner);
            // Distance of the brick from the eye's centre.
            let apart2: f32 = corner_mm.map(|c| c.max((c + edge_mm).min(0.0))).iter().map(|d| d * d).sum();
            if apart2 <= radius * radius {
                *slot = bricks.len() as u32;
                bricks.push(SceneBrick { corner_mm, edge_mm, ..SceneBrick::zeroed() });
            }
        }
        Haze {
            sums: vec![0; (along * BRICK).pow(3)],
            along,
            dirty: vec![false; bricks.len()],
            bricks,
            number,
            drawn_at: std::array::from_fn(|_| vec![0; lattice.len()]),
            fine_per_um: (1 << FINE_BITS) as f32 / lattice.pitch_um as f32,
            drawn: vec![0; lattice.len()],
            simd: pulp::Arch::new(),
            row: RowNow { at: [[0; PAD]; 3], differs: [0; PAD] },
        }
    }

    /// The bricks, in an order that never changes.
    pub fn bricks(&self) -> &[SceneBrick] {
        &self.bricks
    }

    /// Follows what moved or went in a row.
    pub fn follow(&mut self, lattice: &Lattice, state: &VitreousState, row: usize) {
        let row = &lattice.rows[row];
        let (start, len) = (row.start as usize, usize::from(row.len).min(PAD));
        let now = Compare {
            shift: state.shift_um.each_ref().map(|s| &s[start..][..len]),
            status: &state.status[start..][..len],
            drawn_at: self.drawn_at.each_ref().map(|d| &d[start..][..len]),
            drawn: &self.drawn[start..][..len],
            fine_per_um: self.fine_per_um,
            row: &mut self.row,
        };
        if !self.simd.dispatch(now) {
            return;
        }
        for i in 0..len {
            if self.row.differs[i] == 0 {
                continue;
            }
            let (e, alive) = (start + i, state.status[start + i] & ALIVE);
            if self.drawn[e] != 0 {
                let was = self.drawn_at.each_ref().map(|d| d[e]);
                self.put(lattice, e, was, false);
            }
            let now = self.row.at.each_ref().map(|at| at[i]);
            if alive != 0 {
                self.put(lattice, e, now, true);
            }
            self.drawn_at.iter_mut().zip(now).for_each(|(d, now)| d[e] = now);
            self.drawn[e] = alive;
        }
    }

    /// Adds an element's density to the cells around its place, or takes it away.
    fn put(&mut self, lattice: &Lattice, e: usize, at: [i16; 3], add: bool) {
        const WHOLE: u32 = 1 << FINE_BITS;
        let cell = lattice.cell(e);
        let last = (lattice.cells as i32 - 1) << FINE_BITS;
        // Along each axis: the lower cell, and the shares of it and the next one in eighths.
        let fine: [(usize, [u32; 2]); 3] = std::array::from_fn(|c| {
            let at = ((cell[c] << FINE_BITS) + i32::from(at[c])).clamp(0, last) as usize;
            let part = (at & (WHOLE as usize - 1)) as u32;
            (at >> FINE_BITS, [WHOLE - part, part])
        });
        let [(x, in_x), (y, in_y), (z, in_z)] = fine;
        let (side, density) = (self.along * BRICK, u32::from(lattice.density[e]));
        for (k, wz) in in_z.into_iter().enumerate().filter(|(_, w)| *w != 0) {
            for (j, wy) in in_y.into_iter().enumerate().filter(|(_, w)| *w != 0) {
                let row = side * (y + j + side * (z + k));
                let bricks = self.along * ((y + j) / BRICK + self.along * ((z + k) / BRICK));
                for (i, wx) in in_x.into_iter().enumerate().filter(|(_, w)| *w != 0) {
                    let weight = density * wx * wy * wz;
                    let sum = &mut self.sums[row + x + i];
                    *sum = if add { *sum + weight } else { *sum - weight };
                    let brick = self.number[bricks + (x + i) / BRICK];
                    if brick != NO_BRICK {
                        self.dirty[brick as usize] = true;
                    }
                }
            }
        }
    }

    /// Writes the bricks that changed; returns how many.
    pub fn write(&mut self) -> usize {
        let side = self.along * BRICK;
        let mut written = 0;
        for (i, &number) in self.number.iter().enumerate() {
            if number == NO_BRICK || !std::mem::take(&mut self.dirty[number as usize]) {
                continue;
            }
            written += 1;
            let first = [i % self.along, i / self.along % self.along, i / self.along / self.along];
            let [x, y, z] = first.map(|c| c * BRICK);
            let rows = self.bricks[number as usize].density.chunks_exact_mut(BRICK).enumerate();
            for (row, out) in rows {
                let start = x + side * (y + row % BRICK + side * (z + row / BRICK));
                for (out, &sum) in out.iter_mut().zip(&self.sums[start..start + BRICK]) {
                    *out = (sum >> (3 * FINE_BITS)).min(255) as u8;
                }
            }
        }
        written
    }
}

/// Compares a row with what was drawn of it: plain loops, so that the compiler takes many elements
/// at a time. `true` if anything differs.
struct Compare<'a> {
    shift: [&'a [i16]; 3],
    status: &'a [u8],
    drawn_at: [&'a [i16]; 3],
    drawn: &'a [u8],
    fine_per_um: f32,
    row: &'a mut RowNow,
}

impl pulp::NullaryFnOnce for Compare<'_> {
    type Output = bool;

    #[inline(always)]
    fn call(self) -> bool {
        let Compare { shift, status, drawn_at, drawn, fine_per_um, row } = self;
        let len = status.len().min(PAD);
        let differs = &mut row.differs[..len];
        let (status, drawn) = (&status[..len], &drawn[..len]);
        for i in 0..len {
            differs[i] = (status[i] & ALIVE) ^ drawn[i];
        }
        for axis in 0..3 {
            let (shift, was, now) = (&shift[axis][..len], &drawn_at[axis][..len], &mut row.at[axis][..len]);
            for i in 0..len {
                now[i] = fine(shift[i], fine_per_um);
                // What is neither there nor drawn may have moved.
                differs[i] |= u8::from(now[i] != was[i]) & status[i] & drawn[i];
            }
        }
        differs.iter().fold(0, |any, d| any | d) != 0
    }
}

/// A displacement in whole eighths of a cell, rounded down; the same for the same displacement, and
/// that is all it must be.
#[inline(always)]
fn fine(shift_um: i16, fine_per_um: f32) -> i16 {
    const LIFT: f32 = 8192.0;
    ((f32::from(shift_um) * fine_per_um + LIFT) as i32 - LIFT as i32) as i16
}

#[cfg(test)]
mod tests {
    use super::super::tests::lattice;
    use super::*;

    fn drawn(lattice: &Lattice, state: &VitreousState) -> Haze {
        drawn_by(pulp::Arch::new(), lattice, state)
    }

    fn drawn_by(simd: pulp::Arch, lattice: &Lattice, state: &VitreousState) -> Haze {
        let mut haze = Haze { simd, ..Haze::new(lattice) };
        (0..lattice.rows.len()).for_each(|row| haze.follow(lattice, state, row));
        haze.write();
        haze
    }

    fn at(haze: &Haze, lattice: &Lattice, cell: [i32; 3]) -> u8 {
        let place =
            cell.map(|c| ((2 * c + 1) as f32 - lattice.cells as f32) * 0.5 * lattice.pitch_um as f32 * 1e-3);
        let inside = |b: &&SceneBrick| {
            (0..3).all(|c| (b.corner_mm[c]..b.corner_mm[c] + b.edge_mm).contains(&place[c]))
        };
        let brick = haze.bricks.iter().find(inside).expect("a brick");
        let [x, y, z] = [0, 1, 2].map(|c| ((place[c] - brick.corner_mm[c]) / brick.edge_mm * 8.0) as usize);
        brick.density[x + 8 * (y + 8 * z)]
    }

    #[test]
    fn at_rest_every_cell_has_its_elements_density() {
        let lattice = lattice(20);
        let haze = drawn(&lattice, &VitreousState::new(&lattice));
        for e in lattice.numbers() {
            assert_eq!(at(&haze, &lattice, lattice.cell(e)), lattice.density[e]);
        }
        let sum: u64 = haze.bricks.iter().flat_map(|b| b.density).map(u64::from).sum();
        assert_eq!(sum, lattice.density.iter().map(|&d| u64::from(d)).sum::<u64>());
    }

    #[test]
    fn following_gives_what_drawing_anew_gives_and_removal_leaves_a_hole() {
        let lattice = lattice(20);
        let mut state = VitreousState::new(&lattice);
        let mut haze = drawn(&lattice, &state);
        let mut seed = 7u32;
        for round in 0..20 {
            for _ in 0..30 {
                seed = seed.wrapping_mul(1664525).wrapping_add(1013904223);
                let e = super::super::lattice::PAD + (seed >> 8) as usize % lattice.elements();
                if round % 2 == 0 {
                    state.shift_um[(seed % 3) as usize][e] = (seed >> 20) as i16 % 2000 - 1000;
                } else {
                    state.status[e] = 0;
                }
                haze.follow(&lattice, &state, usize::from(lattice.row_of[e]));
            }
            haze.write();
            assert!(haze.bricks == drawn(&lattice, &state).bricks, "round {round}");
            let plain = drawn_by(pulp::Arch::Scalar, &lattice, &state);
            assert!(haze.bricks == plain.bricks, "round {round}, without lanes");
        }
        lattice.numbers().for_each(|e| state.status[e] = 0);
        (0..lattice.rows.len()).for_each(|row| haze.follow(&lattice, &state, row));
        haze.write();
        assert!(haze.bricks.iter().all(|b| b.density.iter().all(|&d| d == 0)));
        assert_eq!(haze.write(), 0, "nothing changed since");
    }

    #[test]
    fn an_element_half_way_between_two_cells_is_seen_in_both() {
        let lattice = lattice(20);
        let mut state = VitreousState::new(&lattice);
        let cell = [9, 9, 14];
        let e = lattice.element(cell).unwrap();
        lattice.numbers().filter(|&o| o != e).for_each(|o| state.status[o] = 0);
        state.shift_um[0][e] = (lattice.pitch_um / 2) as i16;
        let haze = drawn(&lattice, &state);
        let half = lattice.density[e] / 2;
        assert_eq!([9, 10, 11].map(|x| at(&haze, &lattice, [x, 9, 14])), [half, half, 0]);
    }
}
