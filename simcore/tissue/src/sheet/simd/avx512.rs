//! AVX-512: sixteen lanes in one register.

use super::{ABSENT, Lanes, NODE, ROOT};
use std::arch::x86_64::*;

/// Sixteen numbers in a register of 512 bits.
#[derive(Debug)]
pub struct Avx512;

/// Rows (0, 1, 2 of each quad) of four registers of quads: 128-bit part `l` of register `r` holds
/// quad `4 l + r`.
#[inline]
#[target_feature(enable = "avx512f,avx512dq")]
fn columns([a, b, c, d]: [__m512; 4]) -> [__m512; 3] {
    let (low_ab, low_cd) = (_mm512_unpacklo_ps(a, b), _mm512_unpacklo_ps(c, d));
    let (high_ab, high_cd) = (_mm512_unpackhi_ps(a, b), _mm512_unpackhi_ps(c, d));
    let x = _mm512_shuffle_ps::<0x44>(low_ab, low_cd);
    let y = _mm512_shuffle_ps::<0xee>(low_ab, low_cd);
    [x, y, _mm512_shuffle_ps::<0x44>(high_ab, high_cd)]
}

/// The reverse of [`columns`], with 0 as the fourth number of each quad.
#[inline]
#[target_feature(enable = "avx512f,avx512dq")]
fn quads([x, y, z]: [__m512; 3]) -> [__m512; 4] {
    let zero = _mm512_setzero_ps();
    let (low, high) = (_mm512_unpacklo_ps(x, y), _mm512_unpackhi_ps(x, y));
    let (low_z, high_z) = (_mm512_unpacklo_ps(z, zero), _mm512_unpackhi_ps(z, zero));
    [
        _mm512_shuffle_ps::<0x44>(low, low_z),
        _mm512_shuffle_ps::<0xee>(low, low_z),
        _mm512_shuffle_ps::<0x44>(high, high_z),
        _mm512_shuffle_ps::<0xee>(high, high_z),
    ]
}

// SAFETY: used only where `Isa::available` found the instructions; pointers are used as the trait
// says, unaligned.
unsafe impl Lanes for Avx512 {
    type V = __m512;

    #[inline(always)]
    unsafe fn splat(x: f32) -> __m512 {
        // SAFETY: the caller has the instructions.
        unsafe { _mm512_set1_ps(x) }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> __m512 {
        // SAFETY: as the trait says.
        unsafe { _mm512_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn store(to: *mut f32, v: __m512) {
        // SAFETY: as the trait says.
        unsafe { _mm512_storeu_ps(to, v) }
    }

    #[inline(always)]
    unsafe fn load_first(from: *const f32, count: usize) -> __m512 {
        // SAFETY: as the trait says; lanes that are masked are not touched.
        unsafe { _mm512_maskz_loadu_ps(((1u32 << count) - 1) as u16, from) }
    }

    #[inline(always)]
    unsafe fn store_first(to: *mut f32, count: usize, v: __m512) {
        // SAFETY: as the trait says; lanes that are masked are not touched.
        unsafe { _mm512_mask_storeu_ps(to, ((1u32 << count) - 1) as u16, v) }
    }

    #[inline(always)]
    unsafe fn div(a: __m512, b: __m512) -> __m512 {
        // SAFETY: the caller has the instructions.
        unsafe { _mm512_div_ps(a, b) }
    }

    #[inline(always)]
    unsafe fn sqrt(x: __m512) -> __m512 {
        // SAFETY: the caller has the instructions.
        unsafe { _mm512_sqrt_ps(x) }
    }

    #[inline(always)]
    unsafe fn add(a: __m512, b: __m512) -> __m512 {
        // SAFETY: the caller has the instructions.
        unsafe { _mm512_add_ps(a, b) }
    }

    #[inline(always)]
    unsafe fn sub(a: __m512, b: __m512) -> __m512 {
        // SAFETY: the caller has the instructions.
        unsafe { _mm512_sub_ps(a, b) }
    }

    #[inline(always)]
    unsafe fn mul(a: __m512, b: __m512) -> __m512 {
        // SAFETY: the caller has the instructions.
        unsafe { _mm512_mul_ps(a, b) }
    }

    #[inline(always)]
    unsafe fn rsqrt(x: __m512) -> __m512 {
        // SAFETY: the caller has the instructions.
        unsafe {
            let [guess, first, second, half, newton] = ROOT.map(|x| _mm512_set1_ps(x));
            let bits = _mm512_srli_epi32::<1>(_mm512_castps_si512(x));
            let y = _mm512_castsi512_ps(_mm512_sub_epi32(_mm512_castps_si512(guess), bits));
            let share = _mm512_mul_ps(_mm512_mul_ps(_mm512_mul_ps(x, first), y), y);
            let y = _mm512_mul_ps(y, _mm512_sub_ps(second, share));
            let share = _mm512_mul_ps(_mm512_mul_ps(_mm512_mul_ps(x, half), y), y);
            _mm512_mul_ps(y, _mm512_sub_ps(newton, share))
        }
    }

    #[inline(always)]
    unsafe fn above(a: __m512, b: __m512) -> u16 {
        // SAFETY: the caller has the instructions.
        unsafe { _mm512_cmp_ps_mask::<_CMP_GT_OQ>(a, b) }
    }

    #[inline(always)]
    unsafe fn if_above(a: __m512, b: __m512, x: __m512, y: __m512) -> __m512 {
        // SAFETY: the caller has the instructions.
        unsafe { _mm512_mask_blend_ps(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(a, b), y, x) }
    }

    #[inline(always)]
    unsafe fn spread(to: *mut f32, [x, y, z, u, v, w]: [__m512; 6]) {
        // SAFETY: eight stores of sixteen numbers fill the block of the trait.
        unsafe {
            let (places, speeds) = (quads([x, y, z]), quads([u, v, w]));
            let first = _mm512_setr_epi64(0, 1, 8, 9, 2, 3, 10, 11);
            let second = _mm512_setr_epi64(4, 5, 12, 13, 6, 7, 14, 15);
            for r in 0..4 {
                let (p, s) = (_mm512_castps_pd(places[r]), _mm512_castps_pd(speeds[r]));
                for (half, pick) in [first, second].into_iter().enumerate() {
                    let two = _mm512_castpd_ps(_mm512_permutex2var_pd(p, pick, s));
                    _mm512_storeu_ps(to.add((4 * r + 2 * half) * NODE), two);
                }
            }
        }
    }

    #[inline(always)]
    unsafe fn neighbours(nodes: *const f32, at: *const u32) -> [__m512; 6] {
        // SAFETY: the caller lends sixteen offsets and a node behind each.
        unsafe {
            let two = |i: usize| {
                let node = |i: usize| _mm256_loadu_ps(nodes.add(*at.add(i) as usize));
                _mm512_insertf32x8::<1>(_mm512_castps256_ps512(node(i)), node(i + 4))
            };
            let a = columns([two(0), two(1), two(2), two(3)]);
            let b = columns([two(8), two(9), two(10), two(11)]);
            let place = |k: usize| _mm512_shuffle_f32x4::<0x88>(a[k], b[k]);
            let speed = |k: usize| _mm512_shuffle_f32x4::<0xdd>(a[k], b[k]);
            [place(0), place(1), place(2), speed(0), speed(1), speed(2)]
        }
    }

    type Index = (__m512i, __mmask16);

    #[inline(always)]
    unsafe fn index(from: *const u8) -> Self::Index {
        // SAFETY: the caller lends sixteen.
        unsafe {
            let index = _mm512_cvtepu8_epi32(_mm_loadu_si128(from.cast()));
            (index, _mm512_testn_epi32_mask(index, _mm512_set1_epi32(i32::from(ABSENT))))
        }
    }

    #[inline(always)]
    unsafe fn gather(first: *const f32, second: *const f32, (index, present): Self::Index) -> __m512 {
        // SAFETY: the caller lends sixteen numbers at both.
        unsafe {
            let (first, second) = (_mm512_loadu_ps(first), _mm512_loadu_ps(second));
            _mm512_maskz_permutex2var_ps(present, first, index, second)
        }
    }
}
