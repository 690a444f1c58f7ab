//! How well the tracker does where a camera was knocked: tables of `docs/tracking.md`.

use calibration::causes::{Cause, Verdict, Work, judge_within};
use clap::{Parser, ValueEnum};
use nalgebra::Vector3;
use protocol::random::Random;
use rig::Rig;
use tracker::camera_watch::Notice;
use validation::planted::is_truth;
use validation::streams::score::{Score, Tracked, rms};
use validation::streams::{Knock, Recipe, Scenario, Stream, bound};

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

/// Tracks drawn streams with knocked cameras, and prints a table: root mean squares over all streams, and beside them
/// those of the same streams with every camera in its place. The bound is the posterior Cramér–Rao bound of the tips
/// (validation::streams::bound) of a tracker that knows when which camera was moved, and how: it is that of the
/// undisturbed stream, because the blobs of a moved camera say as much.
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
    /// Only scenarios whose name contains this.
    #[arg(long, default_value = "")]
    only: String,
    /// Leave the bound out: it takes a second and more a stream.
    #[arg(long)]
    no_bound: bool,
    /// Print for every stream what the tracker reported.
    #[arg(long)]
    each: bool,
}

/// A camera is knocked at this instant, s.
const AT_S: f64 = 3.0;
/// Error of a tip that is counted where two cameras were moved, µm.
const FAR_OFF_UM: f64 = 100.0;
/// Distance of the eye from a camera, mm.
const FAR_MM: f64 = 80.0;

fn main() {
    let args = Args::parse();
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    let (head, columns) = match args.kind {
        Kind::Two => (HEAD_OF_TWO, 16),
        _ => (HEAD, 13),
    };
    println!("{head}\n|{}", "---|".repeat(columns));
    for scenario in Scenario::ALL.into_iter().filter(|s| s.name().contains(&args.only)) {
        let still: Vec<Outcome> =
            seeds(&args).map(|seed| outcome(&rig, &args, scenario, seed, 0.0)).collect();
        for &px in &args.px {
            let moved: Vec<Outcome> =
                seeds(&args).map(|seed| outcome(&rig, &args, scenario, seed, px)).collect();
            match args.kind {
                Kind::Two => line_of_two(scenario, px, &moved, &still),
                _ => line(scenario, px, &moved, &still),
            }
        }
    }
}

const HEAD: &str = "| scenario | picture moved by, px | detected after, s | included again after, s | \
    minimum coverage | tips, µm | undisturbed | bound | display error, µm | undisturbed | longest gap, fields | \
    eye, mrad | undisturbed |";
const HEAD_OF_TWO: &str = "| scenario | pictures moved by, px | disagreement reported | a camera excluded | \
    both named at the end | minimum coverage | tips, µm | largest | over 0.1 mm, % | of these *tracked*, % | undisturbed | bound | \
    display error, µm | undisturbed | eye, mrad | undisturbed |";

fn seeds(args: &Args) -> std::ops::Range<u64> {
    args.from..args.from + args.seeds
}

/// What became of a stream.
struct Outcome {
    score: Score,
    found_s: Option<f64>,
    back_s: Option<f64>,
    /// True if the cameras were reported to disagree, and if one of them was excluded.
    disagree: bool,
    excluded: bool,
    /// True if the end of `run` and `replay` names the two cameras that were moved, and no other cause.
    both_named: bool,
    /// Bounds of the tips where no camera was moved, µm.
    bounds_um: Vec<f64>,
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
    let from = if matches!(args.kind, Kind::Start | Kind::Two) { 0.1 } else { at_s.max(0.5) };
    let scored = [from, args.seconds - 0.2];
    let with_bound = px == 0.0 && !args.no_bound;
    let any = |wanted: fn(&Notice) -> bool| tracked.notices.iter().any(|(_, n)| wanted(n));
    Outcome {
        score: Score::of(&tracked, &stream, scored[0], scored[1]),
        found_s: at(&|n| matches!(n, Notice::Moved { .. })),
        back_s: at(&|n| matches!(n, Notice::TakenBack { .. })),
        disagree: any(|n| matches!(n, Notice::Disagree { .. })),
        excluded: any(|n| matches!(n, Notice::Moved { .. })),
        both_named: args.kind == Kind::Two && px > 0.0 && names_both(rig, &stream, &knocks),
        bounds_um: if with_bound { bound::of_measured_um(&stream, &tracked, scored) } else { vec![] },
    }
}

/// What `run` and `replay` say at their end.
fn names_both(rig: &Rig, stream: &Stream, knocks: &[Knock]) -> bool {
    let mut cameras = [knocks[0].camera, knocks[1].camera];
    cameras.sort_unstable();
    let judgement = judge_within(rig, &stream.fields, &Work::AT_END, |_, _| true);
    let [named] = &judgement.explanations[..] else { return false };
    judgement.verdict == Verdict::Explained && is_truth(&named.cause, &Cause::CamerasMoved { cameras })
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
    println!(
        "| {} | {px} | {} | {} | {:.4} | {:.1} | {:.1} | {} | {:.0} | {:.0} | {} | {:.2} | {:.2} |",
        scenario.name(),
        worst(&|o| o.found_s),
        worst(&|o| o.back_s),
        least_coverage(moved),
        all(moved, |s| &s.tips_um),
        all(still, |s| &s.tips_um),
        bound_of(still),
        all(moved, |s| &s.shown_um),
        all(still, |s| &s.shown_um),
        moved.iter().map(|o| o.score.longest_gap).max().unwrap_or(0),
        all(moved, |s| &s.eye_mrad),
        all(still, |s| &s.eye_mrad),
    );
}

fn line_of_two(scenario: Scenario, px: f64, moved: &[Outcome], still: &[Outcome]) {
    let streams = |of: fn(&Outcome) -> bool| moved.iter().filter(|o| of(o)).count();
    let tips: Vec<f64> = moved.iter().flat_map(|o| o.score.tips_um.iter().copied()).collect();
    let far_off = |tips: &[f64]| tips.iter().filter(|um| **um > FAR_OFF_UM).count();
    let far = far_off(&tips);
    let far_tracked: usize = moved.iter().map(|o| far_off(&o.score.tracked_um)).sum();
    println!(
        "| {} | {px} | {} | {} | {} | {:.4} | {:.1} | {:.0} | {:.2} | {:.0} | {:.1} | {} | {:.0} | {:.0} | {:.2} | {:.2} |",
        scenario.name(),
        streams(|o| o.disagree),
        streams(|o| o.excluded),
        streams(|o| o.both_named),
        least_coverage(moved),
        rms(&tips),
        tips.iter().copied().fold(0.0, f64::max),
        100.0 * far as f64 / tips.len().max(1) as f64,
        100.0 * far_tracked as f64 / far.max(1) as f64,
        all(still, |s| &s.tips_um),
        bound_of(still),
        all(moved, |s| &s.shown_um),
        all(still, |s| &s.shown_um),
        all(moved, |s| &s.eye_mrad),
        all(still, |s| &s.eye_mrad),
    );
}

fn least_coverage(outcomes: &[Outcome]) -> f64 {
    outcomes.iter().map(|o| o.score.coverage()).fold(1.0, f64::min)
}

/// Root mean square over all streams.
fn all(outcomes: &[Outcome], of: fn(&Score) -> &Vec<f64>) -> f64 {
    rms(&outcomes.iter().flat_map(|o| of(&o.score).iter().copied()).collect::<Vec<f64>>())
}

fn bound_of(still: &[Outcome]) -> String {
    let bounds: Vec<f64> = still.iter().flat_map(|o| o.bounds_um.iter().copied()).collect();
    if bounds.is_empty() { "–".into() } else { format!("{:.1}", rms(&bounds)) }
}
