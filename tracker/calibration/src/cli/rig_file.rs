//! `vitreo rig check`: what is in a rig file, what its cameras see, and what is missing.

use crate::rig_view::confused;
use crate::rig_view::picture::Maps;
use crate::rig_view::{CameraView, RigView, Viewer};
use ipc::logging::inform;
use outputs::{Force, Outputs, print, println};
use plots::Format;
use rig::Rig;
use rig::sensor::{Sensor, Shutter};
use std::fmt::Write;
use std::path::PathBuf;
use std::process::ExitCode;

/// Check a rig file.
#[derive(Debug, Clone, clap::Args)]
pub struct RigFileArgs {
    /// What to do.
    #[command(subcommand)]
    pub task: RigTask,
}

/// What there is to do with a rig file.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum RigTask {
    /// Check how much of the workspace the cameras cover and how accurately they measure tips there; exit code 5 if either
    /// is not enough.
    Check(CheckArgs),
}

/// `vitreo rig check`.
#[derive(Debug, Clone, clap::Args)]
pub struct CheckArgs {
    /// The rig file.
    #[arg(value_name = "RIG.json")]
    pub file: PathBuf,
    /// Draw maps of the accuracy of tips as PNG or SVG.
    #[arg(long, value_name = "FILE.png")]
    pub picture: Option<PathBuf>,
    /// Print the findings as JSON.
    #[arg(long)]
    pub json: bool,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
}

impl RigFileArgs {
    /// Refuses to write over the rig, or over what is there, before anything is computed.
    pub(super) fn claim(&self) -> anyhow::Result<()> {
        let RigTask::Check(args) = &self.task;
        let Some(picture) = &args.picture else { return Ok(()) };
        Format::of(picture)?;
        Ok(Outputs::new(args.force.force).reading(&args.file).claim(picture)?)
    }
}

/// Checks a rig file.
pub(super) fn run(args: &RigFileArgs) -> anyhow::Result<ExitCode> {
    let RigTask::Check(args) = &args.task;
    let rig = Rig::load(&args.file)?;
    let name = args.file.display();
    tracker::rig_check::check(&rig).map_err(|defect| {
        let remedy = confused::remedy(&rig).map_or(String::new(), |remedy| format!("; {remedy}"));
        anyhow::anyhow!("rig file {name}: {defect}{remedy}")
    })?;
    let viewer = Viewer::new(&rig);
    let view = viewer.view();
    if let Some(path) = &args.picture {
        let maps = Maps { viewer: &viewer, radius_mm: rig.workspace.tip_radius };
        Outputs::new(args.force.force).write(path, plots::bytes(&maps, Format::of(path)?)?)?;
        inform(&format!("{} written", path.display()));
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&view)?);
    } else {
        print!("{}", words(&rig, &view));
    }
    Ok(if view.missing.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(outputs::exit::DIFFERS) })
}

/// What was found, for a person.
fn words(rig: &Rig, view: &RigView) -> String {
    let mut text = if rig.longest_period_ns() == rig.field_period_ns() {
        format!("{} cameras, {} fields per second each\n", rig.cameras.len(), rig.field_hz)
    } else {
        format!("{} cameras of different rates, {} frames per second\n", rig.cameras.len(), rig.field_hz)
    };
    for (camera, sensor) in view.cameras.iter().zip(rig.sensors()) {
        let _ = writeln!(text, "{}", of_camera(camera, &sensor));
    }
    let um = |value: Option<f64>| value.map_or("unknown".into(), |um| format!("{um:.1} µm"));
    for tip in &view.tips {
        let _ = write!(
            text,
            "{}: two cameras see it in {:.0} % of the workspace; tip error from one frame {} (median), {} (95 %)",
            tip.body,
            100.0 * tip.seen_by_two,
            um(tip.median_um),
            um(tip.p95_um)
        );
        if let Some((worst, [x, y, z])) = tip.worst {
            let _ = write!(text, ", worst {} at ({x:.1}, {y:.1}, {z:.1}) mm", um(Some(worst)));
        }
        text.push('\n');
    }
    let missing = if view.missing.is_empty() { "no defects found" } else { "defects:" };
    let _ = writeln!(text, "{missing}");
    view.missing.iter().for_each(|what| text.push_str(&format!("  {what}\n")));
    text
}

fn of_camera(camera: &CameraView, sensor: &Sensor) -> String {
    let shutter = match sensor.shutter {
        Shutter::Global => "global",
        Shutter::Rolling => "rolling",
    };
    let [width, height] = sensor.size_px;
    format!(
        "camera {}: {width} × {height} px, {:.0} Hz, {}, {shutter} shutter, {}, exposed for {} ms, blobs after {:.1} ms; sees \
         {:.0} % of the workspace at a distance of {:.0} mm, {:.1} px/mm",
        camera.camera,
        1e9 / sensor.period_ns as f64,
        sensor.scan.name(),
        sensor.format.name(),
        sensor.exposure_ns as f64 * 1e-6,
        sensor.read_out_ns() as f64 * 1e-6,
        100.0 * camera.sees,
        camera.distance_mm,
        camera.px_per_mm
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    fn check(words: &[&str]) -> anyhow::Result<ExitCode> {
        let all = [&["vitreo-calibration", "rig", "check"], words].concat();
        super::super::run(&super::super::CalibrateArgs::try_parse_from(all)?)
    }

    fn path(folder: &tempfile::TempDir, name: &str) -> String {
        folder.path().join(name).to_str().expect("UTF-8").to_owned()
    }

    #[test]
    fn a_rig_is_described_and_drawn_and_nothing_is_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let [file, picture] = ["rig.json", "maps.png"].map(|name| path(&folder, name));
        let rig = Rig::load_or_shipped(None).unwrap();
        std::fs::write(&file, rig.to_json()).unwrap();
        assert_eq!(check(&[&file, "--picture", &picture]).unwrap(), ExitCode::SUCCESS);
        let drawn = std::fs::read(&picture).unwrap();
        assert!(drawn.starts_with(b"\x89PNG"));
        assert!(check(&[&file, "--picture", &picture]).is_err(), "it exists");
        assert!(check(&[&file, "--picture", &file, "--force"]).is_err(), "the input, and no picture's name");
        let view = Viewer::new(&rig).view();
        let text = words(&rig, &view);
        for named in [
            "3 cameras, 50 fields",
            "camera 2: 720 × 576 px, 50 Hz, interlaced, global shutter, YUYV, exposed for 4 ms",
            "no defects found",
        ] {
            assert!(text.contains(named), "{text}");
        }
        let mut mixed = rig;
        mixed.cameras[2].field_hz = Some(25.0);
        let text = words(&mixed, &view);
        assert!(
            text.contains("3 cameras of different rates, 50 frames") && text.contains("px, 25 Hz"),
            "{text}"
        );
    }

    #[test]
    fn what_is_missing_and_what_cannot_be_are_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        let file = path(&folder, "rig.json");
        let mut rig = Rig::load_or_shipped(None).unwrap();
        for camera in &mut rig.cameras {
            (camera.fx, camera.fy) = (2.0 * camera.fx, 2.0 * camera.fy);
        }
        std::fs::write(&file, rig.to_json()).unwrap();
        assert_eq!(check(&[&file, "--json"]).unwrap(), ExitCode::from(outputs::exit::DIFFERS));
        rig.cameras.iter_mut().for_each(|c| c.t = c.t.map(|t| t / 1000.0));
        std::fs::write(&file, rig.to_json()).unwrap();
        let told = check(&[&file]).unwrap_err().to_string();
        assert!(told.contains("rig.json") && told.contains("t is in mm"), "{told}");
    }

    /// Both left cameras that see less, or nothing at all, without the key that is wrong.
    #[test]
    fn a_marker_beyond_the_handle_and_a_lens_that_bends_or_folds_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = path(&folder, "rig.json");
        let planted = |plant: fn(&mut Rig)| {
            let mut rig = Rig::load_or_shipped(None).unwrap();
            plant(&mut rig);
            rig
        };
        let defects = [
            (
                planted(|rig| rig.bodies[0].markers[3].p[2] = 75.0),
                ["bodies.inst0.markers[3].p", "z 75, beyond the handle: the length of inst0 is 60"],
            ),
            (planted(|rig| rig.cameras[1].dist[0] = 50.0), ["cameras[1].dist", "more than half its width"]),
            (
                planted(|rig| rig.cameras[1].dist = [-5.0, 0.0, 0.0, 0.0, 0.0]),
                ["cameras[1].dist", "a lens that does not fold the picture"],
            ),
        ];
        for (rig, named) in defects {
            std::fs::write(&file, rig.to_json()).unwrap();
            let told = check(&[&file]).unwrap_err().to_string();
            assert!(named.iter().all(|words| told.contains(words)), "{told}");
        }
    }
}
