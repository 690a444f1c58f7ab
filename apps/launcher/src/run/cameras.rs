//! Real cameras: a program of the rig's maker that stands in place of the virtual rig
//! (`docs/camera-hardware.md`), and waiting until it is configured and there.

use super::options::RunArgs;
use crate::runtime::StopSignal;
use ipc::logging::{warn, with_causes};
use settings::inputs::check_file;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// Period of looking whether what was missing is there.
const LOOK: Duration = Duration::from_secs(1);
/// The same reason is logged again after so long.
const REMINDER: Duration = Duration::from_secs(600);

/// What is wanted where nothing is configured.
const NOT_CONFIGURED: &str = "no real cameras are configured: [run] of vitreo.toml needs \
    cameras = \"PROGRAM\" and rig = \"RIG.json\" (docs/install.md, \"A rig that starts at boot\"); \
    start again when it has them";

/// What is missing for a person to work with real cameras, in words; `None` where nothing is.
fn missing(cameras: Option<&Path>, rig: Option<&Path>) -> Option<String> {
    let (Some(program), Some(rig)) = (cameras, rig) else { return Some(NOT_CONFIGURED.into()) };
    let checked = check_program(program).and_then(|()| Ok(check_file("--rig", rig)?));
    checked.err().map(|problem| with_causes(problem.as_ref()))
}

/// Refuses a program that is absent or may not be run.
///
/// # Errors
/// Where it is so.
pub fn check_program(program: &Path) -> anyhow::Result<()> {
    check_file("--cameras", program)?;
    let mode = program.metadata()?.permissions().mode();
    anyhow::ensure!(mode & 0o111 != 0, "--cameras {}: not a program: it may not be run", program.display());
    Ok(())
}

/// Waits until real cameras are configured and there, and says what is missing. Returns false where
/// `stop` is raised first.
pub async fn wait(args: &RunArgs, stop: &StopSignal) -> bool {
    let mut told: Option<(String, Instant)> = None;
    while let Some(reason) = missing(args.real.cameras.as_deref(), args.rig.rig.as_deref()) {
        let known = told.as_ref().is_some_and(|(text, at)| *text == reason && at.elapsed() < REMINDER);
        if !known {
            warn(&format!("waiting, nobody works: {reason}"));
            told = Some((reason, Instant::now()));
        }
        tokio::select! {
            () = sleep(LOOK) => {}
            () = stop.raised() => return false,
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runtime::block_on;

    #[test]
    fn what_is_missing_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let (program, rig) = (folder.path().join("driver"), folder.path().join("rig.json"));
        let told = |cameras, rig| missing(cameras, rig).unwrap_or_default();
        for (cameras, rig) in [(None, None), (Some(&*program), None), (None, Some(&*rig))] {
            assert_eq!(told(cameras, rig), NOT_CONFIGURED);
        }
        let absent = told(Some(&program), Some(&rig));
        assert!(absent.contains("--cameras") && absent.contains("driver: No such file"), "{absent}");
        std::fs::write(&program, "#!/bin/sh\n").unwrap();
        assert!(told(Some(&program), Some(&rig)).contains("may not be run"));
        std::fs::set_permissions(&program, PermissionsExt::from_mode(0o755)).unwrap();
        assert!(told(Some(&program), Some(&rig)).contains("rig.json: No such file"));
        std::fs::write(&rig, "{}").unwrap();
        assert_eq!(missing(Some(&program), Some(&rig)), None);
    }

    #[test]
    fn waiting_ends_with_the_signal() {
        let began = block_on(async {
            let (raise, stop) = StopSignal::manual();
            raise.send_replace(true);
            Ok(wait(&RunArgs::default(), &stop).await)
        });
        assert!(!began.unwrap());
    }
}
