//! Tests of the report.

use super::*;
use bytemuck::Zeroable;
use protocol::budget::{Budgets, Stage};

fn latencies() -> LatencyStats {
    let mut latencies = LatencyStats::default();
    latencies.warm_from(1);
    let profile = StepProfile {
        collision_ns: 50_000,
        tissue_ns: 150_000,
        vitreous_ns: 50_000,
        transfer_ns: 30_000,
        misc_ns: 15_000,
        hash_ns: 5_000,
        ..StepProfile::default()
    };
    let mut step = StepRecord { profile, ..StepRecord::zeroed() };
    (step.instants.exposed, step.instants.tracked, step.instants.stepped) = (10, 20, 320_000);
    latencies.note_step(&step);
    latencies
}

pub(crate) fn report() -> Report {
    let latencies = latencies();
    Report {
        tracking: TrackingFigures::default(),
        least_tracked: ("eye", 1.0),
        warnings: Vec::new(),
        silences: Vec::new(),
        blob_stream: None,
        format: FORMAT,
        budgets_kept: true,
        ended_by: "duration".into(),
        duration_s: 1.0,
        setup: Setup {
            instance: "main".into(),
            scene: "peel".into(),
            rig: "r".into(),
            seed: 1,
            source: "script".into(),
            colours: "shipped".into(),
            view: "none",
            realtime: false,
            injected_delays_ms: BTreeMap::new(),
        },
        machine: Machine::detect(),
        versions: Versions::of_this_build(),
        stages: latencies.judge(&Budgets::default()),
        load: None,
        warm_up_left_out: 0,
        paper_table_4: paper_table_4(&latencies),
        step_profile: step_profile(&latencies),
        picture: None,
        processes: Vec::new(),
        restarts: BTreeMap::from([("tracker", 2)]),
        incidents: vec![Incident { at_s: 3.0, what: "tracker restarted".into() }],
        unfinished: Vec::new(),
        lost: BTreeMap::new(),
        overwritten: 0,
        frames_withheld: 0,
        states_lost: 0,
        received: BTreeMap::new(),
        events: BTreeMap::new(),
        removed: Some(Removed { vitreous_ml: 0.5, vitreous_left_ml: 3.25, ..Removed::default() }),
        recording: None,
        cameras: Vec::new(),
        controls: Vec::new(),
    }
}

#[test]
fn tables_name_every_stage_and_incident() {
    let text = report().text();
    for stage in Stage::ALL {
        assert!(text.contains(stage.name()) && text.contains(stage.span()), "{text}");
    }
    let unmeasured = text.lines().find(|line| line.starts_with("whole-system")).expect("a line");
    assert!(unmeasured.contains('–') && !unmeasured.contains("0.00"), "{unmeasured}");
    assert!(text.contains("tracker restarted") && text.contains("tissue simulation"), "{text}");
    assert!(text.contains("removed: vitreous 0.50 ml (3.25 ml left)\n"), "{text}");
}

#[test]
fn who_broke_a_budget_is_said_in_words() {
    let mut report = report();
    assert!(report.judgement().starts_with("budgets: all 1 met; the machine's other load"), "{report:?}");
    let stage = &mut report.stages[Stage::Simulation as usize];
    (stage.broken, stage.judged_ms, stage.mean_ms) = (true, 1.5 * stage.budget_ms, stage.mean_budget_ms);
    assert!(
        report
            .judgement()
            .contains("simulation exceeded, and the load does not explain it; the machine's other load"),
        "{report:?}"
    );
    let of = |others_percent| Load { processors: 2, others_percent, stolen_percent: 0.0 };
    report.load = Some(of(40.0));
    let told = report.judgement();
    let expected =
        "simulation exceeded, by no more than the machine's load explains (other programs took 40 %";
    assert!(told.contains(expected), "{told}");
    report.load = Some(of(30.0));
    assert!(
        report.judgement().contains("simulation exceeded, and the load does not explain it; other"),
        "{report:?}"
    );
    report.stages.clear();
    assert_eq!(report.judgement(), "budgets: none was checked");
}

#[test]
fn json_has_what_scripts_look_for() {
    let json = serde_json::to_value(report()).unwrap();
    assert_eq!(json["format"], FORMAT);
    assert_eq!(json["restarts"]["tracker"], 2);
    assert_eq!(json["stages"][0]["stage"], "camera");
    assert_eq!(json["stages"][3]["broken"], false);
    assert_eq!(json["stages"][5]["verdict"], "no-samples");
    assert_eq!(json["paper_table_4"][1]["paper_ms"], 1.5);
    assert_eq!(json["step_profile"][4]["phase"], "vitreous");
    assert_eq!(json["removed"]["vitreous_left_ml"], 3.25);
}

#[test]
fn what_was_removed_is_told_in_its_units_and_only_where_something_was() {
    let step = StepRecord { vitreous_left_um3: 4_000_000_000_000, ..StepRecord::zeroed() };
    assert_eq!(Removed::of(&step).text(), "");
    let step = StepRecord { membrane_cut_um2: 2_310_000, vitreous_removed_um3: 420_000_000_000, ..step };
    assert_eq!(Removed::of(&step).text(), "membrane 2.31 mm², vitreous 0.42 ml (4.00 ml left)");
}
