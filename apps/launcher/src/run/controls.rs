//! A real pedal and real handles (`docs/controls.md`): checks, channels that they replace, and figures.

use super::options::RunArgs;
use crate::exit::WrongUse;
use anyhow::{Context, ensure};
use outputs::shell_word;
use protocol::controls::{CONTROLS_FILE, ControlFigures};
use protocol::file::{MAX_SETTINGS_BYTES, read_text};
use protocol::handles::ControlChannels;
use rig::Rig;
use settings::commands::external::External;
use settings::inputs::check_file;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

/// Channels that real devices and external drivers write instead of the rig; `None` if there are none.
pub fn left(args: &RunArgs) -> Option<ControlChannels> {
    let outside = args.real.external.as_ref().and_then(External::controls).unwrap_or_default();
    let handles = outside.handles || args.controls.handles.is_some();
    let pedal = outside.pedal || args.controls.pedal.is_some();
    (handles || pedal).then_some(ControlChannels { handles, pedal })
}

/// Checks that pedal and handles exist, that only one source writes each channel, and that the rig has a
/// calibration of the handles.
///
/// # Errors
/// If a device or file is missing, a channel has two sources, or the rig has no section `handles`.
pub fn check(args: &RunArgs) -> anyhow::Result<()> {
    if args.controls.any() && args.real.program().is_some() {
        let problem =
            "--pedal, --handles: a program that drives cameras (--cameras PROGRAM) publishes both itself";
        return Err(WrongUse(problem.into()).into());
    }
    let outside = args.real.external.as_ref().and_then(External::controls).unwrap_or_default();
    let twice = [
        ("pedal", outside.pedal && args.controls.pedal.is_some()),
        ("handles", outside.handles && args.controls.handles.is_some()),
    ];
    if let Some((channel, _)) = twice.into_iter().find(|(_, is_so)| *is_so) {
        let problem =
            format!("--{channel}, --external {channel}: only one of them can send the channel {channel}");
        return Err(WrongUse(problem).into());
    }
    if let Some(pedal) = &args.controls.pedal {
        check_device("--pedal", &pedal.path)?;
        let file = pedal.mapping.as_deref().filter(|name| name.ends_with(".toml") || name.contains('/'));
        file.map_or(Ok(()), |file| check_file("--pedal", Path::new(file)))?;
    }
    let Some(handles) = &args.controls.handles else { return Ok(()) };
    check_device("--handles", &handles.path)?;
    if Rig::load_or_shipped(args.rig.rig.as_deref()).context("--rig")?.handles.is_empty() {
        let how = format!("vitreo handles {} --calibrate RIG.json -o NEW.json", shell_word(handles));
        let problem =
            format!("--handles: the rig has no section handles, the calibration of the jaws: {how}");
        return Err(WrongUse(problem).into());
    }
    Ok(())
}

/// Checks that the path is a device, pipe or file. It is not opened, because the writer of a pipe may start
/// later.
fn check_device(option: &str, path: &Path) -> anyhow::Result<()> {
    check_file(option, path)?;
    let kind = path.metadata()?.file_type();
    let fits = kind.is_char_device() || kind.is_fifo() || kind.is_file();
    ensure!(fits, "{option} {}: expected a device or a pipe", path.display());
    Ok(())
}

/// Figures of the devices, as left by their process; empty without devices.
pub fn figures(args: &RunArgs, directory: &Path) -> Vec<ControlFigures> {
    let left = args.controls.any().then(|| read_text(&directory.join(CONTROLS_FILE), MAX_SETTINGS_BYTES));
    let left = left.and_then(Result::ok).and_then(|text| serde_json::from_str(&text).ok());
    left.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc::logging::with_causes;
    use settings::commands::controls::ControlsArgs;

    #[test]
    fn devices_that_cannot_be_are_refused_in_words() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).display().to_string();
        std::fs::write(path("f"), "").unwrap();
        let refused = |pedal: Option<String>, handles: Option<String>| {
            let (pedal, handles) = (pedal.map(|s| s.parse().unwrap()), handles.map(|s| s.parse().unwrap()));
            let args = RunArgs { controls: ControlsArgs { pedal, handles }, ..RunArgs::default() };
            check(&args).err().map_or_else(String::new, |e| with_causes(e.as_ref()))
        };
        let pedal = |spec: &str| refused(Some(spec.replace("DIR", folder.path().to_str().unwrap())), None);
        assert_eq!(pedal("evdev:DIR/f,keyboard-switch"), "");
        assert!(pedal("evdev:DIR/no,keyboard-switch").contains("--pedal"));
        assert!(pedal("evdev:DIR,keyboard-switch").contains("found a folder"));
        assert!(pedal("evdev:DIR/f,DIR/no.toml").contains("no.toml: No such file"));
        let told = refused(None, Some(format!("serial:{}", path("f"))));
        assert!(told.contains("no section handles") && told.contains("--calibrate"), "{told}");
        let mut args = RunArgs {
            controls: ControlsArgs { pedal: Some("evdev:f,keyboard-switch".parse().unwrap()), handles: None },
            ..RunArgs::default()
        };
        args.real.external = Some("blobs,handles".parse().unwrap());
        assert_eq!(left(&args), Some(ControlChannels { handles: true, pedal: true }));
        args.real.external = Some("pedal".parse().unwrap());
        assert!(check(&args).unwrap_err().to_string().contains("--pedal, --external pedal: only one"));
        assert!(figures(&RunArgs::default(), folder.path()).is_empty());
    }
}
