//! Command-line arguments of `vitreo run`.

use super::arguments::{injected_delay, percentile, positive, share};
use super::cameras;
use super::colours;
use super::controls;
use super::external;
use super::field_trace::TraceOutArgs;
use super::policy::MAX_RESTARTS;
use super::recorder;
use crate::modules::Composed;
use anyhow::{Context, ensure};
use clap::ArgGroup;
use ipc::logging::inform;
use outputs::{Force, Outputs, STILLS, numbered};
use protocol::budget::{Budgets, Stage};
use protocol::file::{MAX_SETTINGS_BYTES, read_text};
use protocol::health::Process;
use recording::parts_of;
use results::Store;
use results::keeping::{self, seconds_since_1970};
use results::store::check_name;
use rig::Rig;
use settings::blob_source::BlobSource;
use settings::commands::bridge::OtherTracker;
use settings::commands::cameras::{Cameras, Streams};
use settings::commands::controls::ControlsArgs;
use settings::commands::external::External;
use settings::commands::processes::{
    CollisionArgs, DeskArgs, ExtractionArgs, PictureArgs, RigArgs, SceneArgs, VirtualRigArgs,
};
use settings::commands::{StoreArgs, WritingArgs};
use settings::inputs::{check_file, check_folder};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Arguments of `vitreo run`.
#[derive(Debug, Clone, Default, clap::Args)]
// The virtual rig alone may play a stream of the shipped rig; a run must name the stream's rig.
#[command(mut_arg("blobs", |arg| arg.requires("rig").help_heading("Cameras")))]
#[command(group = ArgGroup::new("recorded").multiple(true).args(["record", "trainee"]))]
#[command(mut_arg("split", |arg| arg.requires("recorded")))]
pub struct RunArgs {
    // Arguments without a heading come first: a heading applies to all that follow.
    /// The scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// The rig.
    #[command(flatten)]
    pub rig: RigArgs,
    /// Stop after S seconds [default: at the end of the stream, or on Ctrl-C].
    #[arg(long, value_name = "S", value_parser = positive, allow_negative_numbers = true)]
    pub duration: Option<f64>,
    /// Stop this long after the scripted surgeon's round, s.
    #[arg(skip)]
    pub after_round: Option<f64>,
    /// Name of this simulator; several can run side by side under different names.
    #[arg(long, value_name = "NAME", default_value = "main")]
    pub instance: String,
    // The help has the groups in this order: those that most runs use come first.
    /// Outputs.
    #[command(flatten)]
    pub outputs: OutputArgs,
    /// The picture.
    #[command(flatten)]
    pub view: ViewArgs,
    /// The module that is trained.
    #[command(flatten)]
    pub training: TrainingArgs,
    /// Checks.
    #[command(flatten)]
    pub judge: JudgeArgs,
    /// The real cameras.
    #[command(flatten)]
    pub real: RealCamerasArgs,
    /// Colour classes.
    #[command(flatten)]
    pub extraction: ExtractionArgs,
    /// The virtual cameras.
    #[command(flatten)]
    pub virtual_rig: VirtualRigArgs,
    /// The real pedal and handles.
    #[command(flatten)]
    pub controls: ControlsArgs,
    /// Back end of collision detection.
    #[command(flatten)]
    pub collision: CollisionArgs,
    /// Hidden options for tests.
    #[command(flatten)]
    pub trial: TrialArgs,
    /// Recording whose rig is used.
    #[arg(skip)]
    pub rig_of: Option<PathBuf>,
    /// Desk that replaces cameras and tracker (`vitreo play`).
    #[arg(skip)]
    pub desk: Option<DeskArgs>,
}

/// Module, level and trainee.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Training")]
pub struct TrainingArgs {
    /// Module to train, by name or folder (vitreo modules lists them); it includes its own scene.
    #[arg(long, value_name = "NAME|FOLDER", conflicts_with = "scene")]
    pub module: Option<String>,
    /// Level of the module, from 1.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "module")]
    pub level: u32,
    /// Scripted surgeon, if no person operates: expert, average, novice, careless or idle.
    #[arg(long, value_name = "SURGEON", default_value = "expert", requires = "module")]
    pub surgeon: String,
    /// Keep running after the attempt: show its end screen until a restart, the next level (vitreo ctl, pedal
    /// or keys) or quit.
    #[arg(long, requires = "module")]
    pub stay: bool,
    /// Save the attempt in the results store under this pseudonym; without --record, the recording is saved
    /// next to the store.
    #[arg(long, value_name = "NAME", requires = "module")]
    pub trainee: Option<String>,
    /// Path of the store.
    #[command(flatten)]
    pub store: StoreArgs,
}

/// Real cameras in place of the virtual ones.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Cameras")]
pub struct RealCamerasArgs {
    /// Camera sources: virtual (the default); one per camera in the order of the rig: v4l2:/dev/videoN, genicam:NAME or
    /// y4m:PATH; mcap:FILE from vitreo cameras --record-fields; or a program that publishes fields. All but virtual and
    /// mcap:FILE need --rig. Settings and examples: docs/cameras.md, docs/camera-hardware.md.
    #[arg(
        long,
        value_name = "virtual|v4l2:DEVICE,...|genicam:NAME,...|y4m:PATH,...|mcap:FILE|PROGRAM",
        conflicts_with_all = ["blobs", "motion", "faults"]
    )]
    pub cameras: Option<Cameras>,
    /// OpenIGTLink server of another tracker, which replaces cameras and tracker. MAP.toml maps its
    /// transforms to instruments and eye (docs/bridge.md) [default: the names that vitreo bridge --igtl
    /// sends]. Without other input, the jaws stay open and the pedal up.
    #[arg(
        long,
        value_name = "igtl:HOST:PORT[,MAP.toml]",
        conflicts_with_all = ["cameras", "blobs", "motion", "faults", "direct"]
    )]
    pub poses: Option<OtherTracker>,
    /// Channels fed by external drivers through libvitreo (docs/drivers.md): blobs, fields or poses replace
    /// the cameras and need --rig; handles and pedal can also be combined with cameras.
    #[arg(long, value_name = "CHANNEL,...")]
    pub external: Option<External>,
    /// Run without a scripted surgeon; wait until --cameras and --rig are configured and connected, and report what is
    /// missing.
    #[arg(long, conflicts_with_all = ["blobs", "motion", "faults"])]
    pub unscripted: bool,
}

impl RealCamerasArgs {
    /// Cameras that replace the virtual ones, if any.
    pub fn given(&self) -> Option<&Cameras> {
        self.cameras.as_ref().filter(|cameras| **cameras != Cameras::Virtual)
    }

    /// The user's own program that drives the cameras, if any.
    pub fn program(&self) -> Option<&Path> {
        match &self.cameras {
            Some(Cameras::Program(program)) => Some(program),
            _ => None,
        }
    }

    /// Driver that replaces the cameras, if any.
    pub fn driver(&self) -> Option<Process> {
        let external = || self.external.as_ref().and_then(External::source);
        self.poses.as_ref().map(|_| Process::PosesDriver).or_else(external)
    }

    /// Expected external drivers.
    pub fn drivers(&self) -> &[Process] {
        self.external.as_ref().map_or(&[], External::drivers)
    }

    /// Streams of pictures that replace the virtual cameras, if any.
    pub fn streams(&self) -> Option<&Streams> {
        match &self.cameras {
            Some(Cameras::Streams(streams)) => Some(streams),
            _ => None,
        }
    }
}

/// Files that a run writes.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Outputs")]
pub struct OutputArgs {
    /// Record the run.
    #[arg(long, value_name = "FILE.mcap")]
    pub record: Option<PathBuf>,
    /// Compression and split.
    #[command(flatten)]
    pub writing: WritingArgs,
    /// Write a report with the figures of the run.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    /// Trace of the fields.
    #[command(flatten)]
    pub trace: TraceOutArgs,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}

/// Checks that decide the exit code of a run.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Checks")]
pub struct JudgeArgs {
    /// Exit with code 4 if a latency budget is exceeded.
    #[arg(long)]
    pub assert_budgets: bool,
    /// Exit with code 6 if a body was tracked in a smaller fraction of the frames, 0 to 1.
    #[arg(long, value_name = "FRACTION", value_parser = share, allow_negative_numbers = true)]
    pub assert_tracking: Option<f64>,
    /// Exit with code 7 if the report has warnings about cameras, rig or tracking, or too little was seen to judge them.
    #[arg(long)]
    pub assert_no_warnings: bool,
    /// File of latency budgets that replace the shipped ones.
    #[arg(long, value_name = "FILE.toml")]
    pub budgets: Option<PathBuf>,
    /// Percentile to compare with the budgets [default: 99, or the budget file's].
    #[arg(long, value_name = "P", value_parser = percentile)]
    pub percentile: Option<f64>,
}

/// Window, files and layout of the picture.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Picture")]
#[command(mut_arg("monitor", |arg| arg.conflicts_with_all(["headless", "no_picture"])))]
pub struct ViewArgs {
    /// Draw without a window.
    #[arg(long, conflicts_with_all = ["window", "no_picture", "full_screen"])]
    pub headless: bool,
    /// Draw in a window [default if there is a display].
    #[arg(long, conflicts_with = "no_picture")]
    pub window: bool,
    /// Draw nothing; run and measure everything else.
    #[arg(long, conflicts_with_all = [
        "fundus", "instruments", "arrange", "full_screen", "show_dose", "stills", "video", "lose_device_after",
    ])]
    pub no_picture: bool,
    /// How it is drawn.
    #[command(flatten)]
    pub picture: PictureArgs,
}

/// Hidden options for tests.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct TrialArgs {
    /// Delay a stage, to test its budget.
    #[arg(long, value_name = "STAGE=MS", value_parser = injected_delay, hide = true)]
    pub inject_delay: Vec<(Stage, f64)>,
    /// Number of restarts of one process within two minutes that ends the run.
    #[arg(long, value_name = "N", hide = true, default_value_t = MAX_RESTARTS)]
    pub max_restarts: usize,
}

/// Time for which the end screen of a scripted attempt is shown, s.
const AFTER_S: f64 = 3.0;

/// How the picture is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum View {
    /// In a window.
    Window,
    /// Drawn without a window.
    Headless,
    /// Not drawn.
    None,
}

impl RunArgs {
    /// Fills in the scene of the module and, unless a duration is given, the length of the scripted attempt.
    pub fn with_scene_of(&self, composed: Option<&Composed>) -> Self {
        let Some(composed) = composed else { return self.clone() };
        let scripted = self.is_scripted() && !self.training.stay;
        let attempt = scripted.then(|| self.attempt_s(composed));
        let after_round = attempt.filter(|_| self.duration.is_none()).map(|_| AFTER_S);
        let duration = self.duration.or(attempt);
        let scene = SceneArgs { scene: Some(composed.name()) };
        RunArgs { scene, duration, after_round, ..self.clone() }
    }

    /// Maximum length of a scripted attempt with its end screen, s. The attempt ends earlier if the script
    /// does.
    pub fn attempt_s(&self, composed: &Composed) -> f64 {
        composed.longest_s + AFTER_S
    }

    /// True if a script moves the instruments, not a user and not a recorded stream.
    pub fn is_scripted(&self) -> bool {
        let cameras = self.real.given().is_none() && self.real.driver().is_none();
        self.virtual_rig.blobs.is_none() && self.desk.is_none() && cameras
    }

    /// Source of the blobs, if they do not come from cameras.
    fn blob_source(&self) -> Option<BlobSource> {
        // The option's parser has already rejected invalid sources.
        self.virtual_rig.blobs.as_deref().and_then(|given| BlobSource::of(given).ok())
    }

    /// True if blobs come from a stream that is still being written.
    pub fn takes_live_blobs(&self) -> bool {
        self.blob_source().is_some_and(|source| source.is_live())
    }

    /// First process of the data path, which starts and ends a run: the virtual rig, a driver, or the desk,
    /// which replaces rig, camera hardware and tracker.
    pub fn source(&self) -> Process {
        let driver = self.real.driver().unwrap_or(Process::VirtualRig);
        if self.desk.is_some() { Process::Desk } else { driver }
    }

    /// True if the poses come from the built-in tracker.
    pub fn is_tracked(&self) -> bool {
        !matches!(self.source(), Process::Desk | Process::PosesDriver)
    }

    /// True if the source is a program that the launcher does not start.
    pub fn has_outside_source(&self) -> bool {
        self.real.drivers().contains(&self.source())
    }

    /// The processes between the source and the simulation.
    pub fn trackers(&self) -> &'static [Process] {
        let blobs = self.virtual_rig.direct || self.virtual_rig.blobs.is_some();
        match (self.is_tracked(), blobs || self.source() == Process::BlobsDriver) {
            (false, _) => &[],
            (true, true) => &[Process::Tracker],
            (true, false) => &[Process::Tracker, Process::FpgaModel],
        }
    }

    /// Chooses a recording file for a trainee, unless one is given. Checks the trainee's name and the results
    /// store before the run, so that no attempt is lost.
    ///
    /// # Errors
    /// If the name is invalid or the store cannot be used.
    pub fn with_recording_of_trainee(self) -> anyhow::Result<Self> {
        let Some(trainee) = &self.training.trainee else { return Ok(self) };
        check_name(trainee)?;
        let path = keeping::place(self.training.store.store.as_deref())?;
        open_store(&self.training.store)?;
        // The trainee's name is not in the file name, so that deleting a trainee deletes every copy of the
        // name.
        let module =
            self.training.module.as_deref().and_then(|m| Path::new(m).file_name()).unwrap_or_default();
        let began = seconds_since_1970(SystemTime::now());
        let name =
            format!("{}-{}-{began}-{}.mcap", module.display(), self.training.level, std::process::id());
        let beside = path.with_file_name("recordings").join(name);
        let record = Some(self.outputs.record.clone().unwrap_or(beside));
        Ok(RunArgs { outputs: OutputArgs { record, ..self.outputs }, ..self })
    }

    /// How the picture is shown, given whether there is a display.
    pub fn view(&self, has_display: bool) -> View {
        let view = &self.view;
        match (view.no_picture, view.headless, view.window || view.picture.full_screen || has_display) {
            (true, _, _) => View::None,
            (_, true, _) | (_, _, false) => View::Headless,
            _ => View::Window,
        }
    }

    /// Checks that a user at a desk has a display.
    ///
    /// # Errors
    /// If mouse and keyboard are the inputs and there is no display.
    pub fn check_display(&self, has_display: bool) -> anyhow::Result<()> {
        let needed = self.desk.as_ref().is_some_and(|desk| desk.inputs.is_none());
        ensure!(
            has_display || !needed,
            "no display: mouse and keyboard need the picture's window; use --inputs FILE instead"
        );
        Ok(())
    }

    /// Latency budgets: the shipped table at the rig's rate, overridden by the file and the chosen
    /// percentile.
    ///
    /// # Errors
    /// If the rig or the file of budgets is invalid.
    pub fn budget_table(&self) -> anyhow::Result<Budgets> {
        let rig = Rig::load_or_shipped(self.rig.rig.as_deref()).context("--rig")?;
        let own = Budgets::of_rig(rig.field_period_ns(), rig.read_out_ns());
        let mut budgets = match &self.judge.budgets {
            None => own,
            Some(file) => {
                let name = file.display().to_string();
                let text =
                    read_text(file, MAX_SETTINGS_BYTES).with_context(|| format!("budget file {name}"))?;
                own.overridden_by(&text, &name)?
            }
        };
        budgets.percentile = self.judge.percentile.unwrap_or(budgets.percentile);
        Ok(budgets)
    }

    /// Numbered name of an output after a restart, such as `a-2.y4m`.
    pub(super) fn numbered(&self, file: &Path, number: u32) -> PathBuf {
        let force = self.outputs.force.force;
        let name = |number| numbered(file, number, force);
        // A recording in parts has no file of its own name, so its parts are checked.
        let is_free = |path: &PathBuf| force || number == 0 || parts_of(path).is_empty();
        (number..=u32::MAX).map(name).find(is_free).unwrap_or_else(|| name(number))
    }

    /// The files that the run reads.
    fn inputs(&self) -> impl Iterator<Item = PathBuf> {
        let (cameras, picture) = (&self.virtual_rig, &self.view.picture);
        let own =
            [&self.rig.rig, &self.extraction.colours, &cameras.motion, &cameras.blobs, &self.judge.budgets];
        let files = own.into_iter().chain([&picture.fundus.fundus, &picture.instruments]);
        let streams = self.real.streams().into_iter().flat_map(|s| s.0.iter().filter(|s| s.kind.has_path()));
        let streams = streams.map(|s| s.path.clone());
        let desk = self.desk.as_ref().and_then(|d| d.inputs.clone());
        let pedal = self.controls.pedal.as_ref().map(|pedal| pedal.path.clone());
        let mapping =
            self.controls.pedal.as_ref().and_then(|pedal| pedal.mapping.as_deref()).map(PathBuf::from);
        let handles = self.controls.handles.as_ref().map(|handles| handles.path.clone());
        let map = self.real.poses.as_ref().and_then(|other| other.map.clone());
        let devices = [pedal, mapping, handles, map].into_iter().flatten();
        // Names of shipped scenes, modules and fault sets are no existing files, and are ignored.
        let names = [&self.scene.scene, &self.training.module, &cameras.faults]
            .into_iter()
            .flatten()
            .map(PathBuf::from);
        files.flatten().cloned().chain(desk).chain(names).chain(streams).chain(devices)
    }

    /// Checks all files before anything starts: inputs must exist, outputs must not (without `--force`).
    ///
    /// # Errors
    /// If an input cannot be read, an output is refused, or options conflict.
    pub fn prepare(&self) -> anyhow::Result<Outputs> {
        let inputs = self.desk.as_ref().and_then(|d| d.inputs.clone());
        let (cameras, picture) = (&self.virtual_rig, &self.view.picture);
        // A port is not a file.
        let blobs = cameras.blobs.clone().filter(|_| !matches!(self.blob_source(), Some(BlobSource::Tcp(_))));
        let faults = cameras.faults.as_ref().filter(|f| f.ends_with(".toml")).map(PathBuf::from);
        for (option, file) in [
            ("--rig", &self.rig.rig),
            ("--motion", &cameras.motion),
            ("--blobs", &blobs),
            ("--inputs", &inputs),
            ("--budgets", &self.judge.budgets),
            ("--fundus", &picture.fundus.fundus),
            ("--faults", &faults),
            ("--poses", &self.real.poses.as_ref().and_then(|other| other.map.clone())),
        ] {
            file.as_deref().map_or(Ok(()), |file| check_file(option, file))?;
        }
        external::check(self)?;
        cameras::check(&self.real, self.rig.rig.as_deref(), self.virtual_rig.direct)?;
        controls::check(self)?;
        colours::check(self)?;
        picture.instruments.as_deref().map_or(Ok(()), |folder| check_folder("--instruments", folder))?;
        let mut outputs = Outputs::new(self.outputs.force.force).reading_all(self.inputs());
        let OutputArgs { record, writing, report, trace, .. } = &self.outputs;
        record.as_deref().map_or(Ok(()), |name| recorder::files::claim(name, writing, &mut outputs))?;
        for file in [report, &trace.trace_out, &picture.video, &cameras.fault_log].into_iter().flatten() {
            outputs.claim(file)?;
        }
        picture.stills.as_deref().map_or(Ok(()), |folder| outputs.claim_folder(folder, STILLS))?;
        Ok(outputs)
    }
}

/// Opens or creates the results store, and logs the changes made to it.
///
/// # Errors
/// If the store cannot be used.
pub(super) fn open_store(place: &StoreArgs) -> anyhow::Result<Store> {
    let (store, notices) = keeping::open(place.store.as_deref(), true)?;
    notices.iter().for_each(|notice| inform(notice));
    Ok(store)
}

#[cfg(test)]
mod tests;
