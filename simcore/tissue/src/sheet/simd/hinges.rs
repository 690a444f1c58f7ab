//! Forces of sixteen hinges at a time. The formulas are those of [`crate::sheet::curl`], in the
//! same order, so that the bits are the same.

use super::{Isa, Lanes, Portable, WIDE};
use crate::sheet::curl::{FOLDED, MAX_PSI, TINY_MM2};

/// One number of each hinge.
pub type Each = [f32; WIDE];

/// Sixteen hinges side by side: the ends of the edge, then the corners off it.
#[derive(Debug, Clone, Default)]
pub struct Hinges {
    /// Of each of the four nodes, along each axis, mm.
    pub position: [[Each; 3]; 4],
    /// w, µN·mm.
    pub stiffness: Each,
    /// ψ̄.
    pub rest: Each,
    /// On each node, along each axis, µN: what [`Self::bend`] found.
    pub force: [[Each; 3]; 4],
}

impl Hinges {
    /// Computes the forces with the instructions of `isa`, which must come from [`Isa::available`];
    /// no hinge becomes stiffer than `most_un_per_mm`.
    /// One bit for each hinge for which they hold; not for one whose triangles have no area, nor
    /// for one that is folded.
    pub fn bend(&mut self, isa: Isa, most_un_per_mm: f32) -> u16 {
        // SAFETY: the processor has what `isa` says.
        unsafe {
            match isa {
                #[cfg(target_arch = "x86_64")]
                Isa::Avx512 => bend_avx512(self, most_un_per_mm),
                #[cfg(target_arch = "x86_64")]
                Isa::Avx2 => bend_avx2(self, most_un_per_mm),
                _ => bend::<Portable>(self, most_un_per_mm),
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx2")]
fn bend_avx512(hinges: &mut Hinges, most_un_per_mm: f32) -> u16 {
    // SAFETY: as promised by the caller of this function.
    unsafe { bend::<super::Avx512>(hinges, most_un_per_mm) }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn bend_avx2(hinges: &mut Hinges, most_un_per_mm: f32) -> u16 {
    // SAFETY: as promised by the caller of this function.
    unsafe { bend::<super::Avx2>(hinges, most_un_per_mm) }
}

type Point<L> = [<L as Lanes>::V; 3];

/// Vectors of sixteen.
///
/// SAFETY: the processor has the instructions of `L`.
#[inline(always)]
unsafe fn sub<L: Lanes>(a: Point<L>, b: Point<L>) -> Point<L> {
    // SAFETY: handed on.
    unsafe { [L::sub(a[0], b[0]), L::sub(a[1], b[1]), L::sub(a[2], b[2])] }
}

#[inline(always)]
unsafe fn add<L: Lanes>(a: Point<L>, b: Point<L>) -> Point<L> {
    // SAFETY: handed on.
    unsafe { [L::add(a[0], b[0]), L::add(a[1], b[1]), L::add(a[2], b[2])] }
}

#[inline(always)]
unsafe fn scale<L: Lanes>(a: Point<L>, by: L::V) -> Point<L> {
    // SAFETY: handed on.
    unsafe { [L::mul(a[0], by), L::mul(a[1], by), L::mul(a[2], by)] }
}

#[inline(always)]
unsafe fn dot<L: Lanes>(a: Point<L>, b: Point<L>) -> L::V {
    // SAFETY: handed on.
    unsafe { L::add(L::add(L::mul(a[0], b[0]), L::mul(a[1], b[1])), L::mul(a[2], b[2])) }
}

#[inline(always)]
unsafe fn cross<L: Lanes>(a: Point<L>, b: Point<L>) -> Point<L> {
    // SAFETY: handed on.
    unsafe {
        [
            L::sub(L::mul(a[1], b[2]), L::mul(a[2], b[1])),
            L::sub(L::mul(a[2], b[0]), L::mul(a[0], b[2])),
            L::sub(L::mul(a[0], b[1]), L::mul(a[1], b[0])),
        ]
    }
}

#[inline(always)]
unsafe fn load<L: Lanes>([x, y, z]: &[Each; 3]) -> Point<L> {
    // SAFETY: handed on.
    unsafe { [L::load(x.as_ptr()), L::load(y.as_ptr()), L::load(z.as_ptr())] }
}

/// −(a·s + b·t).
#[inline(always)]
unsafe fn against<L: Lanes>(a: Point<L>, s: L::V, b: Point<L>, t: L::V) -> Point<L> {
    // SAFETY: handed on.
    unsafe { scale::<L>(add::<L>(scale::<L>(a, s), scale::<L>(b, t)), L::splat(-1.0)) }
}

/// SAFETY: the processor has the instructions of `L`.
#[inline(always)]
unsafe fn bend<L: Lanes>(hinges: &mut Hinges, most_un_per_mm: f32) -> u16 {
    // SAFETY: the caller has the instructions; every array has sixteen numbers.
    unsafe {
        let [p, q, a, b] = &hinges.position;
        let (p, q, a, b) = (load::<L>(p), load::<L>(q), load::<L>(a), load::<L>(b));
        let one = L::splat(1.0);
        let edge = sub::<L>(q, p);
        let (n1, n2) = (cross::<L>(edge, sub::<L>(a, p)), cross::<L>(sub::<L>(b, p), edge));
        let (l1, l2) = (dot::<L>(n1, n1), dot::<L>(n2, n2));
        let length = L::sqrt(dot::<L>(edge, edge));
        let scale_by = L::div(one, L::mul(L::sqrt(l1), L::sqrt(l2)));
        let cos = L::mul(dot::<L>(n1, n2), scale_by);
        let sin = L::div(L::mul(dot::<L>(cross::<L>(n2, n1), edge), scale_by), length);
        let opened = L::add(one, cos);
        let psi = L::div(L::mul(L::splat(2.0), sin), opened);
        let (up_a, up_b) = (scale::<L>(n1, L::div(length, l1)), scale::<L>(n2, L::div(length, l2)));
        let length2 = L::mul(length, length);
        let sa = L::div(dot::<L>(sub::<L>(a, p), edge), length2);
        let sb = L::div(dot::<L>(sub::<L>(b, p), edge), length2);
        let at_q = against::<L>(up_a, sa, up_b, sb);
        let at_p = against::<L>(up_a, L::sub(one, sa), up_b, L::sub(one, sb));
        let most = L::splat(MAX_PSI);
        let least = L::splat(-MAX_PSI);
        let psi = L::if_above(psi, most, most, psi);
        let psi = L::if_above(least, psi, least, psi);
        let slopes = L::add(dot::<L>(at_p, at_p), dot::<L>(at_q, at_q));
        let slopes = L::add(L::add(slopes, dot::<L>(up_a, up_a)), dot::<L>(up_b, up_b));
        let stiffness = L::load(hinges.stiffness.as_ptr());
        let bent = L::add(one, L::mul(L::mul(L::splat(0.25), psi), psi));
        let tangent = L::mul(stiffness, bent);
        let held = L::div(L::splat(most_un_per_mm), L::mul(tangent, slopes));
        let held = L::if_above(one, held, held, one);
        let beyond = L::sub(psi, L::load(hinges.rest.as_ptr()));
        let moment = L::mul(L::mul(L::mul(stiffness, L::splat(-1.0)), beyond), held);
        for (to, gradient) in hinges.force.iter_mut().zip([at_p, at_q, up_a, up_b]) {
            for axis in 0..3 {
                L::store(to[axis].as_mut_ptr(), L::mul(moment, gradient[axis]));
            }
        }
        let tiny = L::splat(TINY_MM2 * TINY_MM2);
        L::above(l1, tiny) & L::above(l2, tiny) & L::above(opened, L::splat(FOLDED))
    }
}
