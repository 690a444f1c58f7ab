//! A recording in parts is the whole, for every command: it verifies, is traced, compared, put together and
//! mended, and each part verifies alone.

use recording::{Item, Recording, part_file, parts_of};
use std::fs::File;
use std::path::{Path, PathBuf};
use validation::live_recording::Live;
use vitreo_tests::verified::verify;
use vitreo_tests::{instance_name, vitreo};

/// Fields of the recording: eleven seconds, and so six pairs of checkpoints.
const FIELDS: u64 = 550;

/// A recording in one file, and the name under which it is to be split.
fn recorded(folder: &Path) -> (PathBuf, PathBuf) {
    let (whole, split) = (folder.join("whole.mcap"), folder.join("run.mcap"));
    let file = File::create(&whole).expect("a file");
    Live { scene: "peel", fields: FIELDS, seed: 3 }.record(file, &whole, |_| {}).expect("a shipped scene");
    (whole, split)
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

/// Log time and message of every item.
fn items(file: &Path) -> Vec<(u64, Vec<u8>)> {
    let items = Recording::open(file).expect("a recording").items();
    items.map(|item| item.map(|(at, item)| (at, item.encoded())).expect("an item")).collect()
}

#[test]
fn parts_are_read_as_one_and_verify_alone() {
    let folder = tempfile::tempdir().expect("folder");
    let (whole, split) = recorded(folder.path());
    let [one, all] = [text(&whole), text(&split)];
    let told = vitreo(&["cut", &one, "--split", "3s", "-o", &all]).expect_code(0).stdout;
    let parts = parts_of(&split);
    assert_eq!(told.lines().collect::<Vec<_>>(), parts.iter().map(|p| text(p)).collect::<Vec<_>>());
    assert!(parts.len() >= 3 && !split.exists(), "{parts:?}");
    assert_eq!(items(&split), items(&whole), "every item, in its order");
    // What both proofs say of the whole, they say of the parts read as one.
    let (of_whole, of_all) = (verify(&whole), verify(&split));
    let both = [&of_whole, &of_all].map(|v| (v.finished.code, v.poses(), v.states()));
    assert_eq!(both[0], both[1], "{}", of_all.finished.stdout);
    assert!(both[0].0 == Some(0) && both[0].1.identical > 500, "{}", of_whole.finished.stdout);
    for part in &parts {
        let alone = verify(part);
        let (poses, states) = (alone.poses(), alone.states());
        let told = alone.finished.expect_code(0).stdout;
        assert!(told.contains("identical") && told.contains("verified"), "{told}");
        assert!(poses.identical > 50 && states.identical > 50, "{}: {told}", part.display());
        vitreo(&["check", &text(part)]).expect_code(0);
    }
    // Every command reports the same of both.
    for command in
        [&["trace", "FILE", "400"][..], &["export", "FILE", "--csv", "events"], &["residuals", "FILE"]]
    {
        let told = [&one, &all].map(|file| {
            let words: Vec<&str> =
                command.iter().map(|w| if *w == "FILE" { file.as_str() } else { *w }).collect();
            vitreo(&words).expect_code(0).stdout.replace(file.as_str(), "FILE")
        });
        assert!(told[0] == told[1] && !told[0].is_empty(), "{command:?}: {} {}", told[0], told[1]);
    }
    vitreo(&["check", &all]).expect_code(0);
    vitreo(&["diff", "--quick", &one, &all]).expect_code(0);
    let told = vitreo(&["info", &all]).expect_code(0).stdout;
    assert!(parts.iter().all(|part| told.contains(&format!("part {}: ", part.display()))), "{told}");
    assert!(vitreo(&["info", &text(&parts[1])]).expect_code(0).stdout.contains("part 2 of "), "alone");
    // A place in the third part is found.
    let late = text(&folder.path().join("late.mcap"));
    vitreo(&["cut", &all, "--from", "8.5", "-o", &late]).expect_code(0);
    assert_eq!(verify(Path::new(&late)).finished.code, Some(0));
}

#[test]
fn parts_become_one_file_again_whatever_the_packing() {
    let folder = tempfile::tempdir().expect("folder");
    let (whole, split) = recorded(folder.path());
    let [one, all] = [text(&whole), text(&split)];
    vitreo(&["cut", &one, "--split", "200kB", "--compress", "lz4", "-o", &all]).expect_code(0);
    let parts: Vec<String> = parts_of(&split).iter().map(|part| text(part)).collect();
    assert!(parts.len() >= 3, "{parts:?}");
    let expected = items(&whole);
    let mut sizes = Vec::new();
    for packing in ["zstd", "lz4", "none"] {
        let joined = folder.path().join(format!("{packing}.mcap"));
        vitreo(&["merge", &all, "--compress", packing, "-o", &text(&joined)]).expect_code(0);
        assert!(items(&joined) == expected, "{packing}");
        let recording = Recording::open(&joined).expect("a recording");
        assert!(recording.matches_checksum().expect("readable") && recording.part().is_none());
        sizes.push(recording.bytes());
    }
    assert!(sizes.is_sorted(), "zstd, lz4, none: {sizes:?}");
    // The parts one by one, in any order.
    let joined = folder.path().join("again.mcap");
    let words: Vec<&str> = ["merge"].into_iter().chain(parts.iter().rev().map(String::as_str)).collect();
    vitreo(&[&words[..], &["-o", &text(&joined)]].concat()).expect_code(0);
    assert!(items(&joined) == expected);
    // No output is a part that is read, and parts that exist are not written over.
    let refused = vitreo(&["merge", &all, "--force", "-o", &parts[1]]).expect_code(1).stderr;
    assert!(refused.contains("is an input of the command"), "{refused}");
    let refused = vitreo(&["cut", &one, "--split", "3s", "-o", &all]).expect_code(1).stderr;
    assert!(refused.contains("run.0001.mcap") && refused.contains("--force"), "{refused}");
    // A shorter one in its place leaves no old part behind.
    vitreo(&["cut", &one, "--until", "1", "--split", "3s", "--force", "-o", &all]).expect_code(0);
    assert_eq!(parts_of(&split).len(), 1);
    vitreo(&["info", &all]).expect_code(0);
}

#[test]
fn a_missing_part_is_named_and_a_crashed_one_is_mended() {
    let folder = tempfile::tempdir().expect("folder");
    let (whole, split) = recorded(folder.path());
    let all = text(&split);
    vitreo(&["cut", &text(&whole), "--split", "3s", "-o", &all]).expect_code(0);
    // The third part as a crash leaves it.
    let third = part_file(&split, 3);
    let bytes = std::fs::read(&third).expect("a part");
    std::fs::write(&third, &bytes[..bytes.len() * 2 / 3]).expect("cut");
    parts_of(&split).iter().skip(3).for_each(|part| std::fs::remove_file(part).expect("removed"));
    let mended = folder.path().join("mended.mcap");
    vitreo(&["recover", &all, "-o", &text(&mended)]).expect_code(3);
    let (left, expected) = (items(&mended), items(&whole));
    let same = left.iter().zip(&expected).take_while(|(a, b)| a == b).count();
    assert!(same + 3 > left.len() && same > expected.len() / 2, "{same} of {}", left.len());
    for number in 1..=2 {
        assert_eq!(verify(&part_file(&split, number)).finished.code, Some(0));
    }
    // A mended part is a separate recording.
    let alone = folder.path().join("alone.mcap");
    vitreo(&["recover", &text(&third), "-o", &text(&alone)]).expect_code(3);
    assert!(Recording::open(&alone).expect("a recording").part().is_none());
    std::fs::remove_file(part_file(&split, 2)).expect("removed");
    let told = vitreo(&["info", &all]).expect_code(3).stdout;
    assert!(told.contains("run.0002.mcap: is missing"), "{told}");
    let verified = verify(&split);
    let poses = verified.poses();
    let told = verified.finished.expect_code(3).stdout;
    assert!(told.contains("not all is verified") && poses.identical > 100, "{told}");
}

/// Live: the recorder splits where tracker and simulation have saved after the same frame.
#[test]
fn a_live_run_is_recorded_in_parts() {
    let folder = tempfile::tempdir().expect("folder");
    let split = folder.path().join("run.mcap");
    let (all, name) = (text(&split), instance_name());
    let run = ["run", "--no-picture", "--direct", "--duration", "6", "--instance", &name, "--record", &all];
    let told = vitreo(&[&run[..], &["--split", "1s"]].concat()).expect_code(0).stdout;
    let parts = parts_of(&split);
    assert!(told.contains(&format!("in {} parts", parts.len())), "{told}");
    assert!(parts.len() >= 2, "{parts:?}");
    let recording = Recording::open(&split).expect("a recording");
    assert!(recording.is_finished() && recording.items().all(|item| item.is_ok()));
    let mut steps = 0;
    for item in recording.items_of(&["steps"]) {
        if let Ok((_, Item::Step(step))) = item {
            assert!(step.step > steps, "no step twice");
            steps = step.step;
        }
    }
    verify(&split).expect_but([100, 100], &[vitreo_tests::verified::WITHOUT_FRAME]);
    // The last one may be as short as the run ended behind its beginning.
    for part in &parts[..parts.len() - 1] {
        verify(part).expect_but([20, 20], &[vitreo_tests::verified::WITHOUT_FRAME]);
    }
    let refused = vitreo(&["run", "--no-picture", "--split", "1s"]).expect_code(2).stderr;
    assert!(refused.contains("--record"), "{refused}");
}
