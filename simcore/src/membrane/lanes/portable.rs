//! Plain code for every processor; the definition that the vector paths must meet to the bit.

use super::{Lanes, NODE, QUAD, WIDE, place, rsqrt};

/// Sixteen numbers in an array.
#[derive(Debug)]
pub struct Portable;

type V = [f32; WIDE];

#[inline(always)]
fn each(f: impl Fn(usize) -> f32) -> V {
    std::array::from_fn(f)
}

// SAFETY: needs no instructions beyond the base; pointers are used as the trait says.
unsafe impl Lanes for Portable {
    type V = V;

    #[inline(always)]
    unsafe fn splat(x: f32) -> V {
        [x; WIDE]
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> V {
        // SAFETY: the caller lends sixteen numbers.
        unsafe { from.cast::<V>().read_unaligned() }
    }

    #[inline(always)]
    unsafe fn store(to: *mut f32, v: V) {
        // SAFETY: the caller lends room for sixteen numbers.
        unsafe { to.cast::<V>().write_unaligned(v) }
    }

    #[inline(always)]
    unsafe fn add(a: V, b: V) -> V {
        each(|i| a[i] + b[i])
    }

    #[inline(always)]
    unsafe fn sub(a: V, b: V) -> V {
        each(|i| a[i] - b[i])
    }

    #[inline(always)]
    unsafe fn mul(a: V, b: V) -> V {
        each(|i| a[i] * b[i])
    }

    #[inline(always)]
    unsafe fn rsqrt(x: V) -> V {
        each(|i| rsqrt(x[i]))
    }

    #[inline(always)]
    unsafe fn above(a: V, b: V) -> u16 {
        (0..WIDE).fold(0, |mask, i| mask | u16::from(a[i] > b[i]) << i)
    }

    #[inline(always)]
    unsafe fn spread(to: *mut f32, [x, y, z, u, v, w]: [V; 6]) {
        for i in 0..WIDE {
            let node = [x[i], y[i], z[i], 0.0, u[i], v[i], w[i], 0.0];
            // SAFETY: `place` stays below sixteen, the room of the block.
            unsafe { to.add(place(i) * NODE).cast::<[f32; NODE]>().write_unaligned(node) };
        }
    }

    #[inline(always)]
    unsafe fn neighbours(nodes: *const f32, at: *const u32) -> [V; 6] {
        let mut parts = [[0.0; WIDE]; 6];
        for i in 0..WIDE {
            // SAFETY: the caller lends sixteen offsets and a node behind each.
            let node = unsafe { nodes.add(*at.add(i) as usize).cast::<[f32; NODE]>().read_unaligned() };
            (0..3).for_each(|k| (parts[k][i], parts[3 + k][i]) = (node[k], node[QUAD + k]));
        }
        parts
    }

    #[inline(always)]
    unsafe fn store_quads(to: *mut f32, [x, y, z]: [V; 3]) {
        for i in 0..WIDE {
            let quad = [x[i], y[i], z[i], 0.0];
            // SAFETY: `place` stays below sixteen, the room of the block.
            unsafe { to.add(place(i) * QUAD).cast::<[f32; QUAD]>().write_unaligned(quad) };
        }
    }

    #[inline(always)]
    unsafe fn sum_quads(quads: *const f32, at: *const u32, rows: usize) -> [V; 3] {
        let mut sums = [[0.0; WIDE]; 3];
        for row in 0..rows {
            for i in 0..WIDE {
                // SAFETY: the caller lends an offset for each row and node, and a force behind each.
                let quad = unsafe {
                    quads.add(*at.add(row * WIDE + i) as usize).cast::<[f32; QUAD]>().read_unaligned()
                };
                (0..3).for_each(|k| sums[k][i] += quad[k]);
            }
        }
        sums
    }
}
