//! Sixteen numbers at a time: what the spring kernel needs of a processor, and the choice between
//! AVX-512, AVX2 and plain code at run time.
//!
//! Every path does the same additions, multiplications and comparisons in the same order and fuses
//! nothing, so that all give the same bits. The springs take no square root and no division:
//! [`rsqrt`] starts from the bits of its argument and takes three Newton steps, which costs a third
//! of what the two instructions do.
//!
//! Memory order within a block of sixteen: item `n` lies at [`lane_index`]`(n)`, so that registers
//! of four quads are stored as they come out of a 4×4 transposition. This is the one folder of the
//! simulation with `unsafe`.
#![allow(unsafe_code)]
// The trait states once what holds for each of its methods; lanes are numbers, not items of one
// list.
#![allow(clippy::missing_safety_doc, clippy::needless_range_loop)]

pub mod aligned;
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
pub mod hinges;
pub mod kernel;
pub mod motion;
mod portable;

#[cfg(target_arch = "x86_64")]
pub use avx2::Avx2;
#[cfg(target_arch = "x86_64")]
pub use avx512::Avx512;
pub use portable::Portable;

/// Nodes or springs of a block.
pub const WIDE: usize = 16;
/// Numbers of a node in memory: x, y, z, 0, then its velocity and 0.
pub const NODE: usize = 8;
/// In the numbers of [`Lanes::gather`]: this lane takes nothing.
pub const ABSENT: u8 = 32;

/// Where item `n` of a list lies in memory; it stays in its block of sixteen.
pub const fn lane_index(n: usize) -> usize {
    (n & !15) | ((n & 3) << 2) | ((n >> 2) & 3)
}

/// Constants of [`rsqrt`]: the bits from which half those of x are taken, the first step's two, the
/// second step's two. The first three are those of Kadlec (2010), with a relative error below
/// 7·10⁻⁴ after the first step; the second is Newton's.
const ROOT: [f32; 5] = [f32::from_bits(0x5f1f_fff9), 0.703_952_25, 0.703_952_25 * 2.389_244_6, 0.5, 1.5];

/// 1/√x for x > 0 and finite, relative error below 8·10⁻⁷. The vectors of every path repeat exactly
/// these operations.
#[inline(always)]
pub fn rsqrt(x: f32) -> f32 {
    let [guess, first, second, half, newton] = ROOT;
    let y = f32::from_bits(guess.to_bits().wrapping_sub(x.to_bits() >> 1));
    let y = y * (second - x * first * y * y);
    y * (newton - x * half * y * y)
}

/// Sixteen `f32` and what the kernel does with them.
///
/// # Safety
/// Every method may be called only where the processor has the instructions of the type; pointers
/// must be valid for what the method says that it reads or writes, without any alignment beyond
/// that of `f32` and `u32`.
pub unsafe trait Lanes {
    /// The sixteen numbers.
    type V: Copy;
    /// All equal.
    unsafe fn splat(x: f32) -> Self::V;
    /// Reads sixteen numbers.
    unsafe fn load(from: *const f32) -> Self::V;
    /// Writes sixteen numbers.
    unsafe fn store(to: *mut f32, v: Self::V);
    /// Reads the first `count` of sixteen numbers, at most sixteen; the others are 0.
    unsafe fn load_first(from: *const f32, count: usize) -> Self::V;
    /// Writes the first `count` of sixteen numbers, at most sixteen.
    unsafe fn store_first(to: *mut f32, count: usize, v: Self::V);
    /// a + b.
    unsafe fn add(a: Self::V, b: Self::V) -> Self::V;
    /// a − b.
    unsafe fn sub(a: Self::V, b: Self::V) -> Self::V;
    /// a · b.
    unsafe fn mul(a: Self::V, b: Self::V) -> Self::V;
    /// a / b, rounded as the standard says.
    unsafe fn div(a: Self::V, b: Self::V) -> Self::V;
    /// √x, rounded as the standard says.
    unsafe fn sqrt(x: Self::V) -> Self::V;
    /// [`rsqrt`].
    unsafe fn rsqrt(x: Self::V) -> Self::V;
    /// One bit for each lane with a > b; none where one is not a number.
    unsafe fn above(a: Self::V, b: Self::V) -> u16;
    /// In each lane `x` where a > b, else `y`.
    unsafe fn if_above(a: Self::V, b: Self::V, x: Self::V, y: Self::V) -> Self::V;
    /// Writes a block of nodes (16·[`NODE`] numbers) from x, y, z and the three velocities.
    unsafe fn spread(to: *mut f32, parts: [Self::V; 6]);
    /// Reads sixteen nodes; node `i` begins `at[i]` numbers after `nodes`.
    unsafe fn neighbours(nodes: *const f32, at: *const u32) -> [Self::V; 6];
    /// Where sixteen lanes take their numbers from; see [`Self::gather`].
    type Index: Copy;
    /// Reads sixteen of them.
    unsafe fn index(from: *const u8) -> Self::Index;
    /// For each lane the number of that index: 0 to 15 of the block at `first`, 16 to 31 of the
    /// block at `second`, and 0 where it is [`ABSENT`].
    unsafe fn gather(first: *const f32, second: *const f32, index: Self::Index) -> Self::V;
}

/// An instruction set of this processor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Isa {
    Portable,
    Avx2,
    Avx512,
}

impl Isa {
    /// The best one.
    pub fn best() -> Self {
        *Self::available().last().expect("plain code always runs")
    }

    /// All there are, from slow to fast.
    pub fn available() -> Vec<Self> {
        let mut all = vec![Isa::Portable];
        #[cfg(target_arch = "x86_64")]
        {
            if std::arch::is_x86_feature_detected!("avx2") {
                all.push(Isa::Avx2);
            }
            if std::arch::is_x86_feature_detected!("avx512f")
                && std::arch::is_x86_feature_detected!("avx512dq")
            {
                all.push(Isa::Avx512);
            }
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_root_is_as_good_as_single_precision_lets_it_be(x in 1e-12f32..1e12) {
            let exact = 1.0 / f64::from(x).sqrt();
            prop_assert!((f64::from(rsqrt(x)) / exact - 1.0).abs() < 8e-7);
        }
    }

    /// What each method does to numbers of a fixed pattern, as bits.
    unsafe fn bits<L: Lanes>() -> Vec<u32> {
        let numbers: Vec<f32> = (0..512).map(|i| ((i * 37 % 101) as f32 - 30.0) * 0.37).collect();
        let at: Vec<u32> = (0..48).map(|i| (i * 29 % 60) * 8).collect();
        let mut out = vec![0f32; 1024];
        let to = out.as_mut_ptr();
        // SAFETY: offsets stay below 480 + 8 numbers of 512, writes below 1,024; the caller has the
        // instructions.
        unsafe {
            let (a, b) = (L::load(numbers.as_ptr()), L::load(numbers.as_ptr().add(16)));
            for (i, v) in [L::add(a, b), L::sub(a, b), L::mul(a, b), L::splat(3.0)].into_iter().enumerate() {
                L::store(to.add(16 * i), v);
            }
            L::store(to.add(960), L::div(a, b));
            L::store(to.add(976), L::sqrt(L::mul(a, a)));
            L::store(to.add(64), L::rsqrt(L::add(L::mul(a, a), L::splat(1e-12))));
            let parts = L::neighbours(numbers.as_ptr(), at.as_ptr());
            (0..6).for_each(|i| L::store(to.add(80 + 16 * i), parts[i]));
            L::spread(to.add(176), parts);
            let index: Vec<u8> = (0..16u16).map(|i| (i * 29 % 40) as u8).collect();
            let picked =
                L::gather(numbers.as_ptr().add(3), numbers.as_ptr().add(70), L::index(index.as_ptr()));
            L::store(to.add(304), picked);
            L::store(to.add(320), L::if_above(a, b, L::splat(1.5), a));
            *to.add(336) = f32::from(L::above(a, b));
            for count in 0..=WIDE {
                L::store(to.add(352 + 32 * count), L::load_first(numbers.as_ptr().add(count), count));
                L::store_first(to.add(368 + 32 * count), count, a);
            }
        }
        out.iter().map(|x| x.to_bits()).collect()
    }

    #[test]
    fn every_path_gives_the_same_bits() {
        // SAFETY: plain code, then only what the processor has.
        unsafe {
            let plain = bits::<Portable>();
            assert!(plain.iter().filter(|&&b| b != 0).count() > 300);
            #[cfg(target_arch = "x86_64")]
            for isa in Isa::available() {
                match isa {
                    Isa::Portable => {}
                    Isa::Avx2 => assert_eq!(bits::<Avx2>(), plain),
                    Isa::Avx512 => assert_eq!(bits::<Avx512>(), plain),
                }
            }
        }
    }
}
