//! Checks of the configured rig: its file, and the presence of its devices and this user's access to them.

use super::Check;
use super::devices::remedy;
use crate::cli::{Cli, Command};
use crate::machine::has_display;
use crate::programs::SETTINGS;
use crate::run::RunArgs;
use clap::{CommandFactory, FromArgMatches};
use outputs::shell_word;
use rig::Rig;
use rustix::fs::{Access, access};
use settings::Refusal;
use settings::apply::matches;
use settings::commands::cameras::{Cameras, Stream};
use settings::files::Files;
use std::path::Path;

/// Where the settings of a rig belong.
const WHERE: &str = "set it in [run] of /etc/vitreo/vitreo.toml (docs/install.md)";

/// Checks the rig that the settings of this machine configure, as `packaging/systemd/vitreo-rig.service` runs
/// it.
pub(super) fn checks() -> Vec<Check> {
    match run_of_settings(&Files::of_this_machine()) {
        Ok(run) => checks_of(&run, has_display(), &Screen::of_this_machine()),
        Err(problem) => {
            vec![Check::fail("settings", problem, "vitreo config shows all settings and their sources")]
        }
    }
}

/// The arguments that `vitreo run --unscripted` would get from the settings files.
fn run_of_settings(files: &Files) -> Result<RunArgs, String> {
    let typed = ["vitreo", "run", "--unscripted"].map(Into::into).to_vec();
    let parsed = matches(Cli::command(), &SETTINGS, files, typed).map_err(|refusal| match refusal {
        Refusal::CommandLine(error) => error.render().to_string().trim().to_owned(),
        Refusal::File(problem, _) => problem.to_string(),
    })?;
    match Cli::from_arg_matches(&parsed).map_err(|e| e.to_string())?.command {
        Command::Run(run) => Ok(*run),
        _ => Err("vitreo run was not understood".into()),
    }
}

/// What the service with a picture needs to show it.
#[derive(Debug, Default)]
struct Screen {
    /// Name of a connector of this machine with a connected display.
    connected: Option<String>,
    /// True if the compositor cage is installed.
    has_cage: bool,
}

impl Screen {
    fn of_this_machine() -> Self {
        Screen {
            connected: connected(Path::new("/sys/class/drm")),
            has_cage: Path::new("/usr/bin/cage").exists(),
        }
    }
}

/// The first connector with a connected display, in the order of names, in the folder `/sys/class/drm`.
fn connected(connectors: &Path) -> Option<String> {
    let entries = std::fs::read_dir(connectors).ok()?.flatten();
    let has_display = |folder: &std::fs::DirEntry| {
        std::fs::read_to_string(folder.path().join("status")).is_ok_and(|status| status.trim() == "connected")
    };
    entries.filter(has_display).map(|folder| folder.file_name().to_string_lossy().into_owned()).min()
}

fn checks_of(run: &RunArgs, display: bool, screen: &Screen) -> Vec<Check> {
    let (rig, loaded) = rig_file(run);
    let mut checks = vec![rig];
    checks.extend(cameras(run, loaded.as_ref()));
    checks.push(pedal(run));
    checks.push(handles(run, loaded.as_ref()));
    checks.push(picture(run, display, screen));
    checks
}

fn rig_file(run: &RunArgs) -> (Check, Option<Rig>) {
    const NAME: &str = "rig file";
    let Some(path) = &run.rig.rig else {
        let mend = format!("rig = \"/etc/vitreo/rig.json\": {WHERE}; vitreo commission makes one");
        return (Check::fail(NAME, "none is set", mend), None);
    };
    match Rig::load(path) {
        Ok(rig) => {
            let (cameras, rate) = (rig.cameras.len(), rig.field_hz);
            let found = format!("{}: {cameras} cameras at {rate} Hz", path.display());
            (Check::ok(NAME, found), Some(rig))
        }
        Err(problem) => (
            Check::fail(
                NAME,
                problem.to_string(),
                format!("vitreo rig check {}", shell_word(path.display())),
            ),
            None,
        ),
    }
}

/// Checks each source of `--cameras`, and that their number is that of the rig's cameras.
fn cameras(run: &RunArgs, rig: Option<&Rig>) -> Vec<Check> {
    const NAME: &str = "cameras of the rig";
    match run.real.given() {
        None if run.real.external.is_some() => {
            vec![Check::ok(NAME, "an external driver through libvitreo (--external)")]
        }
        None => {
            let mend = format!("cameras = \"v4l2:/dev/video0,v4l2:/dev/video1,…\": {WHERE}");
            vec![Check::fail(NAME, "none are set: the rig's service waits for them", mend)]
        }
        Some(Cameras::Program(program)) => vec![usable(NAME, program, Access::EXEC_OK)],
        Some(Cameras::Streams(streams)) => {
            let check = |s: &Stream| match s.kind.has_path() {
                true => usable(NAME, &s.path, Access::READ_OK),
                false => Check::ok(NAME, format!("{s}: `vitreo cameras --list` shows whether it answers")),
            };
            let mut checks: Vec<Check> = streams.0.iter().map(check).collect();
            let needed = rig.map_or(streams.0.len(), |rig| rig.cameras.len());
            if streams.spread(needed).len() != needed {
                let found = format!("{} are set, the rig has {needed}", streams.0.len());
                checks.push(Check::fail(NAME, found, "name one source for each camera, in the rig's order"));
            }
            checks
        }
        Some(Cameras::Virtual) => vec![Check::ok(NAME, "virtual")],
    }
}

fn pedal(run: &RunArgs) -> Check {
    const NAME: &str = "pedal of the rig";
    match &run.controls.pedal {
        Some(pedal) => usable(NAME, &pedal.path, Access::READ_OK),
        None => Check::warn(
            NAME,
            "none is set: the pedal stays up, so nothing cuts or aspirates",
            format!("pedal = \"evdev:/dev/input/…\": {WHERE}; vitreo pedal learns one"),
        ),
    }
}

fn handles(run: &RunArgs, rig: Option<&Rig>) -> Check {
    const NAME: &str = "handles of the rig";
    let Some(handles) = &run.controls.handles else {
        return Check::warn(
            NAME,
            "none are set: jaws stay open",
            format!("handles = \"serial:/dev/ttyUSB0\": {WHERE}; vitreo handles shows what they send"),
        );
    };
    if rig.is_some_and(|rig| rig.handles.is_empty()) {
        let mend = "vitreo handles --calibrate writes them into the rig's file (docs/handles.md)";
        return Check::fail(NAME, "the rig file has no calibration of the jaws", mend);
    }
    usable(NAME, &handles.path, Access::READ_OK)
}

fn picture(run: &RunArgs, display: bool, screen: &Screen) -> Check {
    const NAME: &str = "picture of the rig";
    let view = &run.view;
    if view.no_picture || view.headless {
        return Check::ok(NAME, "without a window, as configured");
    }
    match (display, view.window || view.picture.full_screen) {
        (true, _) => Check::ok(NAME, "in a window of this user's display"),
        (false, true) => Check::fail(NAME, "a window is configured, but this user has no display", DISPLAY),
        (false, false) => on_the_machine(NAME, screen),
    }
}

/// Checks what the service with a picture needs, if this user has no display.
fn on_the_machine(name: &'static str, screen: &Screen) -> Check {
    let Some(connector) = &screen.connected else {
        let found =
            "this user has no display, and none is connected to this machine: drawing without a window";
        return Check::warn(name, found, DISPLAY);
    };
    if screen.has_cage {
        return Check::ok(name, format!("{connector}: the service vitreo-rig-display shows it there"));
    }
    let found = format!("{connector}: vitreo-rig-display needs cage, which is not installed");
    Check::warn(name, found, "sudo apt-get install cage xwayland")
}

/// Advice for a rig without a display.
const DISPLAY: &str = "run it in the session of the machine's display (docs/install.md)";

/// Checks that a device, pipe or program exists and that this user has access to it.
fn usable(name: &'static str, path: &Path, wanted: Access) -> Check {
    let shown = path.display();
    if !path.exists() {
        return Check::fail(name, format!("{shown} does not exist"), "connect it, or name another");
    }
    match access(path, wanted) {
        Ok(()) => Check::ok(name, shown.to_string()),
        Err(_) => Check::fail(name, format!("{shown}: this user has no access"), remedy(path)),
    }
}

#[cfg(test)]
mod tests;
