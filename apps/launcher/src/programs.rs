//! The programs behind `vitreo`, and the tables of vitreo.toml that belong to `vitreo` itself.

use settings::Program;

/// Software twin of the camera hardware.
pub const CAMERA: &str = "vitreo-fpga-model";
/// Local cameras, and pictures from pipes and files.
pub const STREAMS: &str = "vitreo-cameras";
/// A real pedal and real handles.
pub const CONTROLS: &str = "vitreo-controls";
/// Commissioning of a new rig.
pub const COMMISSION: &str = "vitreo-commission";
/// The renderer.
pub const RENDERER: &str = "vitreo-renderer";
/// Replay and analysis of recordings.
pub const REPLAY: &str = "vitreo-replay";
/// Exchange of poses with other programs.
pub const BRIDGE: &str = "vitreo-bridge";
/// The calibrations.
pub const CALIBRATION: &str = "vitreo-calibration";

/// The part of vitreo.toml that belongs to `vitreo`. Tables of commands of other programs are read by those
/// programs. The commands in `without` read no file, so that they work even if a file is invalid.
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
/// The programs that read the tables in `elsewhere` of [`SETTINGS`].
pub const WITH_SETTINGS: [&str; 6] = [CAMERA, CALIBRATION, COMMISSION, RENDERER, STREAMS, CONTROLS];
