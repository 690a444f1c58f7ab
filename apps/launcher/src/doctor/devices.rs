//! Checks for cameras, gamepads, pedals and serial ports, and for this user's access to them.

use super::Check;
use outputs::shell_word;
use rustix::fs::{Access, access};
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Lowest key code of a gamepad button (`BTN_SOUTH` of Linux), which identifies gamepads.
const BTN_SOUTH: usize = 0x130;

pub(super) fn checks() -> Vec<Check> {
    let listed = fs::read_to_string("/proc/bus/input/devices").unwrap_or_default();
    let look = |(name, event): (String, String)| {
        Device::look(Path::new("/dev/input").join(event), name, Access::READ_OK)
    };
    let [gamepads, pedals] =
        [gamepads_of(&listed), pedals_of(&listed)].map(|found| found.into_iter().map(look));
    vec![
        judge(
            "cameras",
            "none found (vitreo blobs also reads pictures and clips)",
            &cameras(Path::new("/dev"), Path::new("/sys/class/video4linux")),
        ),
        judge("gamepads", "none found (use mouse and keyboard)", &gamepads.collect::<Vec<_>>()),
        judge(
            "pedals",
            "none recognised by name: vitreo pedal shows any device (docs/controls.md)",
            &pedals.collect::<Vec<_>>(),
        ),
        judge(
            "serial lines",
            "none: handles are not connected (docs/handles.md)",
            &serial_lines(Path::new("/dev")),
        ),
    ]
}

/// A device, and this user's access to it.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Device {
    path: PathBuf,
    name: String,
    /// Command that gives this user access; `None` if the user has access.
    mend: Option<String>,
}

impl Device {
    fn look(path: PathBuf, name: String, wanted: Access) -> Self {
        let mend = access(&path, wanted).err().map(|_| remedy(&path));
        Device { path, name, mend }
    }
}

/// Command that gives this user access to a device: membership in its group if the group may read it, else
/// ownership.
pub(super) fn remedy(path: &Path) -> String {
    let about = fs::metadata(path).ok();
    let groups = fs::read_to_string("/etc/group").unwrap_or_default();
    let group =
        about.filter(|m| m.gid() > 0 && m.mode() & 0o040 != 0).and_then(|m| name_of(&groups, m.gid()));
    match group {
        Some(group) => format!("sudo usermod -aG {group} $USER   (then log in again)"),
        None => format!("sudo chown $USER {}   (until the next start)", shell_word(path.display())),
    }
}

/// Name of the group with this id in the text of `/etc/group`.
fn name_of(groups: &str, gid: u32) -> Option<String> {
    let fields = groups.lines().map(|l| l.split(':').collect::<Vec<_>>());
    let mut own = fields.filter(|f| f.get(2).is_some_and(|id| *id == gid.to_string()));
    own.next().map(|f| f[0].to_owned())
}

/// The cameras of this machine, with the names that their drivers report.
fn cameras(dev: &Path, drivers: &Path) -> Vec<Device> {
    let entries = fs::read_dir(dev).into_iter().flatten().flatten();
    let names = entries.map(|e| e.file_name().to_string_lossy().into_owned());
    let is_camera = |n: &String| n.strip_prefix("video").is_some_and(|n| n.parse::<u32>().is_ok());
    let mut names: Vec<String> = names.filter(is_camera).collect();
    names.sort_by_key(|n| (n.len(), n.clone()));
    let look = |name: String| {
        let title = fs::read_to_string(drivers.join(&name).join("name")).unwrap_or_default();
        Device::look(dev.join(name), title.trim().to_owned(), Access::READ_OK | Access::WRITE_OK)
    };
    names.into_iter().map(look).collect()
}

/// The USB serial ports.
fn serial_lines(dev: &Path) -> Vec<Device> {
    let entries = fs::read_dir(dev).into_iter().flatten().flatten();
    let names = entries.map(|e| e.file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> =
        names.filter(|n| n.starts_with("ttyUSB") || n.starts_with("ttyACM")).collect();
    names.sort_by_key(|n| (n.len(), n.clone()));
    names.into_iter().map(|name| Device::look(dev.join(&name), "serial".into(), Access::READ_OK)).collect()
}

/// Names and event files of devices whose name suggests a pedal or foot switch.
fn pedals_of(listed: &str) -> Vec<(String, String)> {
    devices_of(listed, |name, _| {
        let name = name.to_lowercase();
        name.contains("pedal") || name.contains("foot")
    })
}

/// Names and event files of the gamepads listed in `/proc/bus/input/devices`.
fn gamepads_of(listed: &str) -> Vec<(String, String)> {
    devices_of(listed, |_, keys| has_key(keys, BTN_SOUTH))
}

/// Names and event files of the devices in `/proc/bus/input/devices` for whose name and key bits `wanted` is
/// true.
fn devices_of(listed: &str, wanted: impl Fn(&str, &str) -> bool) -> Vec<(String, String)> {
    let line = |block: &str, key: &str| {
        block.lines().find_map(|l| l.strip_prefix(key).map(|l| l.trim().trim_matches('"').to_owned()))
    };
    let of_block = |block: &str| {
        let keys = line(block, "B: KEY=").unwrap_or_default();
        let name = line(block, "N: Name=").unwrap_or_default();
        let handlers = line(block, "H: Handlers=")?;
        let event = handlers.split_whitespace().find(|h| h.starts_with("event"))?.to_owned();
        wanted(&name, &keys).then_some((name, event))
    };
    listed.split("\n\n").filter_map(of_block).collect()
}

/// True if bit `key` is set in hexadecimal words of 64 bits, most significant word first.
fn has_key(words: &str, key: usize) -> bool {
    let word = words.split_whitespace().rev().nth(key / 64);
    word.and_then(|w| u64::from_str_radix(w, 16).ok()).is_some_and(|w| w >> (key % 64) & 1 == 1)
}

fn judge(what: &'static str, none: &str, devices: &[Device]) -> Check {
    if devices.is_empty() {
        return Check::ok(what, none);
    }
    let title = |d: &Device| {
        let closed = if d.mend.is_some() { ", no access for this user" } else { "" };
        format!("{} ({}{closed})", d.path.display(), d.name)
    };
    let found = devices.iter().map(title).collect::<Vec<_>>().join(", ");
    match devices.iter().find_map(|d| d.mend.clone()) {
        Some(mend) => Check::warn(what, found, mend),
        None => Check::ok(what, found),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::State;

    const LISTED: &str = "I: Bus=0011 Vendor=0001 Product=0001 Version=ab41
N: Name=\"AT Translated Set 2 keyboard\"
H: Handlers=sysrq kbd event0 leds
B: KEY=402000000 3803078f800d001 feffffdfffefffff fffffffffffffffe

I: Bus=0003 Vendor=045e Product=028e Version=0114
N: Name=\"Microsoft X-Box 360 pad\"
H: Handlers=event7 js0
B: EV=20000b
B: KEY=7cdb000000000000 0 0 0 0
";

    #[test]
    fn a_gamepad_is_told_from_a_keyboard_by_its_buttons() {
        assert_eq!(gamepads_of(LISTED), [("Microsoft X-Box 360 pad".to_owned(), "event7".to_owned())]);
        assert!(gamepads_of("").is_empty() && gamepads_of("N: Name=\n\nB: KEY=zz").is_empty());
    }

    #[test]
    fn pedals_are_known_by_their_names_and_serial_lines_by_their_files() {
        let switch = "N: Name=\"PCsensor FootSwitch Keyboard\"\nH: Handlers=kbd event9\n\nN: Name=\"Rudder Pedals\"\n\
                      H: Handlers=js1 event11\nB: EV=9\n";
        let found = pedals_of(&format!("{LISTED}\n{switch}"));
        let events: Vec<&str> = found.iter().map(|(_, event)| event.as_str()).collect();
        assert_eq!(events, ["event9", "event11"]);
        let folder = tempfile::tempdir().unwrap();
        for name in ["ttyUSB10", "ttyUSB2", "ttyACM0", "tty7", "ttyS0"] {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let lines = serial_lines(folder.path());
        let names: Vec<_> = lines.iter().map(|l| l.path.file_name().unwrap().to_string_lossy()).collect();
        assert_eq!(names, ["ttyACM0", "ttyUSB2", "ttyUSB10"]);
    }

    #[test]
    fn cameras_have_the_names_of_their_drivers() {
        let folder = tempfile::tempdir().unwrap();
        let (dev, drivers) = (folder.path().join("dev"), folder.path().join("sys"));
        for (file, text) in
            [("dev/video10", ""), ("dev/video2", ""), ("dev/vide", ""), ("sys/video2/name", "Cam\n")]
        {
            let path = folder.path().join(file);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        let found = cameras(&dev, &drivers);
        assert_eq!(found.iter().map(|d| d.name.as_str()).collect::<Vec<_>>(), ["Cam", ""]);
        assert!(found[1].path.ends_with("video10") && found.iter().all(|d| d.mend.is_none()), "{found:?}");
    }

    #[test]
    fn what_is_closed_to_this_user_has_a_remedy() {
        let groups = "root:x:0:\nvideo:x:44:ann\ninput:x:104:\n";
        assert_eq!(name_of(groups, 44).as_deref(), Some("video"));
        assert_eq!(name_of(groups, 7), None);
        let open = Device { path: "/dev/video0".into(), name: "Cam".into(), mend: None };
        let closed = Device { mend: Some("sudo usermod -aG video $USER".into()), ..open.clone() };
        let check = judge("cameras", "none", &[open.clone(), closed]);
        assert_eq!(check.state, State::Warn);
        assert!(
            check.mend.unwrap().contains("usermod -aG video")
                && check.found.contains("no access for this user")
        );
        assert_eq!(judge("cameras", "none", &[open]).found, "/dev/video0 (Cam)");
        assert_eq!(judge("cameras", "none", &[]).found, "none");
        assert!(remedy(Path::new("/nowhere")).contains("chown $USER /nowhere"));
    }
}
