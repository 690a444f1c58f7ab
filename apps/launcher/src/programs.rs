//! The programs behind `vitreo`, and the tables of vitreo.toml that belong to this one.

use settings::Program;

/// The binary of the camera hardware.
pub const CAMERA: &str = "vitreo-fpga-model";
/// The binary of cameras of this machine, and of pictures through pipes and from files.
pub const STREAMS: &str = "vitreo-cameras";
/// The binary of a real pedal and real handles.
pub const CONTROLS: &str = "vitreo-controls";
/// The binary that takes a new rig into use.
pub const COMMISSION: &str = "vitreo-commission";
/// The binary of the picture.
pub const RENDERER: &str = "vitreo-renderer";
/// The binary of recordings that are run again.
pub const REPLAY: &str = "vitreo-replay";
/// The binary that hands poses on to other programs.
pub const BRIDGE: &str = "vitreo-bridge";
/// The binary of the calibrations.
pub const CALIBRATION: &str = "vitreo-calibration";

/// This program's part of vitreo.toml. Tables of commands that belong to other programs are read there;
/// commands that help to mend a file do without.
pub const SETTINGS: Program = Program {
    prefix: "",
    without: &["config", "completions", "man"],
    elsewhere: Some(&[
        "blobs",
        "colours",
        "hardware",
        "vectors",
        "calibrate",
        "commission",
        "bench",
        "cameras",
        "pedal",
        "handles",
    ]),
};
/// The programs of [`SETTINGS`]' tables elsewhere.
pub const WITH_SETTINGS: [&str; 6] = [CAMERA, CALIBRATION, COMMISSION, RENDERER, STREAMS, CONTROLS];
