//! Where the error of `hard` streams above their bound comes from: table of `docs/tracking.md`.

use clap::Parser;
use protocol::limits::INSTRUMENTS;
use rig::Rig;
use validation::streams::bound::TipBound;
use validation::streams::score::Tracked;
use validation::streams::{Recipe, Scenario, Stream};

/// Tracks drawn streams of `hard`, and prints the squared errors of the tips and their bounds by what is done with the
/// instrument.
#[derive(Parser)]
struct Args {
    /// First seed.
    #[arg(long, default_value_t = 3001)]
    from: u64,
    /// Seeds.
    #[arg(long, default_value_t = 24)]
    seeds: u64,
    /// Length of each stream, s.
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// The bound is computed at every so manieth instant.
    #[arg(long, default_value_t = 4)]
    every: usize,
}

/// The first of a stream is not scored, s: the filters settle.
const SETTLED_S: f64 = 0.5;

/// What is done with an instrument.
const PARTS: [&str; 6] = [
    "instrument that is not taken out, or not yet",
    "first 0.3 s of taking it out",
    "the rest of taking it out",
    "while it is put back (0.95 s)",
    "1.55 s after that",
    "later",
];

/// Sums of a part.
#[derive(Default, Clone, Copy)]
struct Sums {
    frames: f64,
    error_um2: f64,
    bounds: f64,
    bound_um2: f64,
}

impl Sums {
    fn bound_um2(&self) -> f64 {
        self.bound_um2 / self.bounds.max(1.0)
    }
}

fn main() {
    let args = Args::parse();
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    let mut parts = [Sums::default(); PARTS.len()];
    for seed in args.from..args.from + args.seeds {
        let recipe = Recipe { scenario: Scenario::Hard, seed, seconds: args.seconds, knocks: vec![] };
        let stream = recipe.draw(&rig);
        let tracked = Tracked::of(&stream);
        for instrument in 0..INSTRUMENTS {
            add(&stream, &tracked, instrument, &args, &mut parts);
        }
    }
    let frames: f64 = parts.iter().map(|p| p.frames).sum();
    let errors: f64 = parts.iter().map(|p| p.error_um2).sum();
    let bounds: f64 = parts.iter().map(|p| p.frames * p.bound_um2()).sum();
    println!(
        "| frames | share of frames | error², µm² | bound², µm² | share of the excess |\n|---|---|---|---|---|"
    );
    for (name, part) in PARTS.iter().zip(&parts) {
        let (error, bound) = (part.error_um2 / part.frames.max(1.0), part.bound_um2());
        let excess = (part.error_um2 - part.frames * bound) / (errors - bounds);
        println!("| {name} | {:.2} | {error:.0} | {bound:.0} | {excess:.2} |", part.frames / frames);
    }
    let [error, bound] = [errors, bounds].map(|sum| libm::sqrt(sum / frames));
    println!("\ntips {error:.2} µm, bound {bound:.2}, ratio {:.2}", error / bound);
}

fn add(stream: &Stream, tracked: &Tracked, instrument: usize, args: &Args, parts: &mut [Sums]) {
    let mut bound = TipBound::new(stream, instrument);
    let scored = tracked.measured_s(stream, instrument, SETTLED_S, args.seconds - 0.2);
    let frames = tracked.frames.iter().map(|f| (f.instants.exposed as f64 * 1e-9, f));
    let measured = frames.filter(|(t_s, _)| scored.binary_search_by(|s| s.total_cmp(t_s)).is_ok());
    for (n, (t_s, frame)) in measured.enumerate() {
        let part = &mut parts[part_of(stream.motion.taken_out_s(instrument), t_s)];
        let tip = frame.bodies[instrument].world_from_body.isometry().translation.vector;
        let truth = stream.motion.at(t_s).bodies[instrument].translation.vector;
        part.frames += 1.0;
        part.error_um2 += (tip - truth).norm_squared() * 1e6;
        if n % args.every == 0
            && let Some(um) = bound.at_um(t_s)
        {
            part.bounds += 1.0;
            part.bound_um2 += um * um;
        }
    }
}

/// By the instants at which it begins to be taken out and put back.
fn part_of(taken_out_s: Option<[f64; 2]>, t_s: f64) -> usize {
    let Some([out, back]) = taken_out_s else { return 0 };
    [out, out + 0.3, back, back + 0.95, back + 2.5].iter().filter(|begin| t_s >= **begin).count()
}
