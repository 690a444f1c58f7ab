//! `vitreo cameras --list`: the cameras of this machine, their modes, and what can be set.

use crate::device::settings::Meaning;
use crate::device::v4l2::controls;
use anyhow::{Context, Result};
use fpga_model::input::packed::Packing;
use linuxvideo::format::{FrameSizes, PixelFormat};
use linuxvideo::{BufType, BufTypes, Device};

/// Text shown without any camera.
pub const NONE: &str = "no cameras: this machine has no /dev/video* that takes pictures";

/// Lists them.
///
/// # Errors
/// Where the devices of the machine cannot be listed.
pub fn run() -> Result<()> {
    let mut count = 0;
    for device in linuxvideo::list().context("/dev")? {
        // A device that may not be opened is reported; one that is not a camera is skipped.
        match device {
            Err(problem) => outputs::println!("a device cannot be opened: {problem}"),
            Ok(device) if device.supported_buf_types().contains(BufTypes::VIDEO_CAPTURE) => {
                show(&device);
                count += 1;
            }
            Ok(_) => {}
        }
    }
    #[cfg(feature = "genicam")]
    {
        count += list_genicam();
    }
    if count == 0 {
        outputs::println!("{NONE}");
    }
    #[cfg(not(feature = "genicam"))]
    outputs::println!("GenICam cameras are not listed: {}", crate::process::feed::NO_GENICAM);
    Ok(())
}

/// Lists the GenICam cameras, and returns how many there are.
#[cfg(feature = "genicam")]
fn list_genicam() -> usize {
    use crate::device::genicam::{found, modes};
    let all = found();
    for camera in &all {
        let about = format!("genicam:{}  {} at {}", camera.name, camera.about, camera.address);
        outputs::println!("{}", outputs::printable(&about));
        match modes(&camera.name) {
            Ok(lines) => lines.iter().for_each(|line| outputs::println!("  {}", outputs::printable(line))),
            Err(problem) => outputs::println!("  {}", outputs::printable(&format!("{problem:#}"))),
        }
    }
    all.len()
}

fn show(device: &Device) {
    let path = device.path().map_or_else(|_| "?".into(), |path| path.display().to_string());
    let about = device.capabilities();
    let name =
        about.as_ref().map_or(String::new(), |c| format!("{} ({}, {})", c.card(), c.driver(), c.bus_info()));
    outputs::println!("v4l2:{path}  {}", outputs::printable(&name));
    for format in device.formats(BufType::VIDEO_CAPTURE).filter_map(Result::ok) {
        let letters = format.pixel_format().as_fourcc();
        let word = String::from_utf8_lossy(&letters).trim().to_owned();
        let use_ = if Packing::of_fourcc(letters).is_some() { "" } else { "  (not understood)" };
        outputs::println!("  {}{use_}: {}", outputs::printable(&word), sizes(device, format.pixel_format()));
    }
    let settable = controls(device).into_iter().filter_map(|(_, c)| {
        let range = format!("{} to {}", c.minimum, c.maximum);
        match c.meaning {
            Some(Meaning::Exposure) => {
                Some(format!("exposure_us={} to {}", i64::from(c.minimum) * 100, i64::from(c.maximum) * 100))
            }
            Some(Meaning::Gain) => Some(format!("gain={range}")),
            _ if c.name.to_lowercase().contains("trigger mode") => {
                Some("trigger=internal or external".into())
            }
            _ => None,
        }
    });
    let settable: Vec<String> = settable.collect();
    if !settable.is_empty() {
        outputs::println!("  can be set: {}", settable.join(", "));
    }
}

/// Sizes of a format, and the highest rate of each.
fn sizes(device: &Device, format: PixelFormat) -> String {
    let rate = |width, height| {
        let fastest = device.frame_intervals(format, width, height).ok().map(|all| all.min());
        let hz = fastest
            .filter(|f| f.numerator() > 0)
            .map(|f| f64::from(f.denominator()) / f64::from(f.numerator()));
        hz.map_or(String::new(), |hz| format!(" to {hz:.0} Hz"))
    };
    match device.frame_sizes(format) {
        Ok(FrameSizes::Discrete(all)) => {
            let one = |s: &linuxvideo::format::DiscreteFrameSize| {
                format!("{}×{}{}", s.width(), s.height(), rate(s.width(), s.height()))
            };
            all.iter().map(one).collect::<Vec<_>>().join(", ")
        }
        Ok(all) => {
            let [low, high] = [[all.min_width(), all.min_height()], [all.max_width(), all.max_height()]];
            format!("{}×{} to {}×{}{}", low[0], low[1], high[0], high[1], rate(high[0], high[1]))
        }
        Err(_) => "sizes unknown".into(),
    }
}
