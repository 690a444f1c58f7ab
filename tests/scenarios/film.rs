//! Films are made without a clock: as many pictures as asked for, and stills at their instants.

use vitreo_tests::{repository, vitreo};

/// Size of a picture of the smallest tier, both channels, px.
const SIZE: [usize; 2] = [320, 128];

#[test]
fn a_film_has_every_picture_and_its_stills() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (film, stills) = (path("f.y4m"), path("stills"));
    let how = ["--length", "0.4", "--tier", "8", "--every", "0.2"];
    let told =
        vitreo(&[&["film", "peeling", "-o", &film, "--stills", &stills][..], &how].concat()).expect_code(0);
    assert!(told.stderr.contains("0.4 s: as long as asked for") && told.stdout.contains(&film), "{told:?}");
    let bytes = std::fs::read(&film).expect("the film");
    let [w, h] = SIZE;
    assert!(bytes.starts_with(format!("YUV4MPEG2 W{w} H{h} F25:1 ").as_bytes()));
    let first = bytes.iter().position(|b| *b == b'\n').expect("a header") + 1;
    let picture = "FRAME\n".len() + w * h * 3 / 2;
    assert_eq!(bytes.len() - first, 11 * picture, "from 0 to 0.4 s, 25 a second");
    let last = &bytes[bytes.len() - w * h * 3 / 2..][..w * h];
    assert_ne!(&bytes[first + 6..][..w * h], last, "something moves");
    let mut names: Vec<_> = std::fs::read_dir(&stills)
        .expect("stills")
        .map(|e| e.expect("entry").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert_eq!(names, ["still-000.0.png", "still-000.2.png", "still-000.4.png"]);
}

#[test]
fn what_cannot_be_filmed_is_refused() {
    let missing = vitreo(&["film", "juggling", "-o", "/nowhere/f.y4m"]).expect_code(2).stderr;
    assert!(missing.contains("juggling") && missing.contains("peeling"), "{missing}");
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
