//! `vitreo calibrate`: the command line of the calibrations.

mod board;
mod checks;
mod dots_checks;
mod fields;
mod fixed;
mod lens_checks;
mod lists;
mod recorded;
mod rig_file;
mod stereo;
mod stream;
mod target;
mod waved;

pub use fields::fields_in;
pub use stream::{Centre, LIMIT_PX, drift_report, judged, pivoted, shafts, turned};
pub use target::BoardArgs;
pub use waved::{Waved, refined_by_waving, waved_report};

use crate::lens::{LENS, LENS_NAMES};
use crate::multi_camera::Progress;
use crate::report::Report;
use crate::residual_plot::ResidualPicture;
use crate::target_problem::{Residual, Robustness};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use ipc::logging::{LogArgs, inform, warn};
use outputs::{Force, Names, Outputs, print, println};
use rig::camera::Camera;
use settings::{Program, SettingsArgs};
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// What vitreo.toml says to the calibrations.
pub const SETTINGS: Program = Program { prefix: "calibrate", without: &[], elsewhere: None };

/// Calibrate lenses, camera poses, markers and trocars, and check whether they still hold.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "vitreo-calibration", version)]
pub struct CalibrateArgs {
    /// What to calibrate.
    #[command(subcommand)]
    pub task: Task,
    /// Whether files of settings are read.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// Logging.
    #[command(flatten)]
    pub log: LogArgs,
}

/// The calibrations.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum Task {
    /// Calibrate the lens of one camera from pictures of a board, or from point lists.
    Intrinsics(target::IntrinsicsArgs),
    /// Calibrate lenses and poses of cameras that see the same board, from pairs of pictures or from point lists.
    Stereo(stereo::StereoArgs),
    /// Calibrate poses (and lenses) of cameras that see dots at known positions, from one point list or picture per
    /// camera.
    Dots(fixed::DotsArgs),
    /// Refine a rig's camera poses and marker positions from a stream of instruments waved in front of the cameras.
    Waved(waved::WavedArgs),
    /// Calibrate the trocars and the eye's centre from a stream in which the instruments tilt and the eye turns.
    Pivot(stream::PivotArgs),
    /// Check from a recent stream whether a rig still holds; exit code 5 if it does not.
    Drift(stream::DriftArgs),
    /// Draw a board to print, as SVG or PNG at its true size.
    Board(board::DrawArgs),
    /// Check a rig file.
    #[command(hide = true)]
    Rig(rig_file::RigFileArgs),
}

impl Task {
    /// Looks at what will be written, and that it is none of the files that are read.
    fn claim(&self) -> anyhow::Result<()> {
        let (output, inputs): (_, Vec<&PathBuf>) = match self {
            Task::Rig(a) => return a.claim(),
            Task::Board(a) => return a.claim(),
            Task::Intrinsics(a) => (&a.output, a.pictures.iter().chain(&a.points).chain(&a.rig).collect()),
            Task::Stereo(a) => {
                (&a.output, a.left.iter().chain(&a.right).chain(&a.points).chain(&a.rig).collect())
            }
            Task::Dots(a) => {
                let lists = a.points.iter().chain(&a.pictures).chain(&a.picked);
                (&a.output, lists.chain(&a.target).chain(&a.rig).collect())
            }
            Task::Waved(a) => (&a.output, std::iter::once(&a.stream).chain(a.from.files()).collect()),
            Task::Pivot(a) => (&a.output, a.stream.iter().chain(&a.poses).chain(a.from.files()).collect()),
            Task::Drift(a) => (&a.output, std::iter::once(&a.stream).chain(a.from.files()).collect()),
        };
        output.claim(&inputs)
    }
}

/// Where results go.
#[derive(Debug, Clone, clap::Args)]
#[command(mut_arg("force", |arg| arg.help_heading("Outputs")))]
pub struct OutputArgs {
    /// Write the result to a file.
    #[arg(short, long, value_name = "FILE.json", help_heading = "Outputs")]
    pub output: Option<PathBuf>,
    /// Print the report as JSON.
    #[arg(long, help_heading = "Outputs")]
    pub json: bool,
    /// Draw each camera's residuals as a picture in a folder.
    #[arg(long, value_name = "FOLDER", help_heading = "Outputs")]
    pub residuals: Option<PathBuf>,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
}

/// Pictures of residuals.
const RESIDUALS: Names = &[["residuals_cam", ".png"]];

/// How to solve.
#[derive(Debug, Clone, clap::Args)]
pub struct SolveArgs {
    /// Weight of points with large residuals.
    #[arg(long, value_enum, default_value = "huber", help_heading = "Solver")]
    pub loss: Robustness,
    /// Distortion terms fixed at 0, such as k2,k3.
    #[arg(long, value_delimiter = ',', value_name = "TERMS", value_parser = ["k1", "k2", "p1", "p2", "k3"], help_heading = "Solver")]
    pub without: Vec<String>,
}

impl SolveArgs {
    /// Which values of a lens are free.
    fn free(&self) -> [bool; LENS] {
        LENS_NAMES.map(|name| !self.without.iter().any(|w| w == name))
    }
}

/// Parses `AxB`, for instance width and height.
fn pair(text: &str) -> Result<[u32; 2], String> {
    let parts = text.split_once(['x', '×']).and_then(|(a, b)| Some([a.parse().ok()?, b.parse().ok()?]));
    let sane = parts.filter(|numbers| numbers.iter().all(|n| (2..=100_000).contains(n)));
    sane.ok_or_else(|| "expected two whole numbers from 2, as in 9x6".into())
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v > 0.0 && v.is_finite() => Ok(v),
        _ => Err("expected a number above 0".into()),
    }
}

/// Runs a calibration. Exit codes: 0 done, 1 failed or refused, 5 a check found that the rig has
/// moved, or lacks something.
///
/// # Errors
/// As the calibration run.
pub fn run(args: &CalibrateArgs) -> anyhow::Result<ExitCode> {
    args.task.claim()?;
    match &args.task {
        Task::Intrinsics(args) => target::intrinsics(args),
        Task::Stereo(args) => stereo::stereo(args),
        Task::Dots(args) => fixed::fixed_dots(args),
        Task::Waved(args) => waved::waved(args),
        Task::Pivot(args) => stream::pivot(args),
        Task::Drift(args) => stream::drift(args),
        Task::Board(args) => board::draw(args),
        Task::Rig(args) => rig_file::run(args),
    }
}

/// A sign of progress for a person, on a terminal only: a bar over `count` things, or a spinner.
fn progress(what: &'static str, count: Option<u64>) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let template =
        if count.is_some() { "{prefix} {wide_bar} {pos}/{len} {eta}" } else { "{spinner} {prefix} {msg}" };
    let bar = ProgressBar::with_draw_target(count, ProgressDrawTarget::stderr());
    bar.set_style(ProgressStyle::with_template(template).expect("a valid template"));
    bar.with_prefix(what)
}

/// Logs a refusal that the report states too, for a report that goes to a file or a pipe. On a terminal that shows
/// both, it would be read twice.
fn warn_of_refusal(refusal: &str) {
    if !(std::io::stdout().is_terminal() && std::io::stderr().is_terminal()) {
        warn(refusal);
    }
}

/// Runs `work` with a spinner that shows the iteration and the cost that `work` reports.
fn with_spinner<T>(what: &'static str, work: impl FnOnce(&mut Progress<'_>) -> T) -> T {
    let spinner = progress(what, None);
    let done = work(&mut |i, cost| spinner.set_message(format!("iteration {i}, cost {cost:.6e}")));
    spinner.finish_and_clear();
    done
}

impl OutputArgs {
    /// Looks at what will be written, before anything is computed.
    fn claim(&self, inputs: &[&PathBuf]) -> anyhow::Result<()> {
        let mut outputs = Outputs::new(self.force.force).reading_all(inputs);
        self.output.as_deref().map_or(Ok(()), |file| outputs.claim(file))?;
        Ok(self.residuals.as_deref().map_or(Ok(()), |folder| outputs.claim_folder(folder, RESIDUALS))?)
    }

    /// Prints the report and draws the residuals.
    fn print(&self, report: &Report, cameras: &[Camera], residuals: &[Residual]) -> anyhow::Result<()> {
        if let Some(folder) = &self.residuals {
            for (index, camera) in cameras.iter().enumerate() {
                let own: Vec<Residual> = residuals.iter().filter(|r| r.camera == index).copied().collect();
                let path = folder.join(format!("residuals_cam{}.png", camera.id));
                let picture = ResidualPicture { size_px: camera.size_px, residuals: &own };
                Outputs::new(true).write(&path, plots::bytes(&picture, plots::Format::Png)?)?;
                inform(&format!("{}: {} residuals", path.display(), own.len()));
            }
        }
        if self.json {
            println!("{}", report.to_json())
        } else {
            print!("{report}")
        }
        Ok(())
    }

    /// Writes the result, if a file is named.
    fn write(&self, json: &str) -> anyhow::Result<()> {
        let Some(path) = &self.output else { return Ok(()) };
        Outputs::new(self.force.force).write(path, format!("{json}\n"))?;
        inform(&format!("{} written", path.display()));
        Ok(())
    }
}

/// Name of a file without its folders.
fn short(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}
