//! A rig with real cameras: without them it waits and writes nothing; once they are there, it starts.

use protocol::health::{Process, STATE_RUNNING};
use rustix::process::Signal;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStderr, Command, Stdio};
use vitreo_tests::{Observer, WATCHDOG, binaries, instance_name, repository, signal, vitreo};

/// A run without a scripted surgeon, under a watchdog that ends it.
struct Rig {
    child: Child,
    stderr: BufReader<ChildStderr>,
}

impl Rig {
    fn start(instance: &str, store: &Path, further: &[&str]) -> Self {
        let mut command = Command::new("timeout");
        command.arg(WATCHDOG.as_secs().to_string()).arg(binaries().join("vitreo"));
        command.args(["run", "--unscripted", "--no-picture", "--instance", instance]);
        command.args(["--module", "navigation", "--trainee", "t7", "--store"]).arg(store).args(further);
        command.env("XDG_CONFIG_HOME", "/nonexistent").current_dir(repository());
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("timeout");
        let stderr = BufReader::new(child.stderr.take().expect("a pipe"));
        Self { child, stderr }
    }

    /// The line with the reason why it waits.
    fn reason(&mut self) -> String {
        let mut lines = self.stderr.by_ref().lines().map(|l| l.expect("text"));
        lines.find(|l| l.contains("waiting to start")).expect("it waits and says why")
    }

    fn end(mut self) -> Option<i32> {
        signal(self.child.id(), Signal::TERM);
        let mut rest = String::new();
        self.stderr.read_to_string(&mut rest).expect("text");
        let code = self.child.wait().expect("waited for").code();
        assert!(code.is_some_and(|c| c == 0 || c == 3), "{code:?}: {rest}");
        code
    }
}

#[test]
fn without_cameras_a_rig_says_so_and_keeps_nothing() {
    let folder = tempfile::tempdir().expect("folder");
    let (name, store) = (instance_name(), folder.path().join("store.sqlite"));
    let mut rig = Rig::start(&name, &store, &[]);
    let reason = rig.reason();
    assert!(reason.contains("no real cameras are configured") && reason.contains("cameras = "), "{reason}");
    let begun = ipc::instance_directory(&name).expect("a name");
    assert!(!begun.exists(), "it opened {}", begun.display());
    assert_eq!(rig.end(), Some(0));
    let left = std::fs::read_dir(folder.path()).expect("folder").count();
    assert_eq!(left, 0, "it left something beside {}", store.display());
}

#[test]
fn when_the_cameras_come_a_rig_begins_and_its_recording_names_them() {
    let folder = tempfile::tempdir().expect("folder");
    let (name, store) = (instance_name(), folder.path().join("store.sqlite"));
    let (cameras, geometry) = (folder.path().join("rig-cameras"), folder.path().join("rig.json"));
    let text = |path: &Path| path.to_str().expect("UTF-8").to_owned();
    let mut rig = Rig::start(&name, &store, &["--cameras", &text(&cameras), "--rig", &text(&geometry)]);
    let reason = rig.reason();
    assert!(reason.contains("rig-cameras: No such file"), "{reason}");
    // The virtual rig publishes as cameras do, and stands in for them.
    std::os::unix::fs::symlink(binaries().join("vitreo-virtual-rig"), &cameras).expect("a link");
    let reason = rig.reason();
    assert!(reason.contains("rig.json: No such file"), "{reason}");
    let written = folder.path().join("rig.part");
    std::fs::copy(repository().join("assets/rig.json"), &written).expect("copied");
    std::fs::rename(&written, &geometry).expect("renamed");
    let mut observer = Observer::join(&name);
    observer.health(Process::VirtualRig, |h| h.state == STATE_RUNNING);
    observer.health(Process::Simcore, |h| h.received > 0);
    rig.end();
    let recordings = std::fs::read_dir(folder.path().join("recordings")).expect("recordings");
    let recordings: Vec<_> = recordings.map(|r| text(&r.expect("entry").path())).collect();
    assert_eq!(recordings.len(), 1, "{recordings:?}");
    let info = vitreo(&["info", &recordings[0]]);
    assert!(info.stdout.contains("rig-cameras"), "{info:?}");
    assert!(!info.stdout.contains("expert") && !info.stdout.contains("surgeon"), "{info:?}");
}
