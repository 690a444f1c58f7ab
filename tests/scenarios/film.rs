//! Films are made without a clock, of modules and of recordings: as many pictures as asked for, and
//! stills at their instants.

use std::path::Path;
use std::time::{Duration, Instant};
use vitreo_tests::{Running, instance_name, interrupt, repository, vitreo};

/// Size of a picture of the smallest tier in files, both channels, px.
const SIZE: [usize; 2] = [960, 384];

fn golden() -> String {
    repository().join("tests/data/golden/peel-2s.mcap").display().to_string()
}

/// Names of the files in a folder.
fn names(folder: &str) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    let mut names: Vec<_> =
        entries.map(|e| e.expect("entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn a_film_has_every_picture_and_its_stills() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (film, stills) = (path("f.y4m"), path("stills"));
    let how = ["--length", "0.4", "--tier", "8", "--every", "0.2"];
    let told =
        vitreo(&[&["film", "peeling", "-o", &film, "--stills", &stills][..], &how].concat()).expect_code(0);
    assert!(told.stderr.contains("0.4 s: reached --length") && told.stdout.contains(&film), "{told:?}");
    let bytes = std::fs::read(&film).expect("the film");
    let [w, h] = SIZE;
    assert!(bytes.starts_with(format!("YUV4MPEG2 W{w} H{h} F25:1 ").as_bytes()));
    let first = bytes.iter().position(|b| *b == b'\n').expect("a header") + 1;
    let picture = "FRAME\n".len() + w * h * 3 / 2;
    assert_eq!(bytes.len() - first, 11 * picture, "from 0 to 0.4 s, 25 a second");
    let last = &bytes[bytes.len() - w * h * 3 / 2..][..w * h];
    assert_ne!(&bytes[first + 6..][..w * h], last, "something moves");
    assert_eq!(names(&stills), ["still-000.00.png", "still-000.20.png", "still-000.40.png"]);
}

#[test]
fn what_cannot_be_filmed_is_refused() {
    let missing = vitreo(&["film", "juggling", "-o", "/nowhere/f.y4m"]).expect_code(2).stderr;
    assert!(missing.contains("juggling") && missing.contains("peeling"), "{missing}");
    for absent in ["/nowhere/a.mcap", "/nowhere/module", "a.mkv"] {
        let missing = vitreo(&["film", absent]).expect_code(1).stderr;
        assert!(missing.contains(absent), "{missing}");
    }
    let nobody = vitreo(&["film", "peeling", "--surgeon", "genius"]).expect_code(2).stderr;
    assert!(nobody.contains("expert, average, novice"), "{nobody}");
    vitreo(&["film", "peeling", "--length", "-3"]).expect_code(2);
}

#[test]
fn a_photograph_of_the_other_eye_is_warned_of() {
    let folder = tempfile::tempdir().expect("folder");
    let photograph = repository().join("assets/fundus.jpg").display().to_string();
    let film = |name: &str, eye: &str| {
        let file = folder.path().join(name).display().to_string();
        let how = ["--length", "0.04", "--tier", "8", "--fundus", &photograph, "--fundus-eye", eye];
        let told = vitreo(&[&["film", "peeling", "-o", &file][..], &how].concat()).expect_code(0).stderr;
        (std::fs::read(&file).expect("the film"), told)
    };
    let ((left, quiet), (right, warned)) = (film("l.y4m", "left"), film("r.y4m", "right"));
    assert!(!quiet.contains("--fundus-eye"), "{quiet}");
    assert!(warned.contains("fundus.jpg") && warned.contains("--fundus-eye left"), "{warned}");
    assert_ne!(left, right, "it is laid on the other way round");
}

#[test]
fn a_recording_is_drawn_again_from_its_start_or_a_part_of_it() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let film = |part: &[&str], name: &str| {
        let (film, stills) = (path(&format!("{name}.y4m")), path(name));
        let how = ["film", &golden(), "--tier", "8", "-o", &film, "--stills", &stills, "--every", "0.2"];
        let told = vitreo(&[&how[..], part].concat()).expect_code(0);
        assert!(told.stderr.contains("from the recording") && told.stderr.lines().count() == 1, "{told:?}");
        std::fs::read(film).expect("the film")
    };
    let picture = "FRAME\n".len() + SIZE[0] * SIZE[1] * 3 / 2;
    let pictures = |film: &[u8]| {
        let first = film.iter().position(|b| *b == b'\n').expect("a header") + 1;
        film[first..].chunks(picture).map(<[u8]>::to_vec).collect::<Vec<_>>()
    };
    let part = pictures(&film(&["--from", "0.4", "--until", "0.8"], "part"));
    assert_eq!(names(&path("part")), ["still-000.40.png", "still-000.60.png", "still-000.80.png"]);
    let all = pictures(&film(&["--until", "1"], "all"));
    assert_eq!((part.len(), all.len()), (11, 26));
    assert!(part == all[10..21], "a part shows what the whole shows then");
    assert_ne!(all[0], all[25], "something moves");
    // Stills alone are the same pictures, though nothing is drawn between them.
    let alone = path("alone");
    let how = ["--tier", "8", "--until", "1", "--stills", &alone, "--every", "0.2"];
    let told = vitreo(&[&["film", &golden()][..], &how].concat()).expect_code(0);
    assert_eq!(told.stdout.trim(), alone, "no film is made");
    assert_eq!(names(&alone), names(&path("all")));
    for name in names(&alone) {
        let of = |folder: &str| std::fs::read(Path::new(folder).join(&name)).expect("a still");
        assert!(of(&alone) == of(&path("all")), "{name}");
    }
}

#[test]
fn what_of_a_recording_cannot_be_drawn_is_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let film = |file: &str, part: &[&str]| {
        let film = path("f.mp4");
        vitreo(&[&["film", file, "--tier", "8", "-o", &film][..], part].concat())
    };
    for (part, told) in [
        (&["--from", "1.5", "--until", "0.5"][..], "--until 0.5"),
        (&["--from", "100"], "peel-2s.mcap is only 1."),
        (&["--level", "1"], "--level"),
        (&["--from", "soon"], "--from"),
    ] {
        let done = film(&golden(), part).expect_code(2);
        assert!(done.stderr.contains(told), "{}", done.stderr);
    }
    let done = vitreo(&["film", &golden(), "-o", &path("f.avi")]).expect_code(2);
    assert!(done.stderr.contains(".mp4") && done.stderr.contains(".y4m"), "{}", done.stderr);
    let done = film(&path("no.mcap"), &[]).expect_code(1);
    assert!(done.stderr.contains("no.mcap"), "{}", done.stderr);
    assert!(!folder.path().join("f.mp4").exists());
}

#[test]
fn a_replay_draws_what_it_verifies_as_the_film_of_the_recording_does() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let part = ["--until", "0.8", "--tier", "8"];
    let (film, shown, stills) = (path("film.y4m"), path("replay.y4m"), path("stills"));
    vitreo(&[&["film", &golden(), "-o", &film][..], &part].concat()).expect_code(0);
    let what = ["replay", &golden(), "--verify", "--video", &shown, "--stills", &stills, "--every", "0.4"];
    let told = vitreo(&[&what[..], &part].concat()).expect_code(0);
    assert!(told.stdout.contains("identical") && told.stdout.contains(&shown), "{told:?}");
    let read = |file: &str| std::fs::read(file).expect("a film");
    assert!(read(&film) == read(&shown), "the same pictures");
    assert_eq!(names(&stills), ["still-000.00.png", "still-000.40.png", "still-000.80.png"]);
    let recorded = path("recorded.y4m");
    let what = ["replay", &golden(), "--as-recorded", "--video", &recorded];
    vitreo(&[&what[..], &part].concat()).expect_code(0);
    assert!(read(&film) == read(&recorded), "this tracker makes the recorded poses");
    // A file that exists is kept.
    let taken = vitreo(&["replay", &golden(), "--video", &shown]).expect_code(1).stderr;
    assert!(taken.contains("--force"), "{taken}");
}

#[test]
fn an_imported_stream_is_drawn_by_film_and_replay() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [blobs, rig, stream] = ["b.jsonl", "rig.json", "stream.mcap"].map(path);
    vitreo(&["export", &golden(), "--blobs", &blobs, "--rig", &rig]).expect_code(0);
    vitreo(&["import", "--rig", &rig, &blobs, "-o", &stream]).expect_code(0);
    let (film, shown) = (path("film.y4m"), path("replay.y4m"));
    let part = ["--until", "0.4", "--tier", "8"];
    vitreo(&[&["film", &stream, "-o", &film][..], &part].concat()).expect_code(0);
    vitreo(&[&["replay", &stream, "--video", &shown][..], &part].concat()).expect_code(0);
    let read = |file: &str| std::fs::read(file).expect("a film");
    let picture = "FRAME\n".len() + SIZE[0] * SIZE[1] * 3 / 2;
    assert!((10..=12).contains(&(read(&film).len() / picture)), "25 a second");
    assert!(read(&film) == read(&shown), "the same pictures");
    let refused = vitreo(&["replay", &stream, "--as-recorded"]).expect_code(1).stderr;
    assert!(refused.contains("imported"), "{refused}");
}

#[test]
fn a_film_of_a_recording_with_a_gap_tells_it() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (cut, film) = (path("cut.mcap"), path("f.y4m"));
    let whole = std::fs::read(golden()).expect("the recording");
    std::fs::write(&cut, &whole[..whole.len() * 2 / 3]).expect("written");
    let done = vitreo(&["film", &cut, "--tier", "8", "-o", &film]).expect_code(3);
    assert!(done.stderr.contains("cut.mcap: ends in the middle of a record"), "{}", done.stderr);
    assert!(std::fs::metadata(film).expect("the film").len() > 100_000);
}

/// Boxes at the outermost level of an MP4: their kinds.
fn boxes(bytes: &[u8]) -> Vec<String> {
    let (mut rest, mut kinds) = (bytes, Vec::new());
    while let Some((head, _)) = rest.split_first_chunk::<8>() {
        let length = u32::from_be_bytes([head[0], head[1], head[2], head[3]]) as usize;
        kinds.push(String::from_utf8_lossy(&head[4..]).into_owned());
        rest = &rest[length..];
    }
    assert!(rest.is_empty());
    kinds
}

#[test]
fn a_run_and_a_film_write_mp4_where_the_ending_says_so() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let film = path("film.mp4");
    vitreo(&["film", &golden(), "--tier", "8", "--until", "1.2", "-o", &film]).expect_code(0);
    let bytes = std::fs::read(&film).expect("the film");
    assert_eq!(boxes(&bytes), ["ftyp", "moov", "moof", "mdat", "moof", "mdat", "mfra"]);
    let raw = 31 * SIZE[0] * SIZE[1] * 3 / 2;
    assert!(bytes.len() < raw / 8, "{} of {raw} bytes", bytes.len());
    let live = path("live.mp4");
    let run = ["run", "--headless", "--direct", "--duration", "3", "--instance", &instance_name()];
    vitreo(&[&run[..], &["--video", &live]].concat()).expect_code(0);
    let kinds = boxes(&std::fs::read(&live).expect("the film"));
    assert_eq!((&kinds[..2], kinds.last().unwrap().as_str()), (&["ftyp".into(), "moov".into()][..], "mfra"));
    let run = ["run", "--headless", "--video", "a.avi", "--instance", &instance_name()];
    assert!(vitreo(&run).expect_code(2).stderr.contains(".mp4"));
}

#[test]
fn an_interrupted_film_shows_what_was_drawn() {
    let folder = tempfile::tempdir().expect("folder");
    let film = folder.path().join("film.mp4");
    let how = ["--surgeon", "careless", "--tier", "8", "-o", &film.display().to_string()];
    let running = Running::start(&[&["film", "vitrectomy"][..], &how].concat());
    // More than the file's beginning: some pictures are drawn.
    let begun = Instant::now();
    while std::fs::metadata(&film).map_or(0, |m| m.len()) < 5_000 {
        assert!(begun.elapsed() < Duration::from_secs(60), "nothing is drawn");
        std::thread::yield_now();
    }
    interrupt(running.pid());
    let done = running.finish().expect_code(130);
    assert!(done.stderr.contains(" s: stopped"), "{done:?}");
    assert_eq!(boxes(&std::fs::read(&film).expect("the film")).last().unwrap(), "mfra", "it is closed");
}

#[test]
fn a_film_on_a_full_disk_is_told_once() {
    let folder = tempfile::tempdir().expect("folder");
    let film = folder.path().join("full.mp4");
    std::os::unix::fs::symlink("/dev/full", &film).expect("a link");
    let film = film.display().to_string();
    let told = vitreo(&["film", &golden(), "--tier", "8", "--force", "-o", &film]).expect_code(1).stderr;
    assert!(told.contains("the disk is full") && told.contains(&film), "{told}");
    assert!(!told.contains("Broken pipe") && !told.contains("doctor"), "{told}");
}
