//! What the machine could do at best: arithmetic and memory traffic, measured here and now.

use pulp::{Arch, NullaryFnOnce};
use std::hint::black_box;
use std::time::Instant;

/// Operations on numbers of a structural spring, counted in `simcore/src/membrane/lanes/kernel.rs`:
/// differences 6, squared length 6, root 12, length 1, rate 6, elastic force 3 with its limit,
/// force 6, sums of both ends 6; and of a third of a node: acceleration 23, and in `motion.rs` 33.
const FLOPS_A_SPRING: f64 = 46.0 + 56.0 / 3.0;
/// Bytes that a spring must move at least if every array is read and written once and the rings
/// stay in the first cache: number of its far end, rest length, stiffness, damping, limit and pull
/// (24) and one of sixteen lanes of a pick (1.5); a third of a node: place and velocity read twice
/// and written once (72), outer force and mobility (20), force, acceleration and its square written
/// and the latter two read again (44).
const BYTES_A_SPRING: f64 = 25.5 + 136.0 / 3.0;

/// Measured limits of one core.
pub struct Machine {
    gflops: f64,
    /// Working set in bytes, GB/s.
    bandwidth: Vec<(usize, f64)>,
}

/// Time at the limit over time taken.
#[derive(Clone, Copy)]
pub struct Share {
    pub of_best: f64,
    pub bound: &'static str,
}

/// Multiplications and additions of `N` numbers that stay in registers, in chains side by side so
/// that none waits for another; not fused, as the core's are not.
struct Arithmetic<'a, const N: usize>(&'a mut [f32; N]);

/// Operations on each number.
const OPERATIONS: usize = 20_000;

impl<const N: usize> NullaryFnOnce for Arithmetic<'_, N> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let mut numbers = *self.0;
        for _ in 0..OPERATIONS / 2 {
            for x in &mut numbers {
                *x = *x * 0.999_9 + 0.000_1;
            }
        }
        *self.0 = numbers;
    }
}

/// Thousand million operations a second on `N` numbers side by side.
fn gflops<const N: usize>(arch: Arch) -> f64 {
    let mut numbers = [1.0f32; N];
    let seconds = fastest(31, || arch.dispatch(Arithmetic(black_box(&mut numbers))));
    (N * OPERATIONS) as f64 / seconds * 1e-9
}

/// Reads one array and writes another, as the passes of the core do.
struct Copy<'a>(&'a [f32], &'a mut [f32]);

impl NullaryFnOnce for Copy<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.0.iter().zip(self.1).for_each(|(from, to)| *to = *from * 1.5);
    }
}

fn fastest(times: usize, mut run: impl FnMut()) -> f64 {
    let mut best = f64::INFINITY;
    for _ in 0..times {
        let begin = Instant::now();
        run();
        best = best.min(begin.elapsed().as_secs_f64());
    }
    best
}

impl Machine {
    /// Takes about half a second.
    pub fn measure() -> Self {
        let arch = Arch::new();
        // As many chains as registers hold: six or twelve of AVX2, twelve or twenty-four of
        // AVX-512.
        let tries = [gflops::<48>(arch), gflops::<96>(arch), gflops::<192>(arch), gflops::<384>(arch)];
        let gflops = tries.into_iter().fold(0.0, f64::max);
        let bandwidth = [32 << 10, 256 << 10, 768 << 10, 4 << 20, 16 << 20].map(|bytes: usize| {
            let half = bytes / 8;
            let (from, mut to) = (vec![1.0f32; half], vec![0.0f32; half]);
            let repeats = (64 << 20) / bytes;
            let seconds = fastest(7, || {
                for _ in 0..repeats {
                    arch.dispatch(Copy(black_box(&from), black_box(&mut to)));
                }
            });
            (bytes, (bytes * repeats) as f64 / seconds * 1e-9)
        });
        Machine { gflops, bandwidth: bandwidth.to_vec() }
    }

    /// In words.
    pub fn print(&self) {
        println!("one core: {:.0} GFLOP/s of unfused f32 arithmetic in registers", self.gflops);
        for (bytes, rate) in &self.bandwidth {
            println!("          {rate:.0} GB/s copying within {} KiB", bytes >> 10);
        }
    }

    /// Share of the roofline that a step of `springs` springs in `us` µs reaches, and which side of
    /// the roof it is.
    pub fn share(&self, springs: usize, us: f64) -> Share {
        let bytes = BYTES_A_SPRING * springs as f64;
        let level = self.bandwidth.iter().find(|(set, _)| *set as f64 >= bytes).or(self.bandwidth.last());
        let rate = level.expect("sizes were measured").1;
        let memory = bytes / rate * 1e-3;
        let arithmetic = FLOPS_A_SPRING * springs as f64 / self.gflops * 1e-3;
        let bound = if memory > arithmetic { "memory" } else { "arithmetic" };
        Share { of_best: memory.max(arithmetic) / us, bound }
    }
}
