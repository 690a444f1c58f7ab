//! The three passes of a substep's forces, written once for every instruction set.
//!
//! 1. Nodes are copied from arrays of x, y, z … into eight consecutive numbers each, so that a spring reads its far end
//!    with one load.
//! 2. Blocks of sixteen nodes. In slot j each node has its j-th own spring: the near ends are consecutive, the far ends
//!    gathered; the near ends' forces stay in registers, the springs' forces are written as quads.
//! 3. Blocks again: each node subtracts the quads of the springs whose far end it is, and divides by its mass.

use super::{Isa, Lanes, NODE, Portable, QUAD, WIDE};

/// Springs in the order of the kernel; see [`crate::membrane::web`] for how it comes about.
#[derive(Debug, Default)]
pub struct Tables {
    /// Nodes.
    pub nodes: usize,
    /// Own springs of a node, at most.
    pub slots: usize,
    /// For each block, slot and lane: where the far end begins in `node`, in numbers.
    pub far: Vec<u32>,
    /// Rest length, mm.
    pub rest: Vec<f32>,
    /// Stiffness, µN/mm.
    pub stiffness: Vec<f32>,
    /// Damping, µN·s/mm.
    pub damping: Vec<f32>,
    /// Tension at which it tears, µN.
    pub limit: Vec<f32>,
    /// Elastic pull, µN: a result.
    pub pull: Vec<f32>,
    /// First row of each block in `incoming`; one more entry than blocks.
    pub row_start: Vec<u32>,
    /// For each row and lane: where a quad of a spring that ends in the node begins in `quads`, in numbers.
    pub incoming: Vec<u32>,
    /// Work space: nodes.
    pub node: Vec<f32>,
    /// Work space: forces of own springs.
    pub own: [Vec<f32>; 3],
    /// Work space: forces of springs; the last quad is 0.
    pub quads: Vec<f32>,
}

/// What goes into the forces of a substep and what comes out; every slice has a number for each node.
#[derive(Debug)]
#[allow(missing_docs)]
pub struct Forces<'a> {
    pub position: [&'a [f32]; 3],
    pub velocity: [&'a [f32]; 3],
    pub outer: [&'a [f32]; 3],
    pub mobile: &'a [f32],
    pub force: [&'a mut [f32]; 3],
    pub acceleration: [&'a mut [f32]; 3],
    pub acceleration2: &'a mut [f32],
    pub inverse_mass: f32,
    pub fluid_per_s: f32,
    /// Square of the acceleration at which nodes tear.
    pub tear2: f32,
    /// Added to squared lengths, mm².
    pub tiny2: f32,
}

/// What was found: lanes in which something passes its limit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Passed {
    /// A squared acceleration is not finite.
    pub not_finite: bool,
    /// A squared acceleration passes that of tearing.
    pub acceleration: bool,
    /// A spring's pull passes its limit.
    pub tension: bool,
}

impl Tables {
    fn blocks(&self) -> usize {
        self.nodes.div_ceil(WIDE)
    }

    /// Panics if the tables would lead a pass outside its arrays: whoever fills them calls this once.
    pub fn check(&self) {
        let (blocks, n) = (self.blocks(), self.blocks() * self.slots * WIDE);
        let lists = [&self.rest, &self.stiffness, &self.damping, &self.limit, &self.pull];
        assert!(lists.iter().all(|l| l.len() == n) && self.far.len() == n);
        assert!(self.far.iter().all(|&at| at as usize + NODE <= self.node.len()));
        assert_eq!(self.node.len(), blocks * WIDE * NODE);
        assert!(self.own.iter().all(|o| o.len() == blocks * WIDE));
        assert_eq!(self.quads.len(), (n + 1) * QUAD);
        assert!(self.incoming.iter().all(|&at| at as usize + QUAD <= self.quads.len()));
        assert_eq!(self.row_start.len(), blocks + 1);
        assert!(self.row_start.is_sorted());
        assert_eq!(self.row_start[blocks] as usize * WIDE, self.incoming.len());
    }

    /// Forces and accelerations with the instructions of `isa`, which must come from [`Isa::available`].
    pub fn accelerate(&mut self, isa: Isa, forces: &mut Forces) -> Passed {
        let n = self.nodes;
        let read = forces.position.iter().chain(&forces.velocity).chain(&forces.outer);
        assert!(read.chain([&forces.mobile]).all(|v| v.len() == n));
        assert!(forces.force.iter().chain(&forces.acceleration).all(|v| v.len() == n));
        assert_eq!(forces.acceleration2.len(), n);
        // SAFETY: `check` and the assertions above hold every index; the processor has what `isa` says.
        unsafe {
            match isa {
                #[cfg(target_arch = "x86_64")]
                Isa::Avx512 => accelerate_avx512(self, forces),
                #[cfg(target_arch = "x86_64")]
                Isa::Avx2 => accelerate_avx2(self, forces),
                _ => accelerate::<Portable>(self, forces),
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx2")]
fn accelerate_avx512(tables: &mut Tables, forces: &mut Forces) -> Passed {
    // SAFETY: as promised by the caller of this function.
    unsafe { accelerate::<super::Avx512>(tables, forces) }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn accelerate_avx2(tables: &mut Tables, forces: &mut Forces) -> Passed {
    // SAFETY: as promised by the caller of this function.
    unsafe { accelerate::<super::Avx2>(tables, forces) }
}

/// SAFETY: the processor has the instructions of `L`, the tables passed their check, the slices have a number a node.
#[inline(always)]
unsafe fn accelerate<L: Lanes>(tables: &mut Tables, forces: &mut Forces) -> Passed {
    // SAFETY: handed on.
    unsafe {
        spread::<L>(tables, forces);
        let tension = pull::<L>(tables, forces);
        let (infinite, over) = collect::<L>(tables, forces);
        Passed { not_finite: infinite != 0, acceleration: over != 0, tension: tension != 0 }
    }
}

/// Sixteen numbers from `at` on; behind the end 0.
#[inline(always)]
unsafe fn part<L: Lanes>(list: &[f32], at: usize) -> L::V {
    // SAFETY: whole blocks lie inside the list; the others are copied.
    unsafe {
        if at + WIDE <= list.len() {
            return L::load(list.as_ptr().add(at));
        }
        let mut last = [0.0; WIDE];
        last[..list.len() - at].copy_from_slice(&list[at..]);
        L::load(last.as_ptr())
    }
}

/// Writes sixteen numbers from `at` on; those behind the end are dropped.
#[inline(always)]
unsafe fn put<L: Lanes>(list: &mut [f32], at: usize, v: L::V) {
    // SAFETY: whole blocks lie inside the list; the others are copied.
    unsafe {
        if at + WIDE <= list.len() {
            return L::store(list.as_mut_ptr().add(at), v);
        }
        let mut last = [0.0; WIDE];
        L::store(last.as_mut_ptr(), v);
        let rest = list.len() - at;
        list[at..].copy_from_slice(&last[..rest]);
    }
}

#[inline(always)]
unsafe fn node_parts<L: Lanes>(forces: &Forces, at: usize) -> [L::V; 6] {
    let ([x, y, z], [u, v, w]) = (forces.position, forces.velocity);
    // SAFETY: `at` is below the number of nodes.
    unsafe {
        [
            part::<L>(x, at),
            part::<L>(y, at),
            part::<L>(z, at),
            part::<L>(u, at),
            part::<L>(v, at),
            part::<L>(w, at),
        ]
    }
}

#[inline(always)]
unsafe fn spread<L: Lanes>(tables: &mut Tables, forces: &Forces) {
    for block in 0..tables.blocks() {
        // SAFETY: `node` has room for every block.
        unsafe {
            let parts = node_parts::<L>(forces, block * WIDE);
            L::spread(tables.node.as_mut_ptr().add(block * WIDE * NODE), parts);
        }
    }
}

/// f = k (l − l₀) + c u·Δv along u = d/l, with 1/l from [`super::rsqrt`] and l = l²·(1/l).
#[inline(always)]
unsafe fn pull<L: Lanes>(tables: &mut Tables, forces: &Forces) -> u16 {
    let mut over = 0;
    let Tables { slots, far, rest, stiffness, damping, limit, pull, node, own, quads, nodes, .. } = tables;
    let slots = *slots;
    for block in 0..nodes.div_ceil(WIDE) {
        // SAFETY: `check` holds the lengths of the tables and every far end.
        unsafe {
            let [x, y, z, u, v, w] = node_parts::<L>(forces, block * WIDE);
            let mut sum = [L::splat(0.0); 3];
            for slot in 0..slots {
                let s = (block * slots + slot) * WIDE;
                let [bx, by, bz, bu, bv, bw] = L::neighbours(node.as_ptr(), far.as_ptr().add(s));
                let (dx, dy, dz) = (L::sub(bx, x), L::sub(by, y), L::sub(bz, z));
                let (du, dv, dw) = (L::sub(bu, u), L::sub(bv, v), L::sub(bw, w));
                let length2 = L::add(L::add(L::mul(dx, dx), L::mul(dy, dy)), L::mul(dz, dz));
                let length2 = L::add(length2, L::splat(forces.tiny2));
                let inverse = L::rsqrt(length2);
                let length = L::mul(length2, inverse);
                let rate = L::add(L::add(L::mul(du, dx), L::mul(dv, dy)), L::mul(dw, dz));
                let rate = L::mul(rate, inverse);
                let at = |list: &[f32]| L::load(list.as_ptr().add(s));
                let elastic = L::mul(at(stiffness), L::sub(length, at(rest)));
                over |= L::above(elastic, at(limit));
                L::store(pull.as_mut_ptr().add(s), elastic);
                let f = L::mul(L::add(elastic, L::mul(at(damping), rate)), inverse);
                let force = [L::mul(f, dx), L::mul(f, dy), L::mul(f, dz)];
                L::store_quads(quads.as_mut_ptr().add(s * QUAD), force);
                (0..3).for_each(|k| sum[k] = L::add(sum[k], force[k]));
            }
            for (own, sum) in own.iter_mut().zip(sum) {
                L::store(own.as_mut_ptr().add(block * WIDE), sum);
            }
        }
    }
    over
}

/// a = (F/m − g v)·mobile, with F = own − incoming + outer.
#[inline(always)]
unsafe fn collect<L: Lanes>(tables: &Tables, forces: &mut Forces) -> (u16, u16) {
    let (mut finite, mut over) = (u16::MAX, 0);
    // SAFETY: `check` holds the lengths of the tables and every incoming quad.
    unsafe {
        let (inverse_mass, fluid) = (L::splat(forces.inverse_mass), L::splat(forces.fluid_per_s));
        let (infinity, tear2) = (L::splat(f32::INFINITY), L::splat(forces.tear2));
        for block in 0..tables.blocks() {
            let n = block * WIDE;
            let [from, to] = [tables.row_start[block] as usize, tables.row_start[block + 1] as usize];
            let rows = tables.incoming.as_ptr().add(from * WIDE);
            let incoming = L::sum_quads(tables.quads.as_ptr(), rows, to - from);
            let mobile = part::<L>(forces.mobile, n);
            let mut square = L::splat(0.0);
            for axis in 0..3 {
                let own = L::load(tables.own[axis].as_ptr().add(n));
                let force = L::add(L::sub(own, incoming[axis]), part::<L>(forces.outer[axis], n));
                put::<L>(forces.force[axis], n, force);
                let drag = L::mul(fluid, part::<L>(forces.velocity[axis], n));
                let a = L::mul(L::sub(L::mul(force, inverse_mass), drag), mobile);
                put::<L>(forces.acceleration[axis], n, a);
                square = L::add(square, L::mul(a, a));
            }
            put::<L>(forces.acceleration2, n, square);
            finite &= L::above(infinity, square);
            over |= L::above(square, tear2);
        }
    }
    (!finite, over)
}
