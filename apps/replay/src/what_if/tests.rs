//! What-ifs of the golden recording, and whether they verify.

use super::keys::tuning_of;
use super::outcome::{Outcome, Setting};
use super::{CHANGED, OF, setting};
use crate::diff::comparison::{Comparison, StageName};
use crate::diff::{causes::Cause, read};
use crate::engine::{Made, Recorded};
use crate::resimulate::scene_of;
use crate::test_runs::golden;
use crate::verify::Verdict;
use protocol::blobs::BlobField;
use recording::{Item, Provenance, Recording, Source, Writer};
use rig::Rig;
use settings::commands::{Assignment, WhatIfArgs};
use simcore::world::World;
use std::ops::ControlFlow;
use std::path::Path;

fn run(recording: &Recording, setting: &Setting, file: &Path) -> Recording {
    let mut writer = Writer::create(file, &setting.provenance).unwrap();
    let done = Outcome::new(recording, setting).unwrap().run(|at, item| Ok(writer.write(at, item)?)).unwrap();
    writer.finish().unwrap();
    assert!(done.frames > 50 && done.steps > 50 && done.lost.is_none(), "{done:?}");
    Recording::open(file).unwrap()
}

fn changed(set: &[(&str, f64)]) -> WhatIfArgs {
    let set = set.iter().map(|(key, value)| Assignment { key: (*key).into(), value: *value }).collect();
    WhatIfArgs { set, ..WhatIfArgs::default() }
}

/// Verifies a recording as `vitreo replay --verify` does.
fn verify(recording: &Recording) -> Verdict {
    let provenance = recording.provenance();
    let rig = Rig::parse(&provenance.rig_json, "recorded").unwrap();
    let mut verdict = Verdict::new(provenance, false);
    let world = World::new(&scene_of(recording).unwrap()).unwrap().unseen();
    let mut run = Recorded::new(recording, &rig, world);
    run.run(|made| {
        match made {
            Made::Frame(turn, frame, _) if turn.determined => verdict.pose(&turn.recorded, frame),
            Made::Frame(..) => verdict.pass_over_pose(),
            Made::Step(again) => verdict.step(&again.recorded, &again.step),
        }
        Ok(ControlFlow::Continue(()))
    })
    .unwrap();
    verdict
}

fn assert_verified(recording: &Recording) {
    let verdict = verify(recording);
    assert!(verdict.difference.is_none() && verdict.left_out().is_empty(), "{}", verdict.text());
    assert!(verdict.poses.identical > 50 && verdict.states.identical > 50, "{}", verdict.text());
}

#[test]
fn with_nothing_changed_the_recording_comes_out_again() {
    let folder = tempfile::tempdir().unwrap();
    let setting = setting(&golden(), &WhatIfArgs::default()).unwrap();
    let outcome = run(&golden(), &setting, &folder.path().join("same.mcap"));
    let [a, b] = read(golden().path(), outcome.path(), true).unwrap();
    let compared = Comparison::of(&a, &b, 0.0);
    assert!(compared.same && compared.states.compared == 100, "{:?}", compared.stages);
    assert_eq!(outcome.provenance().config[CHANGED], "nothing");
    assert_verified(&outcome);
}

#[test]
fn another_constant_a_higher_membrane_and_a_moved_camera_make_recordings_that_verify() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let rig = file("rig.json");
    let mut moved = Rig::parse(&golden().provenance().rig_json, "golden").unwrap();
    moved.cameras[1].t[0] += 0.05;
    std::fs::write(&rig, moved.to_json()).unwrap();
    let cases = [
        (changed(&[("tracker.tremor_ripple_db", 3.0)]), StageName::Settings, StageName::Poses),
        (changed(&[("scene.membrane.lift_mm", 0.2)]), StageName::Scene, StageName::States),
        (WhatIfArgs { rig: Some(rig), ..WhatIfArgs::default() }, StageName::Rig, StageName::Poses),
    ];
    for (number, (args, first, then)) in cases.into_iter().enumerate() {
        let setting = setting(&golden(), &args).unwrap();
        let outcome = run(&golden(), &setting, &file(&format!("{number}.mcap")));
        let named = ["tracker.tremor_ripple_db=3", "scene.membrane.lift_mm=0.2", "rig.json"][number];
        assert!(outcome.provenance().config[CHANGED].contains(named), "{:?}", outcome.provenance().config);
        assert_eq!(outcome.provenance().config[OF], golden().path().display().to_string());
        assert_verified(&outcome);
        let [a, b] = read(golden().path(), outcome.path(), true).unwrap();
        let compared = Comparison::of(&a, &b, 0.0);
        let stages: Vec<StageName> = compared.stages.iter().map(|s| s.stage).collect();
        assert_eq!(stages.first(), Some(&first), "{:?}", compared.stages);
        assert!(stages.contains(&then), "{:?}", compared.stages);
        assert_eq!(compared.causes.len(), 1, "{:?}", compared.causes);
        let cause = &compared.causes[0].cause;
        assert!(
            matches!(
                (number, cause),
                (0 | 1, Cause::KeyChanged { .. }) | (2, Cause::CameraMoved { camera: 1, .. })
            ),
            "{cause:?}"
        );
    }
}

#[test]
fn constants_travel_in_the_provenance_to_the_bit() {
    let third = 1.0 / 3.0;
    let setting =
        setting(&golden(), &changed(&[("tracker.tremor_ripple_db", third), ("tracker.gate", 50.0)])).unwrap();
    assert_eq!(tuning_of(&setting.provenance).unwrap(), setting.tuning);
    assert_eq!(setting.tuning.tremor_ripple_db, third);
    assert!(!setting.provenance.config.contains_key("tracker.gate"), "the usual value is not written");
    let odd = |value: &str| {
        let config = [("tracker.gate".to_owned(), value.to_owned())].into();
        tuning_of(&Provenance { config, ..Provenance::default() })
    };
    assert!(odd("x").is_err() && odd("0").is_err() && odd("30").is_ok());
}

#[test]
fn an_imported_stream_becomes_a_recording_with_poses_and_steps() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("import.mcap");
    let provenance = Provenance { source: Source::Import, ..golden().provenance().clone() };
    let mut writer = Writer::create(&file, &provenance).unwrap();
    for item in golden().items_of(&["blobs"]) {
        let (_, Item::Blobs(field)) = item.unwrap() else { panic!("blobs only") };
        let field: Box<BlobField> = field;
        writer.write(field.blobs_out_ns, &Item::Blobs(field.clone())).unwrap();
    }
    writer.finish().unwrap();
    let import = Recording::open(&file).unwrap();
    let outcome =
        run(&import, &setting(&import, &WhatIfArgs::default()).unwrap(), &folder.path().join("live.mcap"));
    assert_eq!(outcome.provenance().source, Source::Live);
    assert_verified(&outcome);
}
