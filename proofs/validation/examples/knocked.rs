//! How well the tracker does where a camera was knocked: table of `docs/tracking.md`.

use clap::{Parser, ValueEnum};
use nalgebra::Vector3;
use protocol::random::Random;
use rig::Rig;
use tracker::camera_watch::Notice;
use validation::streams::score::{Score, Tracked, rms};
use validation::streams::{Knock, Recipe, Scenario};

/// What happens to the cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// One is turned or shifted while it runs.
    Knocked,
    /// One stands elsewhere from the start.
    Start,
    /// Two stand elsewhere from the start.
    Two,
    /// One moves all the time, by so much a second.
    Restless,
}

/// Tracks drawn streams with knocked cameras, and prints a table.
#[derive(Parser)]
struct Args {
    /// What happens.
    #[arg(long, value_enum, default_value = "knocked")]
    kind: Kind,
    /// First seed.
    #[arg(long, default_value_t = 1)]
    from: u64,
    /// Seeds.
    #[arg(long, default_value_t = 10)]
    seeds: u64,
    /// Length of each stream, s.
    #[arg(long, default_value_t = 12.0)]
    seconds: f64,
    /// By how much pictures move, px.
    #[arg(long, value_delimiter = ',', default_value = "0.3,0.5,1,3,10")]
    px: Vec<f64>,
    /// Print for every stream what the tracker reported.
    #[arg(long)]
    each: bool,
}

/// A camera is knocked at this instant, s.
const AT_S: f64 = 3.0;
/// Distance of the eye from a camera, mm.
const FAR_MM: f64 = 80.0;

fn main() {
    let args = Args::parse();
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    println!(
        "| scenario | picture moved by, px | detected after, s | included again after, s | minimum coverage | tips, µm | undisturbed | display error, µm | undisturbed | longest gap, fields | eye, mrad | undisturbed |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    for scenario in Scenario::ALL {
        let still: Vec<Outcome> =
            seeds(&args).map(|seed| outcome(&rig, &args, scenario, seed, 0.0)).collect();
        for &px in &args.px {
            let moved: Vec<Outcome> =
                seeds(&args).map(|seed| outcome(&rig, &args, scenario, seed, px)).collect();
            line(scenario, px, &moved, &still);
        }
    }
}

fn seeds(args: &Args) -> std::ops::Range<u64> {
    args.from..args.from + args.seeds
}

/// What became of a stream.
struct Outcome {
    score: Score,
    found_s: Option<f64>,
    back_s: Option<f64>,
}

fn outcome(rig: &Rig, args: &Args, scenario: Scenario, seed: u64, px: f64) -> Outcome {
    let at_s = if args.kind == Kind::Knocked { AT_S } else { 0.0 };
    let knocks = if px == 0.0 { vec![] } else { knocks(rig, args.kind, seed, at_s, px) };
    let stream = Recipe { scenario, seed, seconds: args.seconds, knocks: knocks.clone() }.draw(rig);
    let tracked = Tracked::of(&stream);
    if args.each {
        let notices: Vec<String> = tracked.notices.iter().map(|(t, n)| format!("{t:.2} s {n:?}")).collect();
        let of = knocks.iter().map(|k| k.camera.to_string()).collect::<Vec<_>>().join(",");
        eprintln!("{} {px} px seed {seed} camera {of}: {}", scenario.name(), notices.join("; "));
    }
    let at = |wanted: &dyn Fn(&Notice) -> bool| {
        let own = |n: &Notice| knocks.first().is_some_and(|k| of(n) == Some(k.camera as usize)) && wanted(n);
        tracked.notices.iter().find(|(_, n)| own(n)).map(|(t, _)| t - at_s)
    };
    // Bodies are found within the first fields.
    let from = if args.kind == Kind::Start { 0.1 } else { at_s.max(0.5) };
    Outcome {
        score: Score::of(&tracked, &stream, from, args.seconds - 0.2),
        found_s: at(&|n| matches!(n, Notice::Moved { .. })),
        back_s: at(&|n| matches!(n, Notice::TakenBack { .. })),
    }
}

fn of(notice: &Notice) -> Option<usize> {
    match notice {
        Notice::Moved { camera, .. }
        | Notice::Cleared { camera }
        | Notice::TakenBack { camera, .. }
        | Notice::StillMoving { camera } => Some(*camera),
        Notice::Disagree { .. } => None,
    }
}

/// Every third is a shift, the others are turns; directions are drawn.
fn knocks(rig: &Rig, kind: Kind, seed: u64, at_s: f64, px: f64) -> Vec<Knock> {
    let random = &mut Random::new(seed, 77);
    let first = random.below(rig.cameras.len());
    let count = if kind == Kind::Two { 2 } else { 1 };
    let one = |n: usize| {
        let camera = &rig.cameras()[(first + n) % rig.cameras.len()];
        let to = Vector3::new(random.normal(), random.normal(), 0.3 * random.normal()).normalize();
        let rad = px / camera.focal_px.x;
        let (turn, shift_mm) = if seed % 3 == 2 {
            (Vector3::zeros(), to * (rad * FAR_MM))
        } else {
            (to * rad, Vector3::zeros())
        };
        Knock { camera: camera.id, at_s, turn, shift_mm, goes_on: kind == Kind::Restless }
    };
    (0..count).map(one).collect()
}

fn line(scenario: Scenario, px: f64, moved: &[Outcome], still: &[Outcome]) {
    let worst = |of: &dyn Fn(&Outcome) -> Option<f64>| {
        let all: Option<Vec<f64>> = moved.iter().map(of).collect();
        all.map_or("never".to_owned(), |all| format!("{:.2}", all.into_iter().fold(0.0, f64::max)))
    };
    let least = moved.iter().map(|o| o.score.coverage()).fold(1.0, f64::min);
    let all = |outcomes: &[Outcome], of: &dyn Fn(&Score) -> Vec<f64>| {
        rms(&outcomes.iter().flat_map(|o| of(&o.score)).collect::<Vec<f64>>())
    };
    let (tips, shown, eye) =
        (|s: &Score| s.tips_um.clone(), |s: &Score| s.shown_um.clone(), |s: &Score| s.eye_mrad.clone());
    println!(
        "| {} | {px} | {} | {} | {least:.4} | {:.1} | {:.1} | {:.0} | {:.0} | {} | {:.2} | {:.2} |",
        scenario.name(),
        worst(&|o| o.found_s),
        worst(&|o| o.back_s),
        all(moved, &tips),
        all(still, &tips),
        all(moved, &shown),
        all(still, &shown),
        moved.iter().map(|o| o.score.longest_gap).max().unwrap_or(0),
        all(moved, &eye),
        all(still, &eye),
    );
}
