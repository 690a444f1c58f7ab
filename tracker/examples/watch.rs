//! `watch INSTANCE SECONDS`: what a running tracker publishes, one line a second: frames, share
//! measured, residual, latency and CPU time.

use anyhow::Context;
use ipc::clock::now;
use ipc::{Instance, Queue, wait};
use protocol::geometry::Validity;
use protocol::health::{Health, Process};
use protocol::poses::{BODY_NAMES, ClosedBy, TrackerFrame};

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().context("usage: watch INSTANCE SECONDS")?;
    let seconds: u64 = arguments.next().context("usage: watch INSTANCE SECONDS")?.parse()?;
    let instance = Instance::join(&name)?;
    let mut poses = instance.receiver::<TrackerFrame>(Queue::InOrder)?;
    let mut health = instance.receiver::<Health>(Queue::InOrder)?;
    let begin = now();
    let mut cpu_before = 0;
    for second in 1..=seconds {
        let mut frames = Vec::new();
        let mut cpu_ns = cpu_before;
        while now() < begin + second * 1_000_000_000 {
            wait(&[&poses, &health], 5_000_000);
            frames.extend(std::iter::from_fn(|| poses.next_valid().ok().flatten()));
            while let Some(beat) = health.next_valid()? {
                if beat.process == Process::Tracker as u32 {
                    cpu_ns = beat.cpu_ns;
                }
            }
        }
        print!("{} frames, CPU {:.1} %", frames.len(), (cpu_ns - cpu_before) as f64 * 1e-7);
        cpu_before = cpu_ns;
        let late = frames.iter().filter(|f| f.closed_by != ClosedBy::Inputs as u32).count();
        let mean =
            |of: &dyn Fn(&TrackerFrame) -> f64| frames.iter().map(of).sum::<f64>() / frames.len() as f64;
        let tracking = mean(&|f| f.instants.tracked.saturating_sub(f.instants.blobs_out) as f64 * 1e-6);
        let proper = mean(&|f| f.instants.tracked.saturating_sub(f.instants.taken) as f64 * 1e-6);
        print!(", {late} late, tracking {tracking:.2} ms of which computed {proper:.2}");
        for (body, name) in BODY_NAMES.iter().enumerate() {
            let measured = mean(&|f| f64::from(u8::from(f.bodies[body].validity() == Validity::Measured)));
            let residual = mean(&|f| f.bodies[body].residual_px);
            let blobs = mean(&|f| f64::from(f.bodies[body].blobs_used));
            print!(" | {name} {:.0} % {blobs:.1} blobs {residual:.3} px", measured * 100.0);
        }
        println!();
    }
    Ok(())
}
