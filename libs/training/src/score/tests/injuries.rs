//! Injuries: what counts as one, and what each costs.

use super::*;

/// What is done to the tissue, the share of the points that is kept, and the events with their steps.
type Harm = (&'static str, f64, Vec<(u64, Event)>);

/// A stab into the macula at a field, and out again.
fn stab(field: u64) -> [(u64, Event); 3] {
    let macula = [0.5, 0.0, -11.49];
    [
        by_tip(field, EventKind::RetinaTouched, 0.04, macula),
        by_tip(field + 1, EventKind::RetinaPenetrated, 0.2, macula),
        by_tip(field + 5, EventKind::RetinaLeft, 0.1, macula),
    ]
}

#[test]
fn each_injury_takes_the_share_that_the_table_says_and_nothing_else() {
    let kept = |i: Injury| {
        let p = PENALTIES[i as usize];
        (1.0 - p.share) * if p.serious { KEPT_WHEN_FAILED } else { 1.0 }
    };
    let away = [6.0, 0.0, -9.81];
    let cases: [Harm; 7] = [
        ("lens", kept(Injury::Lens), vec![by_tip(100, EventKind::LensTouched, 0.2, [0.0, 0.0, 5.0])]),
        ("contact", kept(Injury::Contact), vec![by_tip(100, EventKind::RetinaTouched, 0.04, away)]),
        (
            "haemorrhage",
            kept(Injury::Haemorrhage),
            vec![
                by_tip(100, EventKind::RetinaTouched, 0.04, away),
                by_tip(101, EventKind::RetinaPenetrated, 0.1, away),
            ],
        ),
        ("macula", kept(Injury::Macula), stab(100).to_vec()),
        (
            "tear",
            kept(Injury::Tear),
            vec![event(100, EventKind::RetinaRipped, 3.0), event(110, EventKind::RetinaRipped, 3.0)],
        ),
        (
            "two tears",
            kept(Injury::Tear) * (1.0 - PENALTIES[Injury::Tear as usize].share),
            vec![event(100, EventKind::RetinaTorn, 3.0), event(200, EventKind::RetinaCut, 3.0)],
        ),
        ("pull", kept(Injury::Pull), vec![event(100, EventKind::RetinaPulled, 9e3)]),
    ];
    let whole = score(&clean()).total;
    for (what, kept, events) in cases {
        let lost = lost(|a| a.events.extend(events));
        let expected = whole * (1.0 - kept);
        assert!((only(Category::Tissue, lost, what) - expected).abs() < 1e-9, "{what}: {lost:?}");
    }
    const { assert!(MACULA_MM < 6.0) };
}

#[test]
fn a_serious_injury_fails_the_attempt_and_each_further_one_costs() {
    let stabbed = |times: u64| {
        let mut attempt = clean();
        attempt.events.extend((0..times).flat_map(|k| stab(60 + 60 * k)));
        attempt.events.sort_by_key(|(field, _)| *field);
        score(&attempt)
    };
    let scores: Vec<Score> = (0..8).map(stabbed).collect();
    assert_eq!(scores[7].injuries[Injury::Macula as usize], 7);
    assert_eq!((scores[0].failed, scores[7].failed), (None, Some("macular haemorrhage")));
    assert!(scores[1].finished && scores[1].total < 100.0 * KEPT_WHEN_FAILED);
    for (fewer, more) in scores.iter().zip(&scores[1..]) {
        assert!(more.total < 0.85 * fewer.total && more.total > 0.0, "{} {}", fewer.total, more.total);
    }
    for score in &scores {
        assert!((score.categories.iter().sum::<f64>() - score.total).abs() < 1e-9);
    }
}

#[test]
fn the_retina_in_jaws_and_under_a_needle_is_work_and_trembling_at_a_place_is_one_contact() {
    let away = [6.0, 0.0, -9.81];
    let touch = |field| {
        [
            by_tip(field, EventKind::RetinaTouched, 0.04, away),
            by_tip(field + 4, EventKind::RetinaLeft, 0.1, away),
        ]
    };
    let contacts = |events: Vec<(u64, Event)>| {
        let mut attempt = clean();
        attempt.events.extend(events);
        attempt.events.sort_by_key(|(field, _)| *field);
        score(&attempt).injuries[Injury::Contact as usize]
    };
    assert_eq!(contacts(touch(100).to_vec()), 1);
    let trembling: Vec<_> = (0..5).flat_map(|k| touch(100 + 8 * k)).collect();
    assert_eq!(contacts(trembling), 1, "0.8 s of it");
    assert_eq!(contacts([touch(100), touch(200)].concat()), 2);
    let dragged = |k: u64| {
        let mut again = touch(100 + 8 * k);
        again.iter_mut().for_each(|(_, e)| e.position_in_eye_mm[1] += 0.6 * k as f64);
        again
    };
    assert_eq!(contacts((0..5).flat_map(dragged).collect()), 5, "five places in 0.8 s");
    let steady: Vec<_> = (0..20).flat_map(|k| touch(100 + 10 * k)).collect();
    assert_eq!(contacts(steady), 1, "4 s without a second of rest");
    let stabbed = [touch(100).to_vec(), vec![by_tip(106, EventKind::RetinaPenetrated, 0.1, away)]].concat();
    let mut attempt = clean();
    attempt.events.extend(stabbed);
    attempt.events.sort_by_key(|(field, _)| *field);
    let told = score(&attempt).injuries;
    assert_eq!((told[Injury::Contact as usize], told[Injury::Haemorrhage as usize]), (1, 1), "it went in");
    let grab = |field, kind| by_tip(field, kind, 5.0, away);
    let held = vec![grab(102, EventKind::TissueGrabbed), grab(300, EventKind::TissueReleased)];
    assert_eq!(contacts([touch(100).to_vec(), held.clone()].concat()), 0, "the touch that takes hold");
    assert_eq!(contacts([held.clone(), touch(200).to_vec()].concat()), 0, "what is in the jaws");
    assert_eq!(contacts([held, touch(350).to_vec()].concat()), 1, "after it was let go");
    let pressed = |depth: f64, scene: &str| {
        let scene =
            SceneFile { task: Some(scorer().task), membrane: None, ..SceneFile::load(scene).unwrap() };
        let mut meter = Meter::default();
        let scorer = Scorer::of(&scene).unwrap();
        let held = [
            event(0, EventKind::TaskStarted, 60.0),
            grab(102, EventKind::TissueGrabbed),
            by_tip(200, EventKind::RetinaPenetrated, depth, away),
            by_tip(210, EventKind::RetinaLeft, 0.1, away),
        ];
        for field in 0..300 {
            let mut frame = TrackerFrame::zeroed();
            frame.instants.exposed = (field + 1) * PERIOD;
            for (body, z) in frame.bodies.iter_mut().zip([-9.81, 4.0, 0.0]) {
                let pose = Isometry3::translation(0.0, 0.0, z);
                (body.world_from_body, body.validity) = (Pose::from_isometry(&pose), 2);
            }
            let told: Vec<Event> = held.iter().filter(|(at, _)| *at == field).map(|(_, e)| *e).collect();
            scorer.note(&mut meter, &Sample::new(&frame, &told));
        }
        scorer.score(&meter).injuries[Injury::Haemorrhage as usize]
    };
    assert_eq!((pressed(0.08, "relocation"), pressed(0.15, "relocation")), (0, 1), "pressed on, and through");
    assert_eq!(pressed(0.08, "peel"), 1, "under a membrane nothing is to be pressed");
    let pierced = vec![grab(102, EventKind::RetinaPierced), grab(300, EventKind::BlebFilled)];
    assert_eq!(contacts([touch(100).to_vec(), pierced, touch(290).to_vec()].concat()), 0);
}
