//! Tests of the state machine, on observations made by hand.

use super::*;
use nalgebra::Matrix3;
use scene::Goal;

const NS: u64 = 20_000_000;

fn task(order: GoalOrder, goals: Vec<Goal>) -> Task {
    let scene = TaskScene {
        module: "m".into(),
        level: 1,
        title: "t".into(),
        limit_s: 4.0,
        par_s: 2.0,
        par_mm: 4.0,
        order,
        instructions: Vec::new(),
        goals,
    };
    Task { scene, radius_mm: 11.5, lens_back_mm: 6.5, axes: Vec::new() }
}

fn hold(x: f64) -> Goal {
    Goal::Hold { instrument: 0, at_in_eye_mm: [x, 0.0, -6.0], radius_mm: 0.5, hold_s: 0.2 }
}

/// Plays tips of instrument 0 from field 1 on, one a field; returns what was said.
fn play(
    task: &Task,
    tips: impl IntoIterator<Item = [f64; 3]>,
    events: &[(u64, Event)],
) -> (TaskState, Vec<EventDraft>) {
    let (mut state, mut said) = (task.start(), Vec::new());
    for (field, tip) in tips.into_iter().enumerate() {
        let tip =
            Tip { tip_in_eye_mm: tip.into(), to_handle: Vector3::x(), covariance_mm2: Matrix3::zeros() };
        let now: Vec<Event> = events.iter().filter(|(at, _)| *at == field as u64).map(|(_, e)| *e).collect();
        let seen = Observation {
            now_ns: (field as u64 + 1) * NS,
            tips: [Some(tip), None],
            tools: [Tool::Pick as u32, Tool::LightPipe as u32],
            in_retina: [false; INSTRUMENTS],
            pressed: false,
            bodies: &[],
            gel_ml: (field == 9).then_some([0.2, 0.1]),
            retina: Some(RetinaObservation { turned_rad: -0.3, loose_share: 1.0 - 0.05 * field as f64 }),
            world_from_eye: Isometry3::identity(),
            microscope_target_mm: [0.0, 0.0, -11.0],
            field_mm: 16.0,
            events: &now,
        };
        // Who has not moved does not work yet: these tips come from elsewhere.
        if field == 0 {
            state.rest_mm[0] = Some(Vector3::new(0.0, 3.0, 0.0));
        }
        task.advance(&mut state, &seen, &mut |s| said.push(s));
    }
    (state, said)
}

#[test]
fn the_clock_starts_with_the_first_movement_or_the_pedal() {
    let task = task(GoalOrder::Any, vec![hold(1.0)]);
    let begin = |tip: &dyn Fn(u64) -> f64, pressed: bool| {
        let (mut state, mut said) = (task.start(), Vec::new());
        for field in 0..300u64 {
            let at = Vector3::new(tip(field), 0.0, -3.0);
            let tip = Tip { tip_in_eye_mm: at, to_handle: Vector3::x(), covariance_mm2: Matrix3::zeros() };
            let seen = Observation { pressed: pressed && field >= 100, ..still(tip, field + 1) };
            task.advance(&mut state, &seen, &mut |s| said.push((field, s.kind)));
        }
        said.iter().find(|(_, kind)| *kind == EventKind::TaskStarted).map(|(field, _)| *field)
    };
    let trembling = |field: u64| if field.is_multiple_of(2) { 0.15 } else { -0.15 };
    assert_eq!(begin(&trembling, false), None, "a hand that rests");
    assert_eq!(begin(&trembling, true), Some(100));
    let moved = begin(&|field| 0.02 * field.saturating_sub(100) as f64, false).unwrap();
    assert!((126..140).contains(&moved), "half a millimetre, smoothed: field {moved}");
}

/// A step at which nothing happens but that a tip is somewhere.
fn still(tip: Tip, number: u64) -> Observation<'static> {
    Observation {
        now_ns: number * NS,
        tips: [Some(tip), None],
        tools: [Tool::Pick as u32, Tool::LightPipe as u32],
        in_retina: [false; INSTRUMENTS],
        pressed: false,
        bodies: &[],
        gel_ml: None,
        retina: None,
        world_from_eye: Isometry3::identity(),
        microscope_target_mm: [0.0, 0.0, -11.0],
        field_mm: 16.0,
        events: &[],
    }
}

#[test]
fn an_event_counts_once_the_tip_is_out_of_the_retina() {
    let goal = Goal::Event {
        event: EventKind::TissueHooked,
        what: "edge".into(),
        at_least: 0.0,
        count: 1,
        early: false,
    };
    let task = task(GoalOrder::Any, vec![goal]);
    let reached = |tool: Tool| {
        let (mut state, mut at) = (task.start(), None);
        state.rest_mm[0] = Some(Vector3::new(0.0, 3.0, 0.0));
        let mut event: Event = bytemuck::Zeroable::zeroed();
        event.kind = EventKind::TissueHooked as u32;
        for field in 0..20u64 {
            let place = Vector3::new(1.0, 0.0, -11.0);
            let tip = Tip { tip_in_eye_mm: place, to_handle: Vector3::x(), covariance_mm2: Matrix3::zeros() };
            let events = if field == 5 { std::slice::from_ref(&event) } else { &[] };
            let in_retina = [(4..12).contains(&field), false];
            let tools = [tool as u32, Tool::LightPipe as u32];
            let seen = Observation { in_retina, tools, events, ..still(tip, field + 1) };
            task.advance(&mut state, &seen, &mut |s| {
                if s.kind == EventKind::GoalReached {
                    at = Some(field);
                }
            });
        }
        at
    };
    assert_eq!((reached(Tool::Pick), reached(Tool::Needle)), (Some(12), Some(5)));
}

/// Kinds of events but those of goals that are done in part.
fn kinds(said: &[EventDraft]) -> Vec<EventKind> {
    said.iter().map(|s| s.kind).filter(|kind| *kind != EventKind::GoalProgress).collect()
}

#[test]
fn the_most_of_a_goal_is_told_in_tenths_and_once() {
    // A hold of 0.2 s, left after 0.1 s, and again after 0.16 s.
    let x = |field: usize| if matches!(field, 1..=6 | 10..=18) { 1.0 } else { 3.0 };
    let tips = (0..30).map(|field| [x(field), 0.0, -6.0]);
    let (state, said) = play(&task(GoalOrder::Any, vec![hold(1.0)]), tips, &[]);
    let shares: Vec<f64> =
        said.iter().filter(|s| s.kind == EventKind::GoalProgress).map(|s| s.value).collect();
    assert_eq!((shares, state.reached()), (vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8], 0));
}

#[test]
fn goals_count_in_their_order_and_the_task_ends_with_the_last() {
    use EventKind::{GoalReached, TaskFinished, TaskStarted};
    let task = task(GoalOrder::Sequence, vec![hold(1.0), hold(3.0)]);
    let at = |x: f64, fields: usize| std::iter::repeat_n([x, 0.0, -6.0], fields);
    let (state, said) = play(&task, at(3.0, 20).chain(at(1.1, 15)).chain(at(3.0, 15)), &[]);
    assert_eq!(kinds(&said), [TaskStarted, GoalReached, GoalReached, TaskFinished]);
    let of = |kind| said.iter().filter(move |s| s.kind == kind);
    let reached: Vec<u32> = of(GoalReached).map(|s| s.subject).collect();
    assert_eq!((reached, state.phase), (vec![0, 1], Phase::Finished));
    let took_s = of(TaskFinished).next().unwrap().value;
    assert!((took_s - 0.02 * (35.0 + 10.0)).abs() < 1e-9, "{took_s}");
}

#[test]
fn the_mean_distance_is_told_with_the_goal() {
    let (_, said) =
        play(&task(GoalOrder::Any, vec![hold(1.0)]), std::iter::repeat_n([1.0, 0.1, -6.0], 20), &[]);
    let reached = said.iter().find(|s| s.kind == EventKind::GoalReached).unwrap();
    assert!((reached.value - 0.1).abs() < 1e-12, "{}", reached.value);
}

#[test]
fn open_goals_count_in_any_order_where_the_task_says_so() {
    let task = task(GoalOrder::Any, vec![hold(1.0), hold(3.0)]);
    let (_, said) = play(&task, std::iter::repeat_n([3.0, 0.0, -6.0], 30), &[]);
    let reached: Vec<u32> =
        said.iter().filter(|s| s.kind == EventKind::GoalReached).map(|s| s.subject).collect();
    assert_eq!(reached, [1]);
}

#[test]
fn leaving_begins_the_hold_again_and_time_runs_out() {
    let task = task(GoalOrder::Any, vec![hold(1.0)]);
    let jumping = (0..260).map(|k| [if k % 8 == 0 { 2.0 } else { 1.0 }, 0.0, -6.0]);
    let (state, said) = play(&task, jumping, &[]);
    assert_eq!(kinds(&said), [EventKind::TaskStarted, EventKind::TaskTimedOut]);
    assert_eq!((said.last().unwrap().value, state.phase), (1.0, Phase::TimedOut));
}

#[test]
fn near_the_retina_is_reached_in_its_band_only() {
    let near = |low, high| Goal::Near {
        instrument: 0,
        towards_in_eye: [0.0, 0.0, -2.0],
        radius_mm: 0.4,
        clearance_mm: [low, high],
        hold_s: 0.2,
    };
    let reached = |goal, z| play(&task(GoalOrder::Any, vec![goal]), vec![[0.1, 0.0, z]; 20], &[]).0.reached();
    assert_eq!(reached(near(0.2, 0.8), -11.0), 1);
    assert_eq!(reached(near(0.2, 0.4), -11.0), 0, "too high");
    assert_eq!(reached(near(0.6, 0.9), -11.0), 0, "too low");
}

#[test]
fn a_path_is_followed_and_leaving_it_is_told_with_its_time() {
    use EventKind::{GoalReached, PathLeft, PathRegained, TaskFinished, TaskStarted};
    let path = vec![[0.0, 0.0, -6.0], [3.0, 0.0, -6.0]];
    let task =
        task(GoalOrder::Any, vec![Goal::Follow { instrument: 0, path_in_eye_mm: path, radius_mm: 0.3 }]);
    let way = (0..130).map(|k| [f64::from(k) * 0.025, if (40..50).contains(&k) { 0.5 } else { 0.0 }, -6.0]);
    let (_, said) = play(&task, way, &[]);
    assert_eq!(kinds(&said), [TaskStarted, PathLeft, PathRegained, GoalReached, TaskFinished]);
    let value = |kind| said.iter().find(|s| s.kind == kind).unwrap().value;
    assert!((value(PathLeft) - 0.2).abs() < 1e-9 && (value(PathRegained) - 0.2).abs() < 1e-9);
}

#[test]
fn events_are_counted_from_their_figure_on() {
    let mut event: Event = bytemuck::Zeroable::zeroed();
    (event.kind, event.value) = (EventKind::MembranePeeled as u32, 3.0);
    let goal = |at_least, count| Goal::Event {
        event: EventKind::MembranePeeled,
        what: "off".into(),
        at_least,
        count,
        early: false,
    };
    let told = [(3, event), (9, event)];
    let reached =
        |goal| play(&task(GoalOrder::Any, vec![goal]), vec![[0.0, 0.0, -6.0]; 20], &told).0.reached();
    assert_eq!([goal(2.0, 2), goal(2.0, 3), goal(4.0, 1)].map(reached), [1, 0, 0]);
}

#[test]
fn one_event_reaches_one_goal_of_a_sequence() {
    let mut event: Event = bytemuck::Zeroable::zeroed();
    (event.kind, event.value) = (EventKind::BlebFilled as u32, 20.0);
    let goal = || Goal::Event {
        event: EventKind::BlebFilled,
        what: "bleb".into(),
        at_least: 10.0,
        count: 1,
        early: false,
    };
    let reached = |told: &[(u64, Event)]| {
        let task = task(GoalOrder::Sequence, vec![goal(), goal()]);
        play(&task, vec![[0.0, 0.0, -6.0]; 20], told).0.reached()
    };
    assert_eq!((reached(&[(3, event)]), reached(&[(3, event), (9, event)])), (1, 2));
}

#[test]
fn what_may_come_early_counts_when_its_turn_comes() {
    let goal = |event, early| Goal::Event { event, what: "e".into(), at_least: 0.0, count: 1, early };
    let told = |kind: EventKind| {
        let mut event: Event = bytemuck::Zeroable::zeroed();
        event.kind = kind as u32;
        event
    };
    let events = [(3, told(EventKind::BlebsMerged)), (9, told(EventKind::BlebFilled))];
    let reached = |early| {
        let goals = vec![goal(EventKind::BlebFilled, false), goal(EventKind::BlebsMerged, early)];
        play(&task(GoalOrder::Sequence, goals), vec![[0.0, 0.0, -6.0]; 20], &events).0.reached()
    };
    assert_eq!((reached(true), reached(false)), (2, 1));
}

#[test]
fn gel_counts_by_its_zone_and_the_retina_by_turn_and_hold() {
    use scene::GelZone::{Core, Periphery};
    let reached = |goal| play(&task(GoalOrder::Any, vec![goal]), vec![[0.0, 0.0, -6.0]; 20], &[]).0.reached();
    let gel = |zone, removed_ml| Goal::Gel { what: "g".into(), zone, removed_ml };
    assert_eq!(
        [gel(Core, 0.2), gel(Core, 0.3), gel(Periphery, 0.1), gel(Periphery, 0.2)].map(reached),
        [1, 0, 1, 0]
    );
    // By the last of 20 fields 5 % are loose; a quarter or less since the fifth before it.
    let retina =
        |turned_rad, loose_share, hold_s| Goal::Retina { what: "r".into(), turned_rad, loose_share, hold_s };
    let goals =
        [retina(0.3, 0.26, 0.08), retina(0.4, 0.26, 0.08), retina(0.3, 0.04, 0.0), retina(0.3, 0.26, 0.1)];
    assert_eq!(goals.map(reached), [1, 0, 0, 0]);
}

#[test]
fn leaving_the_picture_and_touching_the_lens_are_told_once_each() {
    use EventKind::{LensLeft, LensTouched, TaskStarted, TipInView, TipOutOfView};
    let task = task(GoalOrder::Any, vec![hold(1.0)]);
    let aside = vec![[8.1, 0.0, -6.0]; 10];
    let (_, said) = play(&task, [vec![[0.0, 6.0, -6.0]; 3], aside, vec![[0.0, 6.0, -6.0]; 3]].concat(), &[]);
    assert_eq!(kinds(&said), [TaskStarted, TipOutOfView, TipInView]);
    assert!((said[2].value - 0.2).abs() < 1e-9);
    let (_, said) = play(&task, [vec![[0.0, 1.0, 7.5]; 5], vec![[0.0, 6.0, -6.0]; 5]].concat(), &[]);
    assert_eq!(kinds(&said), [TaskStarted, LensTouched, LensLeft]);
}

#[test]
fn no_clock_of_an_attempt_runs_while_everything_stands_still() {
    let task = task(GoalOrder::Any, vec![hold(1.0)]);
    // In the ball from the third field on; after 0.1 s there a pause of a minute.
    let mut state = task.start();
    state.rest_mm[0] = Some(Vector3::new(0.0, 3.0, 0.0));
    let mut said = Vec::new();
    for field in 1..40u64 {
        let x = if field < 3 { 3.0 } else { 1.0 };
        let tip = Tip {
            tip_in_eye_mm: Vector3::new(x, 0.0, -6.0),
            to_handle: Vector3::x(),
            covariance_mm2: Matrix3::zeros(),
        };
        let paused_ns = if field > 8 { 60_000_000_000 } else { 0 };
        let seen = Observation { now_ns: field * NS + paused_ns, ..still(tip, field) };
        task.advance(&mut state, &seen, &mut |s| said.push((field, s)));
    }
    let end = said.last().unwrap();
    assert_eq!(
        (end.1.kind, state.phase),
        (EventKind::TaskFinished, Phase::Finished),
        "the limit of 4 s is not over"
    );
    // A hold of 0.2 s that began at field 3 ends at field 13; the field after the pause counts for
    // none.
    assert_eq!(end.0, 14);
    assert!((end.1.value - 0.02 * 12.0).abs() < 1e-9, "{}", end.1.value);
}
