//! Construct checks: a clean attempt made by hand brings all points; one fault changes one
//! category, by the amount that the table says. The attempt is a reach and a hold with a light pipe
//! beside it; events are injected where the simulation would publish them.

use super::table::{Category, Injury, KEPT_WHEN_FAILED, MACULA_MM, METRICS, PENALTIES};
use super::*;
use crate::sample::Sample;
use bytemuck::Zeroable;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use protocol::events::{Event, NO_INSTRUMENT};
use protocol::geometry::Pose;
use protocol::poses::TrackerFrame;
use scene::{Goal, SceneFile, TaskScene};
use surgeon::tremor::Tremor;

mod injuries;

const FIELDS: u64 = 500;
const PERIOD: u64 = 20_000_000;

/// A task of two holds and a path, so that every metric has something.
fn scorer() -> Scorer {
    let task = r#"
        [task]
        module = "m"
        level = 1
        title = "t"
        limit_s = 60.0
        par_s = 10.0
        par_mm = 24.0
        [[task.goals]]
        kind = "hold"
        instrument = 0
        at_in_eye_mm = [2.0, 0.0, -9.0]
        radius_mm = 0.5
        hold_s = 1.0
        [[task.goals]]
        kind = "follow"
        instrument = 0
        path_in_eye_mm = [[2.0, 0.0, -9.0], [-2.0, 0.0, -9.0]]
        radius_mm = 0.5
    "#;
    let bare = SceneFile { membrane: None, ..SceneFile::load("peel").unwrap() };
    let scene = SceneFile::parse(&format!("{}\n{task}", bare.to_toml()), "s").unwrap();
    Scorer::of(&scene).unwrap()
}

/// An attempt: the positions of the tips, and the events.
struct Attempt {
    tip: Box<dyn Fn(f64) -> [f64; 3]>,
    pipe: [f64; 3],
    /// How the light pipe moves about there.
    pipe_moves: Box<dyn Fn(f64) -> [f64; 3]>,
    events: Vec<(u64, Event)>,
    fields: u64,
    /// Variance of each coordinate of the tips, mm².
    variance_mm2: f64,
}

fn event(field: u64, kind: EventKind, value: f64) -> (u64, Event) {
    let event = Event {
        seq: field,
        field,
        exposed_ns: (field + 1) * PERIOD,
        kind: kind as u32,
        instrument: NO_INSTRUMENT,
        value,
        ..Event::zeroed()
    };
    (field, event)
}

fn by_tip(field: u64, kind: EventKind, value: f64, at: [f64; 3]) -> (u64, Event) {
    let (field, told) = event(field, kind, value);
    (field, Event { instrument: 0, position_in_eye_mm: at, ..told })
}

/// A slow sine of 6 mm a side: 24 mm in 10 s.
fn clean() -> Attempt {
    let goal = |subject, at| {
        let (field, told) = event(at, EventKind::GoalReached, 0.05);
        (field, Event { subject, ..told })
    };
    Attempt {
        tip: Box::new(|t| [6.0 * (0.1 * std::f64::consts::TAU * t).sin(), 0.0, -8.0]),
        pipe: [0.0, 0.0, 4.0],
        pipe_moves: Box::new(|_| [0.0; 3]),
        events: vec![
            event(0, EventKind::TaskStarted, 60.0),
            goal(0, 200),
            goal(1, 400),
            event(FIELDS - 1, EventKind::TaskFinished, 10.0),
        ],
        fields: FIELDS,
        variance_mm2: 0.0,
    }
}

fn score(attempt: &Attempt) -> Score {
    let scorer = scorer();
    let mut meter = scorer.start();
    for field in 0..attempt.fields {
        let mut frame = TrackerFrame::zeroed();
        frame.instants.exposed = (field + 1) * PERIOD;
        let t = field as f64 * 0.02;
        let moves = (attempt.pipe_moves)(t);
        let tips = [(attempt.tip)(t), std::array::from_fn(|c| attempt.pipe[c] + moves[c])];
        for (body, at) in frame.bodies.iter_mut().zip(tips.into_iter().chain([[0.0; 3]])) {
            // Handles up: +z of the instrument towards the microscope.
            let pose = Isometry3::from_parts(Vector3::from(at).into(), UnitQuaternion::identity());
            (body.world_from_body, body.validity) = (Pose::from_isometry(&pose), 2);
            [0, 6, 11].iter().for_each(|&k| body.covariance[k] = attempt.variance_mm2);
        }
        let told: Vec<Event> =
            attempt.events.iter().filter(|(at, _)| *at == field).map(|(_, e)| *e).collect();
        scorer.note(&mut meter, &Sample::new(&frame, &told));
    }
    scorer.score(&meter)
}

/// Points lost to a fault, by category.
fn lost(change: impl FnOnce(&mut Attempt)) -> [f64; CATEGORIES] {
    let mut attempt = clean();
    change(&mut attempt);
    attempt.events.sort_by_key(|(field, _)| *field);
    let (whole, hurt) = (score(&clean()), score(&attempt));
    std::array::from_fn(|c| whole.categories[c] - hurt.categories[c])
}

/// One category lost points, and nothing else changed.
fn only(category: Category, lost: [f64; CATEGORIES], what: &str) -> f64 {
    for (c, points) in lost.iter().enumerate() {
        let own = c == category as usize;
        assert!(own == (points.abs() > 0.02), "{what}: {lost:?}");
    }
    lost[category as usize]
}

#[test]
fn a_clean_attempt_brings_a_hundred() {
    let score = score(&clean());
    assert!(score.total > 99.5 && score.finished, "{score:?}");
    assert!((score.took_s - 9.98).abs() < 1e-9);
}

#[test]
fn goals_precision_and_the_path_are_target_achievement() {
    // Half of the goals: half of everything.
    let missing = lost(|a| a.events.retain(|(_, e)| e.subject != 1));
    let whole = score(&clean()).categories;
    for c in [Category::Target, Category::Instruments, Category::Microscope, Category::Tissue] {
        assert!((missing[c as usize] - 0.5 * whole[c as usize]).abs() < 1e-9, "{}: {missing:?}", c.name());
    }
    let far =
        lost(|a| a.events.iter_mut().for_each(|(_, e)| e.value = if e.kind == 111 { 0.4 } else { e.value }));
    assert!(only(Category::Target, far, "precision") > 3.0);
    let outside = lost(|a| {
        a.events.extend([event(200, EventKind::PathLeft, 0.1), event(250, EventKind::PathRegained, 1.0)])
    });
    assert!((only(Category::Target, outside, "path") - 5.0 * (1.0 / 9.98) / 0.2).abs() < 1e-9);
}

#[test]
fn time_and_way_are_efficiency() {
    let slow = lost(|a| {
        a.fields = 1000;
        a.tip = Box::new(|t| [6.0 * (0.05 * std::f64::consts::TAU * t).sin(), 0.0, -8.0]);
        a.events.retain(|(_, e)| e.kind != EventKind::TaskFinished as u32);
        a.events.push(event(999, EventKind::TaskFinished, 20.0));
    });
    assert!((only(Category::Efficiency, slow, "time") - 12.0 * (1.998 - 1.3) / 1.7).abs() < 1e-6);
    let winding = lost(|a| a.tip = Box::new(|t| [6.0 * (0.25 * std::f64::consts::TAU * t).sin(), 0.0, -8.0]));
    assert!(only(Category::Efficiency, winding, "way") > 2.0);
}

#[test]
fn tremor_speed_and_slips_are_instrument_handling() {
    let shaken = lost(|a| {
        let tremor = Tremor::new(100.0, 9.0, 5, 0);
        let still = std::mem::replace(&mut a.tip, Box::new(|_| [0.0; 3]));
        a.tip = Box::new(move |t| (Vector3::from(still(t)) + tremor.at(t)).into());
    });
    let points = only(Category::Instruments, shaken, "tremor");
    assert!((points - 6.0 * (100.0 - 30.0) / 90.0).abs() < 0.6, "{points}");
    let jerked = lost(|a| {
        let jerk = |t: f64| {
            if (5.0..5.4).contains(&t) {
                6.0 * (t - 5.0) / 0.4
            } else if t < 5.0 {
                0.0
            } else {
                6.0
            }
        };
        a.tip = Box::new(move |t| [6.0 * (0.05 * std::f64::consts::TAU * t).sin() - jerk(t), 0.0, -8.0]);
    });
    assert!(only(Category::Instruments, jerked, "speed") > 0.05);
    let near = lost(|a| {
        a.tip = Box::new(|t| {
            [6.0 * (0.1 * std::f64::consts::TAU * t).sin(), 0.0, -11.2 + if t < 5.0 { 3.2 } else { 0.0 }]
        })
    });
    assert!(near[2] > 0.0, "{near:?}");
    let slipped = lost(|a| a.events.push(by_tip(100, EventKind::GripSlipped, 500.0, [0.0, 0.0, -10.0])));
    assert!((only(Category::Instruments, slipped, "grip") - 1.0).abs() < 1e-9);
}

/// The hands at a task of one goal, in a scene with a light pipe in hand 1.
fn at_task(goal: Goal) -> [bool; 2] {
    let task = TaskScene { goals: vec![goal], ..scorer().task };
    let scene = SceneFile { task: Some(task), ..SceneFile::load("peel").unwrap() };
    Scorer::of(&scene).unwrap().at_task
}

#[test]
fn the_hands_at_the_task_are_those_that_its_goals_ask_for() {
    let hold =
        |instrument| Goal::Hold { instrument, at_in_eye_mm: [0.0, 0.0, -8.0], radius_mm: 1.0, hold_s: 1.0 };
    let places = [[1.0, 0.0, -8.0], [-1.0, 0.0, -8.0]];
    let align = Goal::Align { at_in_eye_mm: places, radius_mm: 1.0, hold_s: 1.0 };
    let peel = Goal::Event {
        event: EventKind::MembraneOff,
        what: "peel".into(),
        at_least: 0.0,
        count: 1,
        early: false,
    };
    assert_eq!(at_task(hold(0)), [true, false]);
    assert_eq!(at_task(hold(1)), [false, true], "the light pipe is to be led");
    assert_eq!(at_task(align), [true, true]);
    assert_eq!(at_task(peel), [true, false], "hand 1 only lights");
}

#[test]
fn the_tremor_of_a_hand_that_only_lights_is_not_judged() {
    let tremor = |score: &Score| score.metrics[Id::Tremor as usize].value.unwrap();
    let shaken = |um: f64| {
        let mut attempt = clean();
        let tremor = Tremor::new(um, 9.0, 5, 1);
        attempt.pipe_moves = Box::new(move |t| tremor.at(t).into());
        score(&attempt)
    };
    let (still, trembling) = (shaken(0.0), shaken(200.0));
    assert!(tremor(&still) < 5.0);
    assert_eq!(tremor(&still).to_bits(), tremor(&trembling).to_bits());
}

#[test]
fn view_and_light_are_microscope_handling_and_the_light_dose_is_tissue_treatment() {
    let at = [6.0, 0.0, -8.0];
    let blind = lost(|a| {
        a.events.extend([
            by_tip(100, EventKind::TipOutOfView, 0.1, at),
            by_tip(200, EventKind::TipInView, 2.0, at),
        ]);
    });
    assert!((only(Category::Microscope, blind, "view") - 6.0 * (2.0 / 9.98 - 0.02) / 0.28).abs() < 1e-6);
    let dark = lost(|a| a.tip = Box::new(|t| [6.0 * (0.1 * std::f64::consts::TAU * t).sin(), 0.0, -3.0]));
    assert!(only(Category::Microscope, dark, "light") > 1.0);
    let close = lost(|a| a.pipe = [0.0, 0.0, -10.8]);
    // So near the retina it cannot light a tip that works higher: that is the microscope's loss,
    // and its own.
    assert!(close[Category::Tissue as usize] > 0.5, "{close:?}");
    assert!((close[0], close[1], close[2]) == (0.0, 0.0, 0.0));
}

#[test]
fn who_does_nothing_gets_nothing() {
    let mut idle = clean();
    idle.tip = Box::new(|_| [0.0, 0.0, -8.0]);
    idle.events =
        vec![event(0, EventKind::TaskStarted, 60.0), event(FIELDS - 1, EventKind::TaskTimedOut, 2.0)];
    let score = score(&idle);
    assert_eq!((score.total, score.categories), (0.0, [0.0; CATEGORIES]));
    assert!(score.took_s > 9.0 && !score.finished && score.failed.is_none());
}

#[test]
fn what_is_below_tracking_noise_does_not_count_but_is_doubted() {
    let touch = |variance: f64| {
        let mut attempt = clean();
        attempt.variance_mm2 = variance;
        attempt.events.push(by_tip(100, EventKind::RetinaTouched, 0.04, [6.0, 0.0, -9.81]));
        attempt.events.sort_by_key(|(field, _)| *field);
        score(&attempt)
    };
    let (sure, doubtful) = (touch(1e-6), touch(1e-4));
    assert_eq!(
        (sure.injuries[Injury::Contact as usize], doubtful.injuries[Injury::Contact as usize]),
        (1, 0)
    );
    assert!(doubtful.sigma > 1.0 && doubtful.sigma > 10.0 * sure.sigma, "{} {}", doubtful.sigma, sure.sigma);
    // White noise as large as its covariance says is no tremor.
    let mut noisy = clean();
    let mut random = protocol::random::Random::new(3, 0);
    let noise: Vec<[f64; 3]> = (0..FIELDS).map(|_| (random.vector() * 0.05).into()).collect();
    let still = std::mem::replace(&mut noisy.tip, Box::new(|_| [0.0; 3]));
    noisy.tip = Box::new(move |t| {
        (Vector3::from(still(t)) + Vector3::from(noise[(t * 50.0).round() as usize])).into()
    });
    let tremor = |s: &Score| s.metrics[Id::Tremor as usize].value.unwrap();
    let blamed = tremor(&score(&noisy));
    noisy.variance_mm2 = 0.0025;
    let judged = score(&noisy);
    assert!(
        blamed > 35.0 && tremor(&judged) < 20.0,
        "{blamed} µm without covariance, {} with",
        tremor(&judged)
    );
}

#[test]
fn an_attempt_that_is_broken_off_is_scored_as_it_stands() {
    let mut attempt = clean();
    attempt.fields = 250;
    let score = score(&attempt);
    assert!(!score.finished && score.total > 20.0 && score.total < 50.0, "{}", score.total);
    assert_eq!(score.metrics[Id::Time as usize].points, 0.0, "unfinished");
    assert_eq!(METRICS[Id::Time as usize].key, score.metrics[Id::Time as usize].key);
}

/// One fault for each metric, of such a kind that no other category has a reason to fall. A metric
/// without a case does not compile.
fn fault(id: Id, a: &mut Attempt) {
    let sine = |mm: f64, hz: f64| move |t: f64| mm * (hz * std::f64::consts::TAU * t).sin();
    match id {
        Id::Goals => unreachable!("scales all others"),
        Id::Precision => {
            let goals = a.events.iter_mut().filter(|(_, e)| e.kind == EventKind::GoalReached as u32);
            goals.for_each(|(_, e)| e.value = 0.4);
        }
        Id::OffPath => {
            a.events.extend([event(200, EventKind::PathLeft, 0.1), event(250, EventKind::PathRegained, 1.0)]);
        }
        Id::Time => {
            a.fields = 1000;
            a.tip = Box::new(move |t| [sine(6.0, 0.05)(t), 0.0, -8.0]);
            a.events.retain(|(_, e)| e.kind != EventKind::TaskFinished as u32);
            a.events.push(event(999, EventKind::TaskFinished, 20.0));
        }
        Id::Way => a.tip = Box::new(move |t| [sine(6.0, 0.25)(t), 0.0, -8.0]),
        Id::Tremor => {
            let tremor = Tremor::new(100.0, 9.0, 5, 0);
            a.tip = Box::new(move |t| (Vector3::new(sine(6.0, 0.1)(t), 0.0, -8.0) + tremor.at(t)).into());
        }
        Id::Speed => {
            let jerk = |t: f64| 6.0 * ((t - 5.0) / 0.3).clamp(0.0, 1.0);
            a.tip = Box::new(move |t| [sine(3.0, 0.05)(t) - jerk(t), 0.0, -8.0]);
        }
        Id::SpeedNearRetina => {
            let hurry = move |t: f64| if (4.0..6.0).contains(&t) { sine(1.6, 1.5)(t - 4.0) } else { 0.0 };
            a.tip = Box::new(move |t| [hurry(t), 0.0, -10.9]);
        }
        Id::Grip => a.events.push(by_tip(100, EventKind::GripSlipped, 500.0, [0.0, 0.0, -10.0])),
        Id::OutOfView => a.events.extend([
            by_tip(100, EventKind::TipOutOfView, 0.1, [6.0, 0.0, -8.0]),
            by_tip(200, EventKind::TipInView, 2.0, [6.0, 0.0, -8.0]),
        ]),
        Id::Unlit => a.tip = Box::new(move |t| [sine(6.0, 0.1)(t), 0.0, -3.0]),
        Id::LightDose => {
            // The tip stays in the light, between the pipe and the retina.
            a.pipe = [0.0, 0.0, -10.7];
            a.tip = Box::new(|_| [0.0, 0.0, -11.0]);
        }
        Id::Injuries => {
            a.events.push(by_tip(100, EventKind::RetinaTouched, 0.04, [6.0, 0.0, -9.81]));
            a.events.push(by_tip(110, EventKind::RetinaLeft, 0.2, [6.0, 0.0, -9.81]));
        }
    }
}

#[test]
fn one_fault_lowers_one_metric_and_one_category() {
    const ALL: [Id; COUNT] = [
        Id::Goals,
        Id::Precision,
        Id::OffPath,
        Id::Time,
        Id::Way,
        Id::Tremor,
        Id::Speed,
        Id::SpeedNearRetina,
        Id::Grip,
        Id::OutOfView,
        Id::Unlit,
        Id::LightDose,
        Id::Injuries,
    ];
    let whole = score(&clean());
    for (i, id) in ALL.into_iter().enumerate() {
        assert_eq!(id as usize, i, "every metric once");
        if id == Id::Goals {
            // By its share every other metric is scaled: see the test of goals.
            continue;
        }
        let mut attempt = clean();
        fault(id, &mut attempt);
        attempt.events.sort_by_key(|(field, _)| *field);
        let hurt = score(&attempt);
        let (name, category) = (METRICS[i].name, METRICS[i].category);
        for (j, (before, after)) in whole.metrics.iter().zip(&hurt.metrics).enumerate() {
            let lost = before.points - after.points;
            assert!(
                if j == i { lost > 0.02 } else { lost.abs() < 0.02 },
                "{name}: {} lost {lost}",
                METRICS[j].name
            );
        }
        for other in Category::ALL {
            let lost = whole.categories[other as usize] - hurt.categories[other as usize];
            assert!((other == category) == (lost.abs() > 0.02), "{name}: {} lost {lost}", other.name());
        }
    }
}
