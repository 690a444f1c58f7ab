//! AVX2: sixteen lanes in two registers, the first eight in the first.

use super::{Lanes, NODE, ROOT};
use std::arch::x86_64::*;

/// Sixteen numbers in two registers of 256 bits.
#[derive(Debug)]
pub struct Avx2;

type V = [__m256; 2];

/// Rows (0, 1, 2 of each quad) of four registers of quads: 128-bit part `l` of register `r` holds
/// quad `4 l + r`.
#[inline]
#[target_feature(enable = "avx2")]
fn columns([a, b, c, d]: [__m256; 4]) -> [__m256; 3] {
    let (low_ab, low_cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
    let (high_ab, high_cd) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
    let x = _mm256_shuffle_ps::<0x44>(low_ab, low_cd);
    let y = _mm256_shuffle_ps::<0xee>(low_ab, low_cd);
    [x, y, _mm256_shuffle_ps::<0x44>(high_ab, high_cd)]
}

/// The reverse of [`columns`], with 0 as the fourth number of each quad.
#[inline]
#[target_feature(enable = "avx2")]
fn quads(x: __m256, y: __m256, z: __m256) -> [__m256; 4] {
    let zero = _mm256_setzero_ps();
    let (low, high) = (_mm256_unpacklo_ps(x, y), _mm256_unpackhi_ps(x, y));
    let (low_z, high_z) = (_mm256_unpacklo_ps(z, zero), _mm256_unpackhi_ps(z, zero));
    [
        _mm256_shuffle_ps::<0x44>(low, low_z),
        _mm256_shuffle_ps::<0xee>(low, low_z),
        _mm256_shuffle_ps::<0x44>(high, high_z),
        _mm256_shuffle_ps::<0xee>(high, high_z),
    ]
}

/// The sign bit of the lanes below `count`, in both registers.
#[inline]
#[target_feature(enable = "avx2")]
fn first(count: usize) -> [__m256i; 2] {
    let lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    [0, 8].map(|from| _mm256_cmpgt_epi32(_mm256_set1_epi32(count as i32 - from), lanes))
}

/// [`Lanes::rsqrt`] of one register.
#[inline]
#[target_feature(enable = "avx2")]
fn rsqrt_half(x: __m256) -> __m256 {
    let bits = _mm256_srli_epi32::<1>(_mm256_castps_si256(x));
    let guess = _mm256_castps_si256(_mm256_set1_ps(ROOT[0]));
    let y = _mm256_castsi256_ps(_mm256_sub_epi32(guess, bits));
    let share = _mm256_mul_ps(_mm256_mul_ps(_mm256_mul_ps(x, _mm256_set1_ps(ROOT[1])), y), y);
    let y = _mm256_mul_ps(y, _mm256_sub_ps(_mm256_set1_ps(ROOT[2]), share));
    let share = _mm256_mul_ps(_mm256_mul_ps(_mm256_mul_ps(x, _mm256_set1_ps(ROOT[3])), y), y);
    _mm256_mul_ps(y, _mm256_sub_ps(_mm256_set1_ps(ROOT[4]), share))
}

/// [`Lanes::neighbours`] of the nodes of one register: x, y, z, u, v, w.
///
/// # Safety
/// Eight nodes of eight numbers can be read, each at its pointer.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn neighbours_half(node: [*const f32; 8]) -> [__m256; 6] {
    // SAFETY: the caller lends the nodes.
    let n = unsafe {
        [
            _mm256_loadu_ps(node[0]),
            _mm256_loadu_ps(node[1]),
            _mm256_loadu_ps(node[2]),
            _mm256_loadu_ps(node[3]),
            _mm256_loadu_ps(node[4]),
            _mm256_loadu_ps(node[5]),
            _mm256_loadu_ps(node[6]),
            _mm256_loadu_ps(node[7]),
        ]
    };
    let a = columns([n[0], n[1], n[2], n[3]]);
    let b = columns([n[4], n[5], n[6], n[7]]);
    [
        _mm256_permute2f128_ps::<0x20>(a[0], b[0]),
        _mm256_permute2f128_ps::<0x20>(a[1], b[1]),
        _mm256_permute2f128_ps::<0x20>(a[2], b[2]),
        _mm256_permute2f128_ps::<0x31>(a[0], b[0]),
        _mm256_permute2f128_ps::<0x31>(a[1], b[1]),
        _mm256_permute2f128_ps::<0x31>(a[2], b[2]),
    ]
}

/// The numbers of a block at the lowest four bits of eight indices.
#[inline]
#[target_feature(enable = "avx2")]
fn pick(block: V, index: __m256i) -> __m256 {
    // The sign of a lane chooses: bit 3 of its index comes to stand there.
    let high = _mm256_castsi256_ps(_mm256_slli_epi32::<28>(index));
    let low = _mm256_permutevar8x32_ps(block[0], index);
    _mm256_blendv_ps(low, _mm256_permutevar8x32_ps(block[1], index), high)
}

/// [`Lanes::gather`] of one register of indices.
#[inline]
#[target_feature(enable = "avx2")]
fn gather_half(first: V, second: V, index: __m256i) -> __m256 {
    // As in `pick`: bit 4 chooses the block, bit 5 stands for none.
    let later = _mm256_castsi256_ps(_mm256_slli_epi32::<27>(index));
    let absent = _mm256_castsi256_ps(_mm256_slli_epi32::<26>(index));
    let found = _mm256_blendv_ps(pick(first, index), pick(second, index), later);
    _mm256_blendv_ps(found, _mm256_setzero_ps(), absent)
}

// Intrinsics are inlined only into functions with their target feature. The closures of the trait's
// functions do not have it, so that there are none.
// SAFETY: used only where `Isa::available` found the instructions; pointers are used as the trait
// says, unaligned.
unsafe impl Lanes for Avx2 {
    type V = V;

    #[inline(always)]
    unsafe fn splat(x: f32) -> V {
        // SAFETY: the caller has the instructions.
        unsafe { [_mm256_set1_ps(x); 2] }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> V {
        // SAFETY: as the trait says.
        unsafe { [_mm256_loadu_ps(from), _mm256_loadu_ps(from.add(8))] }
    }

    #[inline(always)]
    unsafe fn store(to: *mut f32, v: V) {
        // SAFETY: as the trait says.
        unsafe {
            _mm256_storeu_ps(to, v[0]);
            _mm256_storeu_ps(to.add(8), v[1]);
        }
    }

    #[inline(always)]
    unsafe fn load_first(from: *const f32, count: usize) -> V {
        // SAFETY: as the trait says; lanes that are masked are not touched.
        unsafe {
            let [low, high] = first(count);
            [_mm256_maskload_ps(from, low), _mm256_maskload_ps(from.wrapping_add(8), high)]
        }
    }

    #[inline(always)]
    unsafe fn store_first(to: *mut f32, count: usize, v: V) {
        // SAFETY: as the trait says; lanes that are masked are not touched.
        unsafe {
            let [low, high] = first(count);
            _mm256_maskstore_ps(to, low, v[0]);
            _mm256_maskstore_ps(to.wrapping_add(8), high, v[1]);
        }
    }

    #[inline(always)]
    unsafe fn div(a: V, b: V) -> V {
        // SAFETY: the caller has the instructions.
        unsafe { [_mm256_div_ps(a[0], b[0]), _mm256_div_ps(a[1], b[1])] }
    }

    #[inline(always)]
    unsafe fn sqrt(x: V) -> V {
        // SAFETY: the caller has the instructions.
        unsafe { [_mm256_sqrt_ps(x[0]), _mm256_sqrt_ps(x[1])] }
    }

    #[inline(always)]
    unsafe fn add(a: V, b: V) -> V {
        // SAFETY: the caller has the instructions.
        unsafe { [_mm256_add_ps(a[0], b[0]), _mm256_add_ps(a[1], b[1])] }
    }

    #[inline(always)]
    unsafe fn sub(a: V, b: V) -> V {
        // SAFETY: the caller has the instructions.
        unsafe { [_mm256_sub_ps(a[0], b[0]), _mm256_sub_ps(a[1], b[1])] }
    }

    #[inline(always)]
    unsafe fn mul(a: V, b: V) -> V {
        // SAFETY: the caller has the instructions.
        unsafe { [_mm256_mul_ps(a[0], b[0]), _mm256_mul_ps(a[1], b[1])] }
    }

    #[inline(always)]
    unsafe fn rsqrt(x: V) -> V {
        // SAFETY: the caller has the instructions.
        unsafe { [rsqrt_half(x[0]), rsqrt_half(x[1])] }
    }

    #[inline(always)]
    unsafe fn above(a: V, b: V) -> u16 {
        // SAFETY: the caller has the instructions.
        unsafe {
            let low = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(a[0], b[0])) as u16;
            low | (_mm256_movemask_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(a[1], b[1])) as u16) << 8
        }
    }

    #[inline(always)]
    unsafe fn if_above(a: V, b: V, x: V, y: V) -> V {
        // SAFETY: the caller has the instructions.
        unsafe {
            [
                _mm256_blendv_ps(y[0], x[0], _mm256_cmp_ps::<_CMP_GT_OQ>(a[0], b[0])),
                _mm256_blendv_ps(y[1], x[1], _mm256_cmp_ps::<_CMP_GT_OQ>(a[1], b[1])),
            ]
        }
    }

    #[inline(always)]
    unsafe fn spread(to: *mut f32, [x, y, z, u, v, w]: [V; 6]) {
        // SAFETY: sixteen stores of eight numbers fill the block of the trait.
        unsafe {
            for h in 0..2 {
                let (places, speeds) = (quads(x[h], y[h], z[h]), quads(u[h], v[h], w[h]));
                for r in 0..4 {
                    let node = to.add((4 * r + 2 * h) * NODE);
                    _mm256_storeu_ps(node, _mm256_permute2f128_ps::<0x20>(places[r], speeds[r]));
                    _mm256_storeu_ps(node.add(NODE), _mm256_permute2f128_ps::<0x31>(places[r], speeds[r]));
                }
            }
        }
    }

    #[inline(always)]
    unsafe fn neighbours(nodes: *const f32, at: *const u32) -> [V; 6] {
        // SAFETY: the caller lends sixteen offsets and a node behind each.
        unsafe {
            let node = |i: usize| nodes.add(*at.add(i) as usize);
            let low = neighbours_half(std::array::from_fn(node));
            let high = neighbours_half(std::array::from_fn(|i| node(i + 8)));
            std::array::from_fn(|k| [low[k], high[k]])
        }
    }

    type Index = [__m256i; 2];

    #[inline(always)]
    unsafe fn index(from: *const u8) -> [__m256i; 2] {
        // SAFETY: the caller lends sixteen.
        unsafe {
            [
                _mm256_cvtepu8_epi32(_mm_loadl_epi64(from.cast())),
                _mm256_cvtepu8_epi32(_mm_loadl_epi64(from.add(8).cast())),
            ]
        }
    }

    #[inline(always)]
    unsafe fn gather(first: *const f32, second: *const f32, index: [__m256i; 2]) -> V {
        // SAFETY: the caller lends sixteen numbers at both.
        unsafe {
            let (first, second) = (Self::load(first), Self::load(second));
            [gather_half(first, second, index[0]), gather_half(first, second, index[1])]
        }
    }
}
