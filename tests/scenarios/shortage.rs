//! Too little shared memory: refused at the start, and no matter to a run that has begun. Each check
//! has a `/dev/shm` of its own, in a namespace of its own.

use std::process::{Command, Output};
use vitreo_tests::{binaries, instance_name, repository};

/// Runs a shell script with `vitreo` in `$0`, an instance name in `$1` and a `/dev/shm` of so many
/// MiB; `None` where this user may not make one.
fn with_shared_memory(mib: u32, script: &str) -> Option<Output> {
    let mount = format!("mount -t tmpfs -o size={mib}m tmpfs /dev/shm");
    let run = |script: &str| {
        let mut command = Command::new("unshare");
        command.args(["--user", "--map-root-user", "--mount", "sh", "-c", script]);
        command.arg(binaries().join("vitreo")).arg(instance_name()).current_dir(repository());
        command.output().ok()
    };
    if !run(&mount).is_some_and(|tried| tried.status.success()) {
        skips::skip(&"no namespace with a /dev/shm of its own");
        return None;
    }
    run(&format!("{mount} && {script}"))
}

#[test]
fn too_little_is_refused_with_figures_and_a_remedy() {
    let script = r#""$0" run --no-picture --direct --duration 2 --instance "$1""#;
    let Some(refused) = with_shared_memory(64, script) else { return };
    let told = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(1), "{told}");
    for word in ["63 MiB free", "96 MiB are needed", "--shm-size"] {
        assert!(told.contains(word), "{word}: {told}");
    }
}

#[test]
fn a_run_has_all_it_needs_when_somebody_fills_the_rest() {
    let script = r#"
        "$0" run --no-picture --direct --duration 6 --instance "$1" &
        run=$!
        until [ -e /dev/shm/vitreo-*-"$1"/virtual-rig.time ]; do sleep 0.05; done
        sleep 1
        head -c 1G /dev/zero > /dev/shm/filled 2> /dev/null
        wait $run"#;
    let Some(run) = with_shared_memory(100, script) else { return };
    let told = String::from_utf8_lossy(&run.stderr).into_owned();
    assert_eq!(run.status.code(), Some(0), "{told}");
    assert!(!told.contains("restarted"), "{told}");
}

#[test]
fn a_shortage_that_passes_is_survived() {
    // The memory of the dead tracker is taken by somebody else until its third restart.
    let script = r#"
        "$0" run --no-picture --direct --duration 9 --instance "$1" 2> /dev/shm/told &
        run=$!
        until [ -e /dev/shm/vitreo-*-"$1"/virtual-rig.time ]; do sleep 0.05; done
        sleep 1
        head -c 1G /dev/zero > /dev/shm/filled 2> /dev/null
        kill -KILL "$(pgrep -f "vitreo-tracker --instance $1 ")"
        until [ "$(grep -c 'tracker restarted' /dev/shm/told)" -ge 3 ]; do
            head -c 1G /dev/zero >> /dev/shm/filled 2> /dev/null; sleep 0.01
        done
        rm /dev/shm/filled
        wait $run; code=$?
        cat /dev/shm/told >&2
        exit $code"#;
    let Some(run) = with_shared_memory(100, script) else { return };
    let told = String::from_utf8_lossy(&run.stderr).into_owned();
    assert_eq!(run.status.code(), Some(0), "{told}");
    assert!(told.contains("MiB are needed"), "{told}");
}
