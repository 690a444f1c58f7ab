//! A new rig is set up from live cameras, here pipes: pictures and movements, without a recording between.

use crate::live_cameras::{Bench, Writer, painted};
use protocol::fields::FieldPicture;
use vitreo_tests::{Finished, json, vitreo};

/// Runs a step while three pipes bring what the virtual cameras saw, again and again.
fn step(bench: &Bench, painted: &[[FieldPicture; 2]], words: &[&str]) -> Finished {
    let writers: Vec<Writer> = ["a", "b", "c"]
        .iter()
        .zip(painted)
        .map(|(pipe, fields)| Writer::start(bench.text(pipe).as_ref(), fields, false))
        .collect();
    let cameras = ["a", "b", "c"].map(|pipe| format!("y4m:{}", bench.text(pipe))).join(",");
    let rig = bench.text("rig");
    let done = vitreo(&[&["commission", &rig][..], words, &["--cameras", &cameras]].concat());
    writers.into_iter().for_each(Writer::close);
    done
}

#[test]
fn steps_take_pictures_and_movements_from_pipes() {
    let (bench, painted) = (Bench::new(), painted());
    bench.pipes();
    let done = step(&bench, &painted, &["colours", "--every", "5"]);
    assert_eq!(done.code, Some(0), "{done:?}");
    assert!(done.stderr.contains("taking 8 pictures of each camera"), "{done:?}");
    let record = json(bench.text("rig/commission.json").as_ref())["steps"]["colours"].clone();
    let from = record["from"].as_array().expect("sources");
    assert!(from.len() == 3 && from[2] == format!("y4m:{}", bench.text("c")), "{record}");
    // There is no board in them, and nothing moves; both is said, and nothing written.
    let board = ["lenses", "--board", "9x6", "--every", "1", "--max-pictures", "9"];
    let lenses = step(&bench, &painted, &board);
    assert!(
        lenses.code == Some(1) && lenses.stderr.contains("camera 2 saw the board in 0 of "),
        "{lenses:?}"
    );
    let trocars = step(&bench, &painted, &["trocars", "--seconds", "3"]);
    assert!(trocars.code == Some(1) && trocars.stderr.contains("tilt it in its trocar"), "{trocars:?}");
}

#[test]
fn cameras_that_are_too_few_or_of_another_size_are_refused() {
    let bench = Bench::new();
    let small = bench.text("small.y4m");
    std::fs::write(&small, "YUV4MPEG2 W640 H240 F50:1 Ip C422\nFRAME\n").expect("written");
    let (rig, one) = (bench.text("rig"), format!("y4m:{small}"));
    let three = [one.as_str(); 3].join(",");
    for (step, cameras, named) in [
        ("colours", &one, "expected one for each of 3 cameras, found 1"),
        ("check", &one, "expected one for each of 3 cameras, found 1"),
        ("colours", &three, "progressive pictures of 640×240 px; the rig expects fields of 720×288 px"),
    ] {
        let refused = vitreo(&["commission", &rig, step, "--cameras", cameras]).expect_code(1);
        assert!(refused.stderr.contains(named), "{step}: {refused:?}");
        assert!(!bench.exists("rig"), "{step}: something was written");
    }
}
