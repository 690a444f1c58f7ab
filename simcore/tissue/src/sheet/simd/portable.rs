//! Plain code for every processor; the definition that the vector paths must meet to the bit.

use super::{ABSENT, Lanes, NODE, WIDE, lane_index, rsqrt};

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
    unsafe fn load_first(from: *const f32, count: usize) -> V {
        // SAFETY: the caller lends `count` numbers.
        each(|i| if i < count { unsafe { from.add(i).read() } } else { 0.0 })
    }

    #[inline(always)]
    unsafe fn store_first(to: *mut f32, count: usize, v: V) {
        for (i, x) in v.into_iter().enumerate().take(count) {
            // SAFETY: the caller lends room for `count` numbers.
            unsafe { to.add(i).write(x) };
        }
    }

    #[inline(always)]
    unsafe fn div(a: V, b: V) -> V {
        each(|i| a[i] / b[i])
    }

    #[inline(always)]
    unsafe fn sqrt(x: V) -> V {
        each(|i| x[i].sqrt())
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
    unsafe fn if_above(a: V, b: V, x: V, y: V) -> V {
        each(|i| if a[i] > b[i] { x[i] } else { y[i] })
    }

    #[inline(always)]
    unsafe fn spread(to: *mut f32, [x, y, z, u, v, w]: [V; 6]) {
        for i in 0..WIDE {
            let node = [x[i], y[i], z[i], 0.0, u[i], v[i], w[i], 0.0];
            // SAFETY: `place` stays below sixteen, the room of the block.
            unsafe { to.add(lane_index(i) * NODE).cast::<[f32; NODE]>().write_unaligned(node) };
        }
    }

    #[inline(always)]
    unsafe fn neighbours(nodes: *const f32, at: *const u32) -> [V; 6] {
        let mut parts = [[0.0; WIDE]; 6];
        for i in 0..WIDE {
            // SAFETY: the caller lends sixteen offsets and a node behind each.
            let node = unsafe { nodes.add(*at.add(i) as usize).cast::<[f32; NODE]>().read_unaligned() };
            (0..3).for_each(|k| (parts[k][i], parts[3 + k][i]) = (node[k], node[4 + k]));
        }
        parts
    }

    type Index = [u8; WIDE];

    #[inline(always)]
    unsafe fn index(from: *const u8) -> [u8; WIDE] {
        // SAFETY: the caller lends sixteen.
        unsafe { from.cast::<[u8; WIDE]>().read_unaligned() }
    }

    #[inline(always)]
    unsafe fn gather(first: *const f32, second: *const f32, index: [u8; WIDE]) -> V {
        // SAFETY: the caller lends sixteen numbers at both.
        let blocks = unsafe { [Self::load(first), Self::load(second)] };
        each(|i| {
            let (at, block) = (usize::from(index[i]), usize::from(index[i] >> 4 & 1));
            if index[i] & ABSENT != 0 { 0.0 } else { blocks[block][at & 15] }
        })
    }
}
