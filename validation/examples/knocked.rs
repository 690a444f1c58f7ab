//! How well the tracker does where a camera was knocked.

use clap::Parser;
use nalgebra::Vector3;
use protocol::random::Random;
use protocol::rig::Rig;
use tracker::Tracker;
use tracker::assembler::FrameAssembler;
use tracker::camera_watch::Notice;
use validation::streams::score::{Score, rms};
use validation::streams::{Knock, Recipe, Scenario, Stream};

#[derive(Parser)]
struct Args {
    #[arg(long, default_value_t = 1)]
    from: u64,
    #[arg(long, default_value_t = 4)]
    seeds: u64,
    #[arg(long, default_value_t = 12.0)]
    seconds: f64,
    /// Picture shifts, px.
    #[arg(long, value_delimiter = ',', default_value = "0.3,0.5,1,2,3,5,10")]
    px: Vec<f64>,
    /// At, s; 0: wrong from the start.
    #[arg(long, default_value_t = 3.0)]
    at: f64,
}

fn main() {
    let args = Args::parse();
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    for scenario in [Scenario::Nominal, Scenario::Async, Scenario::Tremor, Scenario::Hard] {
        for &px in std::iter::once(&0.0).chain(&args.px) {
            let mut line = String::new();
            for seed in args.from..args.from + args.seeds {
                let mut random = Random::new(seed, 77);
                let camera = random.below(3) as u32;
                let focal = rig.cameras()[camera as usize].focal_px.x;
                let direction =
                    Vector3::new(random.normal(), random.normal(), 0.3 * random.normal()).normalize();
                let (turn, shift_mm) = if seed % 3 == 2 {
                    (Vector3::zeros(), direction * (px / focal * 80.0))
                } else {
                    (direction * (px / focal), Vector3::zeros())
                };
                let knock = Knock { camera, at_s: args.at, turn, shift_mm, goes_on: false };
                let knocks = if px > 0.0 { vec![knock] } else { vec![] };
                let stream = Recipe { scenario, seed, seconds: args.seconds, knocks }.draw(&rig);
                line += &score(&rig, &stream, args.at, args.seconds);
            }
            println!("{:8} {px:4} px {line}", scenario.name());
        }
    }
}

fn score(rig: &Rig, stream: &Stream, at: f64, seconds: f64) -> String {
    let mut frames = Vec::new();
    let (mut assembler, mut tracker) = (FrameAssembler::new(rig), Tracker::new(rig));
    let mut told = String::new();
    for field in &stream.fields {
        assembler.add(field, field.blobs_out_ns, |used, closed| {
            frames.push(tracker.track(used, &closed.reference));
            if let Some(notice) = tracker.take_notice() {
                let t = closed.reference.exposed_ns as f64 * 1e-9;
                told += &match notice {
                    Notice::Moved { camera, px } => format!(" {t:.2}:out{camera}({px:.2})"),
                    Notice::TakenBack { camera, px } => format!(" {t:.2}:back{camera}({px:.2})"),
                    other => format!(" {t:.2}:{other:?}"),
                };
            }
        });
    }
    let of = |from: f64, to: f64| Score::of(&frames, &stream.motion, from, to);
    let from = at.max(0.5);
    let (all, late) = (of(from, seconds - 0.2), of(from + 5.0, seconds - 0.2));
    format!(
        " | {:6.1} µm {:.2} mrad {:.4} late {:5.1}{told}",
        rms(&all.tips_um),
        rms(&all.eye_mrad),
        all.coverage(),
        rms(&late.tips_um)
    )
}
