//! Real cameras in place of the virtual rig, driven by the user's own program (`docs/camera-hardware.md`) or
//! read as streams of pictures (`docs/cameras.md`). Checks that they exist, and waits for them.

use super::options::{RealCamerasArgs, RunArgs};
use super::recorded_rig;
use crate::exit::WrongUse;
use crate::runtime::StopSignal;
use anyhow::Context;
use ipc::logging::{warn, with_causes};
use rig::Rig;
use settings::commands::cameras::{Cameras, StreamKind, Streams};
use settings::inputs::check_file;
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::path::Path;
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// Period of the checks for missing sources.
const LOOK: Duration = Duration::from_secs(1);
/// Period of the log messages while the same source is missing.
const REMINDER: Duration = Duration::from_secs(600);

/// Message if no real cameras are configured.
const NOT_CONFIGURED: &str = "no real cameras are configured: [run] of vitreo.toml needs \
    cameras = \"PROGRAM\", \"v4l2:/dev/video0,...\", \"genicam:NAME,...\" or \"y4m:PATH,...\" and rig = \"RIG.json\" (docs/install.md, \"A rig that starts at \
    boot\"); \
    start again when it has them";

/// What is missing for a run with real cameras, as text; `None` if nothing is.
fn missing(cameras: Option<&Cameras>, rig: Option<&Path>) -> Option<String> {
    let (Some(cameras), Some(rig)) = (cameras, rig) else { return Some(NOT_CONFIGURED.into()) };
    let there = match cameras {
        Cameras::Virtual => return Some(NOT_CONFIGURED.into()),
        Cameras::Program(program) => check_program(program),
        Cameras::Streams(streams) => check_sources(streams),
    };
    let checked = there.and_then(|()| Ok(check_file("--rig", rig)?));
    checked.err().map(|problem| with_causes(problem.as_ref()))
}

/// Checks that the sources of the cameras exist and fit the rig.
///
/// # Errors
/// If the rig, the program or a source is missing, the number of sources differs from that of the rig's
/// cameras, a source is of the wrong kind, `--direct` is used with streams, or a recording does not fit the
/// rig.
pub fn check(real: &RealCamerasArgs, rig: Option<&Path>, direct: bool) -> anyhow::Result<()> {
    if let Some(program) = real.program() {
        check_program(program)?;
    }
    if real.given().is_some() && rig.is_none() {
        let problem = "--cameras: expected the rig of these cameras, --rig RIG.json (only a recording, mcap:FILE, contains its own)";
        return Err(WrongUse(problem.into()).into());
    }
    let Some(streams) = real.streams() else { return Ok(()) };
    if direct {
        let problem = "--direct: y4m:, mcap:, v4l2: and genicam: deliver pictures, in which the camera hardware detects blobs; omit --direct";
        return Err(WrongUse(problem.into()).into());
    }
    let rig = Rig::load_or_shipped(rig).context("--rig")?;
    let cameras = rig.cameras.len();
    let sources = streams.spread(cameras).len();
    if sources != cameras {
        let problem = format!(
            "--cameras: expected {cameras} sources, one y4m:PATH, v4l2:/dev/videoN or genicam:NAME for each camera of the rig in its order, or one mcap:FILE, found {sources}"
        );
        return Err(WrongUse(problem).into());
    }
    check_sources(streams)?;
    recorded_rig::check(streams, &rig)
}

/// Checks that each source with a path exists and is of the expected kind. Sources are not opened: the writer
/// of a pipe may start later, and a device must be opened by the process that reads it.
pub(super) fn check_sources(streams: &Streams) -> anyhow::Result<()> {
    for stream in streams.0.iter().filter(|stream| stream.kind.has_path()) {
        let path = &stream.path;
        check_file("--cameras", path)?;
        let kind = path.metadata()?.file_type();
        let (fits, expected) = match stream.kind {
            StreamKind::Y4m => (kind.is_fifo() || kind.is_file(), "expected a pipe (mkfifo) or a file"),
            StreamKind::Mcap => (kind.is_file(), "expected a file of `vitreo cameras --record-fields`"),
            StreamKind::V4l2 | StreamKind::Genicam => {
                (kind.is_char_device(), "expected a device (`vitreo cameras --list` lists them)")
            }
        };
        anyhow::ensure!(fits, "--cameras {}: {expected}", path.display());
    }
    Ok(())
}

/// Checks that a program exists and is executable.
fn check_program(program: &Path) -> anyhow::Result<()> {
    check_file("--cameras", program)?;
    let mode = program.metadata()?.permissions().mode();
    anyhow::ensure!(mode & 0o111 != 0, "--cameras {}: not an executable program", program.display());
    Ok(())
}

/// Waits until real cameras are configured and connected, and logs what is missing. Returns false if `stop`
/// is raised first.
pub async fn wait(args: &RunArgs, stop: &StopSignal) -> bool {
    let mut reported: Option<(String, Instant)> = None;
    while let Some(reason) = missing(args.real.cameras.as_ref(), args.rig.rig.as_deref()) {
        let known = reported.as_ref().is_some_and(|(text, at)| *text == reason && at.elapsed() < REMINDER);
        if !known {
            warn(&format!("waiting to start: {reason}"));
            reported = Some((reason, Instant::now()));
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
        let driver = Cameras::Program(program.clone());
        for (cameras, rig) in
            [(None, None), (Some(&driver), None), (None, Some(&*rig)), (Some(&Cameras::Virtual), Some(&rig))]
        {
            assert_eq!(told(cameras, rig), NOT_CONFIGURED);
        }
        let absent = told(Some(&driver), Some(&rig));
        assert!(absent.contains("--cameras") && absent.contains("driver: No such file"), "{absent}");
        std::fs::write(&program, "#!/bin/sh\n").unwrap();
        assert!(told(Some(&driver), Some(&rig)).contains("not an executable"));
        std::fs::set_permissions(&program, PermissionsExt::from_mode(0o755)).unwrap();
        assert!(told(Some(&driver), Some(&rig)).contains("rig.json: No such file"));
        std::fs::write(&rig, "{}").unwrap();
        assert_eq!(missing(Some(&driver), Some(&rig)), None);
    }

    #[test]
    fn sources_that_do_not_fit_the_rig_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).display().to_string();
        let rig = folder.path().join("rig.json");
        std::fs::write(&rig, Rig::load_or_shipped(None).unwrap().to_json()).unwrap();
        let refused = |cameras: &str, direct| {
            let real =
                RealCamerasArgs { cameras: Some(cameras.parse().unwrap()), ..RealCamerasArgs::default() };
            check(&real, Some(&rig), direct).err().map(|e| (with_causes(e.as_ref()), e.is::<WrongUse>()))
        };
        std::fs::write(path("a"), "").unwrap();
        let without =
            RealCamerasArgs { cameras: Some("y4m:a".parse().unwrap()), ..RealCamerasArgs::default() };
        assert!(check(&without, None, false).unwrap_err().to_string().contains("--rig RIG.json"));
        let [a, b] = ["a", "b"].map(|name| format!("y4m:{}", path(name)));
        assert_eq!(refused(&format!("{a},{a},{a}?parity=1"), false), None);
        // Whether a network camera exists is known only after a query, so it is not checked.
        assert_eq!(refused(&format!("{a},{a},genicam:10.0.0.7"), false), None);
        let cases = [
            (
                format!("{a},{a}"),
                false,
                "expected 3 sources, one y4m:PATH, v4l2:/dev/videoN or genicam:NAME for each camera",
                true,
            ),
            ([&*a; 9].join(","), false, "found 9", true),
            (format!("{a},{a},{a}"), true, "omit --direct", true),
            (format!("{a},{b},{a}"), false, "/b: No such file", false),
            (format!("{a},{a},y4m:/dev/null"), false, "/dev/null: expected a pipe (mkfifo) or a file", false),
            (format!("{a},{a},v4l2:{}", path("a")), false, "/a: expected a device", false),
            (format!("{a},{a},v4l2:/dev/no-video"), false, "/dev/no-video: No such file", false),
        ];
        for (cameras, direct, named, wrong_use) in cases {
            let (told, is_wrong_use) = refused(&cameras, direct).expect("refused");
            assert!(told.contains(named) && is_wrong_use == wrong_use, "{cameras}: {told}");
        }
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
