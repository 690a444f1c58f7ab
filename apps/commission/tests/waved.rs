//! Waved instruments: they refine a rig whose cameras were moved, keep one that holds, and refuse one that they cannot
//! correct.

#[allow(dead_code, reason = "some of what it paints is for the other tests")]
mod painted;

use painted::{Seen, displaced, stream, tips_um, write_stream};
use rig::Rig;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A folder with a stream that the shipped rig sees.
struct Bench {
    folder: tempfile::TempDir,
    truth: Rig,
    seen: Seen,
}

/// What the step left.
struct Done {
    code: Option<i32>,
    out: String,
    err: String,
    /// Of the rig.
    folder: PathBuf,
}

impl Bench {
    fn new() -> Self {
        let truth = Rig::load_or_shipped(None).unwrap();
        let bench = Bench { folder: tempfile::tempdir().unwrap(), seen: stream(&truth, 8.0), truth };
        write_stream(&bench.seen.fields, &bench.path("wave.jsonl"));
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Does `poses` by the stream in a new folder of this name, beginning with a rig.
    fn poses(&self, name: &str, begin: &Rig) -> Done {
        let (folder, rig) = (self.path(name), self.path(&format!("{name}.json")));
        std::fs::write(&rig, begin.to_json()).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_vitreo-commission"));
        command.arg(&folder).arg("--rig").arg(&rig).args(["poses", "--from"]).arg(self.path("wave.jsonl"));
        let done = command.output().unwrap();
        let [out, err] = [done.stdout, done.stderr].map(|text| String::from_utf8(text).unwrap());
        println!("{out}{err}");
        Done { code: done.status.code(), out, err, folder }
    }
}

fn written(folder: &Path) -> Rig {
    Rig::load(&folder.join("rig.json")).unwrap()
}

#[test]
fn cameras_that_were_moved_are_put_back() {
    let bench = Bench::new();
    let off = displaced(&bench.truth, 0.1, 1.0);
    let done = bench.poses("moved", &off);
    assert_eq!(done.code, Some(0), "{}", done.err);
    assert!(done.out.contains("residual of held-out instants, after"), "{}", done.out);
    let [found_um, true_um] = [&written(&done.folder), &bench.truth].map(|rig| tips_um(rig, &bench.seen));
    println!("tips {found_um:.1} µm, with the true rig {true_um:.1} µm");
    assert!(found_um < 1.5 * true_um + 1.0, "{found_um} µm");
}

#[test]
fn a_rig_that_holds_is_kept_and_the_step_is_done() {
    let bench = Bench::new();
    let done = bench.poses("true", &bench.truth);
    assert_eq!(done.code, Some(0), "{}", done.err);
    assert!(done.out.contains("(previous values are kept)"), "{}", done.out);
    assert!(done.out.contains("does not predict held-out instants better"), "{}", done.out);
    assert_eq!(written(&done.folder), bench.truth);
    let state = std::fs::read_to_string(done.folder.join("commission.json")).unwrap();
    assert!(state.contains("\"poses\""), "{state}");
}

/// Moved cameras would hide a wrong lens.
#[test]
fn a_wrong_lens_is_refused_with_its_name() {
    let bench = Bench::new();
    let mut wrong = bench.truth.clone();
    let camera = &mut wrong.cameras[1];
    (camera.fx, camera.fy) = (1.02 * camera.fx, 1.02 * camera.fy);
    let done = bench.poses("lens", &wrong);
    assert_eq!(done.code, Some(5), "{}{}", done.out, done.err);
    assert!(done.out.contains("the lens of camera 1 is not that of the rig file"), "{}", done.out);
    let why = "poses: nothing was written: the lens of camera 1 is wrong, and refined camera poses would only hide it";
    assert!(done.err.contains(why), "{}", done.err);
    assert!(!done.folder.exists(), "nothing is written");
}
