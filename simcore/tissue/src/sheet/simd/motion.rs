//! The motion of a substep: every node moves by its acceleration, within the limits. The formulas
//! are those of [`crate::sheet::solver`].

use super::kernel::Span;
use super::{Isa, Lanes, Portable, WIDE};
use crate::sheet::material::Material;

/// What moves the nodes and what is moved; every slice has a number for each node.
#[derive(Debug)]
#[allow(missing_docs)]
pub struct Motion<'a> {
    pub acceleration: [&'a [f32]; 3],
    pub acceleration2: &'a [f32],
    pub mobile: &'a [f32],
    pub position: [&'a mut [f32]; 3],
    pub velocity: [&'a mut [f32]; 3],
}

/// The tissue's limits and weights of a substep.
#[derive(Debug, Clone, Copy)]
struct Rates {
    dt: f32,
    a_max: f32,
    v_max: f32,
    v_max2: f32,
    radius2: f32,
    /// Weights of the new and the old velocity in the way, s.
    new_dt: f32,
    old_dt: f32,
    /// Share of the velocity that stays: 0 in the quasi-static system.
    keep: f32,
}

impl Rates {
    fn new(material: &Material) -> Self {
        let (dt, v_max) = (material.dt_s, material.v_max);
        let quasi_static = v_max == 0.0;
        let old = material.explicit && !quasi_static;
        Rates {
            dt,
            a_max: material.a_max,
            v_max,
            v_max2: if quasi_static { f32::INFINITY } else { v_max * v_max },
            radius2: material.radius_mm * material.radius_mm,
            new_dt: if old { 0.0 } else { dt },
            old_dt: if old { dt } else { 0.0 },
            keep: if quasi_static { 0.0 } else { 1.0 },
        }
    }
}

impl Motion<'_> {
    /// Moves the nodes with the instructions of `isa`, which must come from [`Isa::available`].
    /// True if a mobile one is now beyond the retina.
    pub fn advance(&mut self, isa: Isa, material: &Material) -> bool {
        let n = self.mobile.len();
        assert!(self.acceleration.iter().all(|v| v.len() == n) && self.acceleration2.len() == n);
        assert!(self.position.iter().chain(&self.velocity).all(|v| v.len() == n));
        let rates = Rates::new(material);
        // SAFETY: every slice has a number a node; the processor has what `isa` says.
        unsafe {
            match isa {
                #[cfg(target_arch = "x86_64")]
                Isa::Avx512 => advance_avx512(self, &rates),
                #[cfg(target_arch = "x86_64")]
                Isa::Avx2 => advance_avx2(self, &rates),
                _ => advance::<Portable>(self, &rates),
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx2")]
fn advance_avx512(motion: &mut Motion, rates: &Rates) -> bool {
    // SAFETY: as promised by the caller of this function.
    unsafe { advance::<super::Avx512>(motion, rates) }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn advance_avx2(motion: &mut Motion, rates: &Rates) -> bool {
    // SAFETY: as promised by the caller of this function.
    unsafe { advance::<super::Avx2>(motion, rates) }
}

/// SAFETY: the processor has the instructions of `L`, the slices have a number a node.
#[inline(always)]
unsafe fn advance<L: Lanes>(motion: &mut Motion, rates: &Rates) -> bool {
    let nodes = motion.mobile.len();
    let bases = Bases {
        acceleration: motion.acceleration.map(<[f32]>::as_ptr),
        acceleration2: motion.acceleration2.as_ptr(),
        mobile: motion.mobile.as_ptr(),
        position: motion.position.each_mut().map(|list| list.as_mut_ptr()),
        velocity: motion.velocity.each_mut().map(|list| list.as_mut_ptr()),
    };
    let mut outside = 0;
    for block in 0..nodes.div_ceil(WIDE) {
        // SAFETY: handed on.
        outside |= unsafe { advance_block::<L>(&bases, rates, Span::new(block, nodes)) };
    }
    outside != 0
}

/// Where everything lies: copied so that no write to an array can seem to change it.
#[derive(Clone, Copy)]
struct Bases {
    acceleration: [*const f32; 3],
    acceleration2: *const f32,
    mobile: *const f32,
    position: [*mut f32; 3],
    velocity: [*mut f32; 3],
}

/// The factor that brings a vector of square `square` down to `limit`, whose square is `limit2`; 1
/// where it is shorter. Hardly ever is one longer, and the root is spared.
#[inline(always)]
unsafe fn shortened<L: Lanes>(square: L::V, limit: f32, limit2: f32) -> L::V {
    // SAFETY: the caller has the instructions.
    unsafe {
        let (one, most) = (L::splat(1.0), L::splat(limit2));
        if L::above(square, most) == 0 {
            return one;
        }
        L::if_above(square, most, L::mul(L::splat(limit), L::rsqrt(square)), one)
    }
}

#[inline(always)]
unsafe fn squared<L: Lanes>([x, y, z]: [L::V; 3]) -> L::V {
    // SAFETY: the caller has the instructions.
    unsafe { L::add(L::add(L::mul(x, x), L::mul(y, y)), L::mul(z, z)) }
}

/// Moves a block of nodes; returns those that are mobile and now beyond the retina.
#[inline(always)]
unsafe fn advance_block<L: Lanes>(bases: &Bases, rates: &Rates, span: Span) -> u16 {
    // SAFETY: handed on.
    unsafe {
        let mobile = span.part::<L>(bases.mobile);
        let a2 = span.part::<L>(bases.acceleration2);
        let limit = shortened::<L>(a2, rates.a_max, rates.a_max * rates.a_max);
        let limit = L::mul(limit, L::splat(rates.dt));
        let (mut place, mut old, mut new) = ([mobile; 3], [mobile; 3], [mobile; 3]);
        for axis in 0..3 {
            (place[axis], old[axis]) =
                (span.part::<L>(bases.position[axis]), span.part::<L>(bases.velocity[axis]));
            new[axis] = L::add(old[axis], L::mul(span.part::<L>(bases.acceleration[axis]), limit));
        }
        let slow = shortened::<L>(squared::<L>(new), rates.v_max, rates.v_max2);
        let way = L::mul(L::mul(slow, L::splat(rates.new_dt)), mobile);
        let kept = L::mul(slow, L::splat(rates.keep));
        for axis in 0..3 {
            let mut step = L::mul(new[axis], way);
            if rates.old_dt > 0.0 {
                step = L::add(step, L::mul(old[axis], L::mul(L::splat(rates.old_dt), mobile)));
            }
            place[axis] = L::add(place[axis], step);
            span.put::<L>(bases.position[axis], place[axis]);
            span.put::<L>(bases.velocity[axis], L::mul(new[axis], kept));
        }
        L::above(squared::<L>(place), L::splat(rates.radius2)) & L::above(mobile, L::splat(0.0))
    }
}
