//! What the machine could do at best: arithmetic and memory traffic, measured here and now.

use pulp::{Arch, NullaryFnOnce};
use std::hint::black_box;
use std::time::Instant;

/// Arithmetic of a structural spring with its third of a node: 47 and 33/3 additions, multiplications and comparisons.
const FLOPS_A_SPRING: f64 = 58.0;
/// Bytes a spring must move at least if every array is read and written once: far end, rest length, stiffness, damping and limit
/// (20), its force written and read (32) and its number at the far node (4); a third of a node's state read and written (48), its copy
/// for the springs written and read (64), forces and accelerations (56), outer forces and mobility (16).
const BYTES_A_SPRING: f64 = 56.0 + 184.0 / 3.0;

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

/// Multiplications and additions of numbers in the first cache, sixteen of each on every number between load and store; not
/// fused, as the core's are not.
struct Arithmetic<'a>(&'a mut [f32]);

/// Numbers, and operations on each.
const NUMBERS: usize = 1024;
const OPERATIONS: usize = 32;

impl NullaryFnOnce for Arithmetic<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for x in self.0.iter_mut() {
            let mut y = *x;
            for _ in 0..OPERATIONS / 2 {
                y = y * 0.999_9 + 0.000_1;
            }
            *x = y;
        }
    }
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
        let (rounds, mut numbers) = (1000, vec![1.0f32; NUMBERS]);
        let seconds = fastest(31, || {
            for _ in 0..rounds {
                arch.dispatch(Arithmetic(black_box(&mut numbers)));
            }
        });
        let gflops = (rounds * NUMBERS * OPERATIONS) as f64 / seconds * 1e-9;
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

    /// Share of the roofline that a step of `springs` springs in `us` µs reaches, and which side of the roof it is.
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
