//! The whole way: from pictures and streams that a known rig gives, the rig is found again.

#[allow(dead_code, reason = "some of what it paints is for the other tests")]
mod painted;

use nalgebra::Vector3;
use painted::{
    before, chessboard, drawn, places_off, stream, tips_um, together, write_boards, write_markers,
    write_stream,
};
use rig::Rig;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn commission(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vitreo-commission")).args(args).output().unwrap()
}

/// Runs a step and gives what it says; panics with its words where it fails.
fn done(args: &[&str]) -> String {
    let output = commission(args);
    let [out, err] = [&output.stdout, &output.stderr].map(|b| String::from_utf8_lossy(b).into_owned());
    assert!(output.status.success(), "{args:?}: {err}");
    println!("{out}{err}");
    out + &err
}

/// Checks that a step is refused in these words.
fn refused(args: &[&str], named: &[&str]) {
    let output = commission(args);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{args:?}: {told}");
    named.iter().for_each(|words| assert!(told.contains(words), "{words:?} in {told}"));
}

/// Gives camera 0 the pictures of camera 1, and the other way round.
fn exchange(folder: &Path) {
    for (from, to) in [("cam0", "kept"), ("cam1", "cam0"), ("kept", "cam1")] {
        std::fs::rename(folder.join(from), folder.join(to)).unwrap();
    }
}

struct Builder {
    folder: tempfile::TempDir,
}

impl Builder {
    fn path(&self, name: &str) -> String {
        self.folder.path().join(name).display().to_string()
    }

    fn rig(&self) -> Rig {
        Rig::load(&PathBuf::from(self.path("new/rig.json"))).unwrap()
    }
}

#[test]
fn a_rig_is_found_again_from_what_its_cameras_see() {
    let truth = Rig::load_or_shipped(None).unwrap();
    let own = Builder { folder: tempfile::tempdir().unwrap() };
    let begin = drawn(&truth);
    std::fs::write(own.path("drawn.json"), begin.to_json()).unwrap();
    let [new, drawn_rig] = [own.path("new"), own.path("drawn.json")];
    assert!(done(&[&new]).contains("next: vitreo commission"), "nothing is done yet");

    // Colours.
    let pictures = own.folder.path().join("markers");
    std::fs::create_dir(&pictures).unwrap();
    [40, 200, 360].iter().for_each(|n| write_markers(&truth, &pictures, *n, |pixel| pixel));
    let told = done(&[&new, "--rig", &drawn_rig, "colours", "--from", pictures.to_str().unwrap()]);
    assert!(told.contains("colours: 5 colours"), "{told}");

    // Lenses: each camera by its own views.
    let cameras = truth.cameras();
    let boards = own.folder.path().join("boards");
    let views = (0..18).map(|i| (format!("{i:03}"), cameras.iter().map(|c| before(c, i)).collect()));
    write_boards(&cameras, &boards, &views.collect::<Vec<_>>(), &chessboard);
    let from = ["lenses", "--board", "9x6", "--pitch", "2.5", "--from", boards.to_str().unwrap()];
    done(&[&[&*new, "--rig", &drawn_rig], &from[..]].concat());
    let rig = own.rig();
    for (found, true_lens) in rig.cameras.iter().zip(&truth.cameras) {
        let off = [found.fx / true_lens.fx - 1.0, found.fy / true_lens.fy - 1.0].map(|v| 100.0 * v.abs());
        let centre = [found.cx - true_lens.cx, found.cy - true_lens.cy];
        println!("camera {}: focal lengths {off:.3?} %, centre {centre:.2?} px off", found.id);
        assert!(off[0] < 0.5 && off[1] < 0.5, "{off:?} %");
        assert!(centre.iter().all(|v| v.abs() < 8.0), "{centre:?} px");
        assert_eq!(found.t, begin.cameras[found.id as usize].t, "places stay");
    }
    refused(&[&[&*new], &from[..]].concat(), &["lenses was done already", "--force repeats it"]);
    // Who begins with the true rig has nothing to gain.
    std::fs::write(own.path("true.json"), truth.to_json()).unwrap();
    let [other, true_rig] = ["other", "true.json"].map(|name| own.path(name));
    let told = done(&[&[&*other, "--rig", &*true_rig], &from[..]].concat());
    assert!(told.contains("the previous lens fits as well and is kept"), "{told}");

    // Places, from boards that all see.
    let together_at = own.folder.path().join("together");
    let views: Vec<_> = (0..12).map(|i| (format!("{i:03}"), vec![together(i)])).collect();
    write_boards(&cameras, &together_at, &views, &chessboard);
    let poses =
        |pitch| [&*new, "poses", "--board", "9x6", "--pitch", pitch, "--from", together_at.to_str().unwrap()];
    let before_poses = std::fs::read(own.path("new/rig.json")).unwrap();
    refused(&poses("5"), &["times as far apart as in the rig: is --pitch"]);
    exchange(&together_at);
    refused(&poses("2.5"), &["the pictures of cameras 0 and 1 seem to be exchanged"]);
    exchange(&together_at);
    std::fs::rename(together_at.join("cam2"), own.path("cam2")).unwrap();
    refused(&poses("2.5"), &["camera 2: no pictures: all cameras must see the board"]);
    std::fs::rename(own.path("cam2"), together_at.join("cam2")).unwrap();
    assert_eq!(
        std::fs::read(own.path("new/rig.json")).unwrap(),
        before_poses,
        "what is refused changes nothing"
    );
    done(&poses("2.5"));
    let by_board = own.rig();
    println!("from the board: {:.3?} mm, mrad", places_off(&by_board, &truth));

    // Places, from waved instruments; then trocars, and the check, on another stream.
    let seen = stream(&truth, 12.0);
    let wave = own.path("wave.jsonl");
    write_stream(&seen.fields, Path::new(&wave));
    // The boards alone say nothing about where the eye is, and the check says so.
    let output = commission(&[&new, "check", "--from", &wave]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    println!("{told}");
    assert!(!output.status.success() && told.contains("poses"), "{told}");
    done(&[&new, "--force", "poses", "--from", &wave]);
    println!(
        "waved: {:.3?} mm, mrad; tips {:.1} µm",
        places_off(&own.rig(), &truth),
        tips_um(&own.rig(), &seen)
    );
    done(&[&new, "trocars", "--from", &wave]);
    let rig = own.rig();
    let [found_um, true_um] = [&rig, &truth].map(|rig| tips_um(rig, &seen));
    let off = places_off(&rig, &truth);
    println!("at the end: {off:.3?} mm, mrad; tips {found_um:.1} µm, with the true rig {true_um:.1} µm");
    for (old, found) in truth.trocars.iter().zip(&rig.trocars) {
        let mm = (Vector3::from(old.p_eye) - Vector3::from(found.p_eye)).norm();
        println!("trocar of {}: {mm:.3} mm off", old.body);
        assert!(mm < 0.03, "{mm} mm");
    }
    let told = done(&[&new, "--force", "check", "--from", &wave]);
    assert!(told.contains("nothing is missing; the calibration is still valid"), "{told}");
    assert!(done(&[&new]).contains("all steps are done"), "all five steps");
    let page = std::fs::read_to_string(own.path("new/report.html")).unwrap();
    assert!(
        page.matches("data:image/png;base64,").count() >= 3 + 3 + 3 + 4 && !page.contains("not done yet")
    );
    assert!(found_um < 1.5 * true_um + 1.0, "{found_um} µm, with the true rig {true_um} µm");
}
