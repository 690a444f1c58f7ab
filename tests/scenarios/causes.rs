//! A run and a replay say the likely cause of large residuals at their end, a healthy one says nothing; pages of
//! comparisons show the worst instant; what-ifs of recordings that were cut begin with what was known there.

use protocol::steps::InputsDigest;
use recording::{Item, Recording, Writer};
use std::path::Path;
use vitreo_tests::{Observer, Running, instance_name, interrupt, repository, vitreo};

fn golden() -> String {
    repository().join("tests/data/golden/peel-2s.mcap").display().to_string()
}

/// A stream whose cameras 0 and 1 carry each other's ids.
fn swap_cameras(stream: &Path) {
    let text = std::fs::read_to_string(stream).expect("a stream");
    let swapped = text.replace("\"cam\":0,", "\"cam\":x,").replace("\"cam\":1,", "\"cam\":0,");
    std::fs::write(stream, swapped.replace("\"cam\":x,", "\"cam\":1,")).expect("written");
}

#[test]
fn a_run_of_swapped_cameras_says_so_at_its_end_and_a_healthy_one_says_nothing() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [healthy, stream, swapped] = ["a.mcap", "s.jsonl", "b.mcap"].map(path);
    let run = |more: &[&str]| {
        let name = instance_name();
        vitreo(&[&["run", "--no-picture", "--instance", &name], more].concat())
    };
    let said = run(&["--direct", "--duration", "5", "--record", &healthy]).expect_code(0);
    assert!(!said.stdout.contains("likely cause") && !said.stdout.contains("left off"), "{said:?}");
    vitreo(&["replay", &healthy, "--lockstep", "--blobs", &stream]).expect_code(0);
    swap_cameras(Path::new(&stream));
    let rig = repository().join("assets/rig.json").display().to_string();
    let said = run(&["--rig", &rig, "--blobs", &stream, "--record", &swapped]);
    let cause = "likely cause: the ids of cameras 0 and 1 are swapped";
    assert!(said.stdout.contains(cause) && said.stdout.contains("Remedy: exchange"), "{said:?}");
    let replayed = vitreo(&["replay", &swapped, "--lockstep"]);
    assert!(replayed.stdout.contains(cause), "{replayed:?}");
    let last = vitreo(&["residuals", &swapped, "--causes", "--last", "2"]).expect_code(0);
    assert!(last.stdout.contains("cameras 0 and 1 are swapped"), "{last:?}");
    let hurried = vitreo(&["residuals", &swapped, "--causes", "--last", "2", "--within", "0.000001"]);
    assert!(hurried.expect_code(0).stdout.contains("the search was stopped before a cause was found"));
}

#[test]
fn a_run_that_is_ended_by_hand_says_the_cause_or_that_the_search_was_left_off() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [rig, record] = ["rig.json", "a.mcap"].map(path);
    let provenance = Recording::open(Path::new(&golden())).expect("golden").provenance().clone();
    let mut wrong = rig::Rig::parse(&provenance.rig_json, "golden").expect("a rig");
    // The rig file has the cameras at each other's places; the blobs come from a stream of the true ones.
    let [a, b] = [wrong.cameras[0].id, wrong.cameras[1].id];
    (wrong.cameras[0].id, wrong.cameras[1].id) = (b, a);
    std::fs::write(&rig, wrong.to_json()).expect("written");
    let stream = path("s.jsonl");
    vitreo(&["replay", &golden(), "--lockstep", "--blobs", &stream]).expect_code(0);
    let name = instance_name();
    let running = Running::start(&[
        "run",
        "--no-picture",
        "--rig",
        &rig,
        "--blobs",
        &stream,
        "--record",
        &record,
        "--instance",
        &name,
    ]);
    let observer = Observer::join(&name);
    let mut poses = observer.receiver::<protocol::poses::TrackerFrame>();
    vitreo_tests::next(&mut poses, |frame| frame.frame > 60);
    interrupt(running.pid());
    drop((poses, observer));
    let said = running.finish();
    assert!(
        said.stdout.contains("are swapped") || said.stdout.contains("the search for the cause"),
        "{said:?}"
    );
}

/// The golden recording with its items changed.
fn changed(to: &str, change: impl Fn(&mut Item)) {
    let recording = Recording::open(Path::new(&golden())).expect("golden");
    let mut writer = Writer::create(Path::new(to), recording.provenance()).expect("a copy");
    for item in recording.items() {
        let (at, mut item) = item.expect("an item");
        change(&mut item);
        writer.write(at, &item).expect("written");
    }
    writer.finish().expect("finished");
}

#[test]
fn a_page_shows_both_recordings_where_they_differ_most_or_says_why_not() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [moved, page, stream, rig] = ["b.mcap", "p.html", "s.jsonl", "rig.json"].map(path);
    let [import, lacking] = ["i.mcap", "l.mcap"].map(path);
    changed(&moved, |item| {
        if let Item::Poses(frame) = item
            && frame.field == 50
        {
            frame.bodies[0].world_from_body.position_mm[2] += 0.5;
        }
        // Steps that consumed other poses than these are not repeated, unless nothing says which they consumed.
        if let Item::Step(step) = item {
            *step = step.with_inputs(InputsDigest::default());
        }
    });
    let show = |a: &str, b: &str| {
        let done = vitreo(&["diff", a, b, "--html", &page, "--force"]).expect_code(5);
        assert!(done.stdout.contains("differ, first in"), "{done:?}");
        std::fs::read_to_string(&page).expect("a page")
    };
    let html = show(&golden(), &moved);
    assert!(html.contains("inst0 is 500.00 µm apart") && html.contains("field 50"), "{html}");
    assert_eq!(html.matches("src=\"data:image/jpeg;base64,").count(), 2, "{html}");
    // In the letters of a picture any four may stand.
    let mut parts = html.split("base64,");
    let head = parts.next().expect("a head").to_owned();
    let without_pictures =
        parts.fold(head, |text, part| text + part.split_once('"').expect("the end of a picture").1);
    let without_name_of_svg = without_pictures.replace("xmlns=\"http://www.w3.org/2000/svg\"", "");
    assert!(!without_name_of_svg.contains("http"), "nothing comes from a network");
    // Streams hold neither poses nor states: this build tracks and simulates what they hold.
    let provenance = Recording::open(Path::new(&golden())).expect("golden").provenance().clone();
    std::fs::write(&rig, &provenance.rig_json).expect("written");
    vitreo(&["replay", &golden(), "--lockstep", "--blobs", &stream]).expect_code(0);
    vitreo(&["import", "--rig", &rig, &stream, "-o", &import]).expect_code(0);
    let text = std::fs::read_to_string(&stream).expect("a stream");
    let without = text.lines().enumerate().filter(|(line, _)| *line != 150).map(|(_, line)| line);
    std::fs::write(&stream, without.collect::<Vec<_>>().join("\n") + "\n").expect("written");
    vitreo(&["import", "--rig", &rig, &stream, "-o", &lacking]).expect_code(0);
    let html = show(&import, &lacking);
    assert!(html.contains("the first difference, in inputs"), "{html}");
    assert_eq!(html.matches("as this build tracks its blobs").count(), 2, "{html}");
    let mut foreign = provenance.clone();
    foreign.versions.insert(recording::STATE_HASH.into(), "99".into());
    let other = path("foreign.mcap");
    let mut writer = Writer::create(Path::new(&other), &foreign).expect("a copy");
    for item in Recording::open(Path::new(&moved)).expect("a copy").items() {
        let (at, item) = item.expect("an item");
        writer.write(at, &item).expect("written");
    }
    writer.finish().expect("finished");
    let html = show(&golden(), &other);
    assert!(html.contains("no picture: its states are of another build (version 99)"), "{html}");
    assert_eq!(html.matches("src=\"data:image/jpeg;base64,").count(), 1, "{html}");
}

#[test]
fn a_what_if_of_a_part_begins_with_what_was_known_at_the_cut() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [part, again, other] = ["c.mcap", "d.mcap", "e.mcap"].map(path);
    vitreo(&["cut", &golden(), "--from", "0.6", "-o", &part]).expect_code(0);
    let what_if = |output: &str, set: &[&str]| vitreo(&[&["replay", &part, "-o", output], set].concat());
    let same = what_if(&again, &[]).expect_code(0);
    assert!(same.stderr.contains("begins at the cut with the tracker's recorded state"), "{same:?}");
    vitreo(&["diff", &part, &again]).expect_code(0);
    vitreo(&["replay", &again, "--lockstep", "--verify"]).expect_code(0);
    let anew = what_if(&other, &["--set", "tracker.tremor_ripple_db=3"]).expect_code(0);
    assert!(
        anew.stderr.contains("a new tracker starts at the cut") && anew.stderr.contains("constants"),
        "{anew:?}"
    );
    vitreo(&["replay", &other, "--lockstep", "--verify"]).expect_code(0);
    vitreo(&["diff", &part, &other]).expect_code(5);
    let scene = what_if(&path("f.mcap"), &["--set", "scene.membrane.lift_mm=0.2"]).expect_code(2);
    assert!(scene.stderr.contains("is a cut part") && scene.stderr.contains("c.mcap"), "{scene:?}");
    assert!(!folder.path().join("f.mcap").exists());
}
