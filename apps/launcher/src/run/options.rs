//! What `vitreo run` takes.

use super::arguments::{injected_delay, percentile, positive, share};
use super::cameras;
use super::colours;
use super::controls;
use super::external;
use super::field_trace::TraceOutArgs;
use super::policy::MAX_RESTARTS;
use super::recorder;
use crate::modules::Composed;
use anyhow::Context;
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
// The virtual rig itself plays a stream of the shipped rig too; here nobody should forget whose it is.
#[command(mut_arg("blobs", |arg| arg.requires("rig")))]
#[command(group = ArgGroup::new("recorded").multiple(true).args(["record", "trainee"]))]
#[command(mut_arg("split", |arg| arg.requires("recorded")))]
pub struct RunArgs {
    // Those without a heading come first: a heading holds for all that follows.
    /// The scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// The rig.
    #[command(flatten)]
    pub rig: RigArgs,
    /// What the camera hardware finds.
    #[command(flatten)]
    pub extraction: ExtractionArgs,
    /// Who looks for collisions.
    #[command(flatten)]
    pub collision: CollisionArgs,
    /// End after so many seconds [default: at the end of the stream, or Ctrl-C].
    #[arg(long, value_name = "S", value_parser = positive)]
    pub duration: Option<f64>,
    /// End so many seconds after the scripted surgeon's round.
    #[arg(skip)]
    pub after_round: Option<f64>,
    /// Name of this simulator; several run side by side under different names.
    #[arg(long, value_name = "NAME", default_value = "main")]
    pub instance: String,
    /// The module that is trained.
    #[command(flatten)]
    pub training: TrainingArgs,
    /// The virtual cameras.
    #[command(flatten)]
    pub virtual_rig: VirtualRigArgs,
    /// The real cameras.
    #[command(flatten)]
    pub real: RealCamerasArgs,
    /// The real pedal and handles.
    #[command(flatten)]
    pub controls: ControlsArgs,
    /// The picture.
    #[command(flatten)]
    pub view: ViewArgs,
    /// What is written.
    #[command(flatten)]
    pub outputs: OutputArgs,
    /// By what it is judged.
    #[command(flatten)]
    pub judge: JudgeArgs,
    /// What only tests ask for.
    #[command(flatten)]
    pub trial: TrialArgs,
    /// A person at the desk in place of cameras and tracker: vitreo play.
    #[arg(skip)]
    pub desk: Option<DeskArgs>,
}

/// What is trained, and by whom.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Training")]
pub struct TrainingArgs {
    /// Train: a module's name or folder (vitreo modules lists them). It takes the place of the
    /// scene.
    #[arg(long, value_name = "NAME|FOLDER", conflicts_with = "scene")]
    pub module: Option<String>,
    /// Level of the module, from 1 on.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "module")]
    pub level: u32,
    /// Who works where no person does: expert, average, novice, careless or idle.
    #[arg(long, value_name = "WHO", default_value = "expert", requires = "module")]
    pub surgeon: String,
    /// Go on when the attempt is over: its end screen stands until a restart, the next level
    /// (vitreo ctl, pedal or keys) or the end.
    #[arg(long, requires = "module")]
    pub stay: bool,
    /// Keep the attempt under this pseudonym in the results store; without --record its recording
    /// goes beside the store.
    #[arg(long, value_name = "NAME", requires = "module")]
    pub trainee: Option<String>,
    /// Where the store lies.
    #[command(flatten)]
    pub store: StoreArgs,
}

/// Real cameras in place of the virtual ones.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Real cameras")]
pub struct RealCamerasArgs {
    /// Where the pictures come from: virtual (as without this option), or for each camera of the rig
    /// v4l2:/dev/videoN, a camera of this machine, or genicam:NAME, one by GigE Vision or USB3 Vision
    /// (both with ?exposure_us=2000&gain=4&trigger=external), or y4m:PATH, a pipe or a file of fields
    /// (y4m:PATH?parity=1 where the first has the odd lines); mcap:FILE, what vitreo cameras
    /// --record-fields kept of all cameras (docs/cameras.md); or a program that drives cameras (it
    /// publishes fields of pixels, blobs with --direct, handles and pedal; docs/camera-hardware.md).
    #[arg(
        long,
        value_name = "virtual|v4l2:DEVICE,...|genicam:NAME,...|y4m:PATH,...|mcap:FILE|PROGRAM",
        requires = "rig",
        conflicts_with_all = ["blobs", "motion", "faults"]
    )]
    pub cameras: Option<Cameras>,
    /// Another tracker in the place of cameras and tracker, by its server of OpenIGTLink: its transforms become the
    /// poses of instruments and eye, MAP.toml says which (docs/bridge.md) [default: the names that
    /// vitreo bridge --igtl sends]. Jaws are open and the pedal is up where nobody sends them.
    #[arg(
        long,
        value_name = "igtl:HOST:PORT[,MAP.toml]",
        conflicts_with_all = ["cameras", "blobs", "motion", "faults", "direct"]
    )]
    pub poses: Option<OtherTracker>,
    /// Channels that programs of other makers send on, by libvitreo (docs/drivers.md): blobs, fields
    /// or poses in the place of the cameras, with their --rig; handles and pedal also beside them.
    #[arg(long, value_name = "CHANNEL,...")]
    pub external: Option<External>,
    /// Let only people work: without --cameras and their --rig, say what is missing and wait.
    #[arg(long, conflicts_with_all = ["blobs", "motion", "faults"])]
    pub unscripted: bool,
}

impl RealCamerasArgs {
    /// Cameras in place of the virtual ones, where there are any.
    pub fn given(&self) -> Option<&Cameras> {
        self.cameras.as_ref().filter(|cameras| **cameras != Cameras::Virtual)
    }

    /// The program that drives them, if it is another's.
    pub fn program(&self) -> Option<&Path> {
        match &self.cameras {
            Some(Cameras::Program(program)) => Some(program),
            _ => None,
        }
    }

    /// The program that stands in their place by what it sends itself.
    pub fn driver(&self) -> Option<Process> {
        let external = || self.external.as_ref().and_then(External::source);
        self.poses.as_ref().map(|_| Process::PosesDriver).or_else(external)
    }

    /// Programs of other makers that are expected.
    pub fn drivers(&self) -> &[Process] {
        self.external.as_ref().map_or(&[], External::drivers)
    }

    /// The streams of pictures that stand for them.
    pub fn streams(&self) -> Option<&Streams> {
        match &self.cameras {
            Some(Cameras::Streams(streams)) => Some(streams),
            _ => None,
        }
    }
}

/// What is written of a run.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "What is written")]
pub struct OutputArgs {
    /// Record everything.
    #[arg(long, value_name = "FILE.mcap")]
    pub record: Option<PathBuf>,
    /// How the recording is written.
    #[command(flatten)]
    pub writing: WritingArgs,
    /// Write the figures of the run.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    /// Whether it is traced.
    #[command(flatten)]
    pub trace: TraceOutArgs,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
}

/// By what a run is judged.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Judging")]
pub struct JudgeArgs {
    /// Exit with 4 where a latency budget is broken.
    #[arg(long)]
    pub assert_budgets: bool,
    /// Exit with 6 where a body was tracked in a smaller share of frames, 0 to 1.
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub assert_tracking: Option<f64>,
    /// Exit with 7 if the report has a warning about cameras, rig or tracking.
    #[arg(long)]
    pub assert_no_warnings: bool,
    /// Replace budgets.
    #[arg(long, value_name = "FILE.toml")]
    pub budgets: Option<PathBuf>,
    /// Percentile at which budgets are judged [default: 99, or the budget file's].
    #[arg(long, value_name = "P", value_parser = percentile)]
    pub percentile: Option<f64>,
}

/// Whether and how there is a picture.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Picture")]
pub struct ViewArgs {
    /// Draw without a window.
    #[arg(long, conflicts_with_all = ["window", "no_picture", "full_screen"])]
    pub headless: bool,
    /// Draw in a window [default where there is a display].
    #[arg(long, conflicts_with = "no_picture")]
    pub window: bool,
    /// Draw nothing; run and measure the rest.
    #[arg(long, conflicts_with_all = [
        "fundus", "instruments", "arrange", "full_screen", "show_dose", "stills", "video", "lose_device_after",
    ])]
    pub no_picture: bool,
    /// How it is drawn.
    #[command(flatten)]
    pub picture: PictureArgs,
}

/// What only tests ask for.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct TrialArgs {
    /// Slow a stage down, to see that its budget notices.
    #[arg(long, value_name = "STAGE=MS", value_parser = injected_delay, hide = true)]
    pub inject_delay: Vec<(Stage, f64)>,
    /// Restarts of one process within two minutes after which the run ends.
    #[arg(long, value_name = "N", hide = true, default_value_t = MAX_RESTARTS)]
    pub max_restarts: usize,
}

/// The end screen of a scripted attempt stands for so long, s.
const AFTER_S: f64 = 3.0;

/// What becomes of the picture.
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
    /// With the scene of a module, and the length of its attempt where no other duration is asked
    /// for.
    pub fn with_scene_of(&self, composed: Option<&Composed>) -> Self {
        let Some(composed) = composed else { return self.clone() };
        let scripted = self.is_scripted() && !self.training.stay;
        let attempt = scripted.then(|| self.attempt_s(composed));
        let after_round = attempt.filter(|_| self.duration.is_none()).map(|_| AFTER_S);
        let duration = self.duration.or(attempt);
        let scene = SceneArgs { scene: Some(composed.name()) };
        RunArgs { scene, duration, after_round, ..self.clone() }
    }

    /// Longest scripted attempt with its end screen, s; it ends with the script's round.
    pub fn attempt_s(&self, composed: &Composed) -> f64 {
        composed.longest_s + AFTER_S
    }

    /// Whether a script moves the instruments, not a person and not a recorded stream.
    pub fn is_scripted(&self) -> bool {
        let cameras = self.real.given().is_none() && self.real.driver().is_none();
        self.virtual_rig.blobs.is_none() && self.desk.is_none() && cameras
    }

    /// Where blobs come from, if they come from elsewhere than cameras.
    fn blob_source(&self) -> Option<BlobSource> {
        // What cannot be understood was refused when it was read.
        self.virtual_rig.blobs.as_deref().and_then(|given| BlobSource::of(given).ok())
    }

    /// Whether blobs are taken from a stream while others write it.
    pub fn takes_live_blobs(&self) -> bool {
        self.blob_source().is_some_and(|source| source.is_live())
    }

    /// The process that begins a run and ends it: the virtual rig, or the desk in the place of rig,
    /// camera hardware and tracker, or a driver.
    pub fn source(&self) -> Process {
        let driver = self.real.driver().unwrap_or(Process::VirtualRig);
        if self.desk.is_some() { Process::Desk } else { driver }
    }

    /// Whether a tracker of ours makes the poses.
    pub fn is_tracked(&self) -> bool {
        !matches!(self.source(), Process::Desk | Process::PosesDriver)
    }

    /// Whether the source is a program that the launcher does not start.
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

    /// With a place for the recording of a trainee's attempt where none is given. Refuses odd names
    /// and a store that cannot be used, before anybody works for nothing.
    ///
    /// # Errors
    /// Where the name is refused or the store cannot be used.
    pub fn with_recording_of_trainee(self) -> anyhow::Result<Self> {
        let Some(trainee) = &self.training.trainee else { return Ok(self) };
        check_name(trainee)?;
        let path = keeping::place(self.training.store.store.as_deref())?;
        open_store(&self.training.store)?;
        // The name stays out of the file name: deleting a trainee deletes the name.
        let module =
            self.training.module.as_deref().and_then(|m| Path::new(m).file_name()).unwrap_or_default();
        let began = seconds_since_1970(SystemTime::now());
        let name =
            format!("{}-{}-{began}-{}.mcap", module.display(), self.training.level, std::process::id());
        let beside = path.with_file_name("recordings").join(name);
        let record = Some(self.outputs.record.clone().unwrap_or(beside));
        Ok(RunArgs { outputs: OutputArgs { record, ..self.outputs }, ..self })
    }

    /// What becomes of the picture, given whether there is a display.
    pub fn view(&self, has_display: bool) -> View {
        let view = &self.view;
        match (view.no_picture, view.headless, view.window || view.picture.full_screen || has_display) {
            (true, _, _) => View::None,
            (_, true, _) | (_, _, false) => View::Headless,
            _ => View::Window,
        }
    }

    /// The budgets to judge by: the shipped table at the rate of the rig, the file's entries, the chosen
    /// percentile.
    ///
    /// # Errors
    /// Where the rig or the file of budgets is refused.
    pub fn budget_table(&self) -> anyhow::Result<Budgets> {
        let rig = Rig::load_or_shipped(self.rig.rig.as_deref()).context("--rig")?;
        let own = Budgets::at_period(rig.field_period_ns());
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

    /// The name of an output where something began again: `a-2.y4m`.
    pub(super) fn numbered(&self, file: &Path, number: u32) -> PathBuf {
        let force = self.outputs.force.force;
        let name = |number| numbered(file, number, force);
        // A recording in parts has no file of its own name.
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
        // Of these, those that are no files have no place on the disk.
        let names = [&self.scene.scene, &self.training.module, &cameras.faults]
            .into_iter()
            .flatten()
            .map(PathBuf::from);
        files.flatten().cloned().chain(desk).chain(names).chain(streams).chain(devices)
    }

    /// Looks at every file before anything is started: what is read must be there, what is written
    /// must not.
    ///
    /// # Errors
    /// Where a file cannot be read or an output is refused.
    pub fn prepare(&self) -> anyhow::Result<Outputs> {
        let inputs = self.desk.as_ref().and_then(|d| d.inputs.clone());
        let (cameras, picture) = (&self.virtual_rig, &self.view.picture);
        // A port is no file.
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

/// Opens the results store, or makes one; says what that has changed.
///
/// # Errors
/// Where it cannot be used.
pub(super) fn open_store(place: &StoreArgs) -> anyhow::Result<Store> {
    let (store, notices) = keeping::open(place.store.as_deref(), true)?;
    notices.iter().for_each(|notice| inform(notice));
    Ok(store)
}

#[cfg(test)]
mod tests;
