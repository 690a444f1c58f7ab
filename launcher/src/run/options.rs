//! What `vitreo run` takes, and what each process is given of it.

use super::arguments::{Arguments, injected_delay, percentile, positive, share};
use super::cameras::check_program;
use super::policy::MAX_RESTARTS;
use crate::modules::Composed;
use anyhow::Context;
use ipc::logging::inform;
use outputs::{Force, Outputs, STILLS, numbered, video_file};
use protocol::budget::{Budgets, Stage};
use protocol::file::{MAX_SETTINGS_BYTES, read_text};
use protocol::health::Process;
use results::Store;
use results::keeping::{self, seconds_since_1970};
use results::store::check_name;
use settings::commands::{Arrangement, FundusArgs, StoreArgs};
use settings::inputs::{check_file, check_folder};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Arguments of `vitreo run`.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct RunArgs {
    /// What is in the eye: a shipped scene's name or a scene file [default: peel].
    #[arg(long, value_name = "NAME|FILE")]
    pub scene: Option<String>,
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
    /// Keep the attempt under this pseudonym in the results store; without --record its recording
    /// goes beside the store.
    #[arg(long, value_name = "NAME", requires = "module")]
    pub trainee: Option<String>,
    /// Where the store lies.
    #[command(flatten)]
    pub store: StoreArgs,
    /// Who looks for collisions with the membrane: auto (the faster one, measured at start-up), cpu
    /// or gpu. It changes no result.
    #[arg(long, value_name = "WHO", value_parser = ["auto", "cpu", "gpu"])]
    pub collision: Option<String>,
    /// Cameras, markers and trocars [default: the shipped rig].
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
    /// Lay a recorded hand's movement above 1 Hz over the script.
    #[arg(long, value_name = "FILE", conflicts_with = "blobs")]
    pub motion: Option<PathBuf>,
    /// Use all of the recorded movement, fitted to the workspace.
    #[arg(long, requires = "motion")]
    pub motion_full: bool,
    /// Play a recorded blob stream in place of the cameras; needs its --rig.
    #[arg(long, value_name = "BLOBS.jsonl", requires = "rig")]
    pub blobs: Option<PathBuf>,
    /// Make blobs straight from the markers, without drawing pixels. With --cameras: the program
    /// publishes blobs.
    #[arg(long, conflicts_with = "blobs")]
    pub direct: bool,
    /// The program that drives real cameras, in place of the virtual rig: it publishes fields of
    /// pixels (blobs with --direct), handles and pedal. See docs/camera-hardware.md.
    #[arg(long, value_name = "PROGRAM", requires = "rig", conflicts_with_all = ["blobs", "motion", "faults"])]
    pub cameras: Option<PathBuf>,
    /// Let only people work: without --cameras and their --rig, say what is missing and wait.
    #[arg(long, conflicts_with_all = ["blobs", "motion", "faults"])]
    pub unscripted: bool,
    /// Let things go wrong in the cameras, from the seed: none, mild, hard, a fault by its name, or
    /// a file that ends in .toml.
    #[arg(long, value_name = "NAME[,NAME...]|FILE.toml", conflicts_with = "blobs")]
    pub faults: Option<String>,
    /// Write down what was done to which field, as JSON lines.
    #[arg(long, value_name = "FILE.jsonl", requires = "faults")]
    pub fault_log: Option<PathBuf>,
    /// Seed of everything random in the virtual cameras and hands.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// End after so many seconds [default: at the end of the stream, or Ctrl-C].
    #[arg(long, value_name = "S", value_parser = positive)]
    pub duration: Option<f64>,
    /// End so many seconds after the scripted surgeon's round.
    #[arg(skip)]
    pub after_round: Option<f64>,
    /// Record everything.
    #[arg(long, value_name = "FILE.mcap")]
    pub record: Option<PathBuf>,
    /// Write the figures of the run.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
    /// Exit with 4 where a latency budget is broken.
    #[arg(long)]
    pub assert_budgets: bool,
    /// Exit with 6 where a body was tracked in a smaller share of frames, 0 to 1.
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub assert_tracking: Option<f64>,
    /// Replace budgets.
    #[arg(long, value_name = "FILE.toml")]
    pub budgets: Option<PathBuf>,
    /// Percentile at which budgets are judged [default: 99, or the budget file's].
    #[arg(long, value_name = "P", value_parser = percentile)]
    pub percentile: Option<f64>,
    /// Draw without a window.
    #[arg(long, conflicts_with_all = ["window", "no_picture"])]
    pub headless: bool,
    /// Draw in a window [default where there is a display].
    #[arg(long, conflicts_with = "no_picture")]
    pub window: bool,
    /// The fundus photograph.
    #[command(flatten)]
    pub fundus: FundusArgs,
    /// Folder with the instruments' meshes to draw instead of the shipped ones.
    #[arg(long, value_name = "DIR", conflicts_with = "no_picture")]
    pub instruments: Option<PathBuf>,
    /// How the two channels share the picture: side-by-side, anaglyph, interleaved, sequential,
    /// left or right; of these, files take all but sequential.
    #[arg(long, value_enum, value_name = "HOW", hide_possible_values = true, conflicts_with = "no_picture")]
    pub arrange: Option<Arrangement>,
    /// Draw the dose of light over the retina; L shows and hides it.
    #[arg(long, conflicts_with = "no_picture")]
    pub show_dose: bool,
    /// Fill the monitor; F11 or F switches, Escape leaves.
    #[arg(long, conflicts_with_all = ["headless", "no_picture"])]
    pub full_screen: bool,
    /// The monitor to fill, by name or number.
    #[arg(long, value_name = "NAME|N", requires = "full_screen")]
    pub monitor: Option<String>,
    /// Draw nothing; run and measure the rest.
    #[arg(long, conflicts_with_all = ["stills", "video", "fundus"])]
    pub no_picture: bool,
    /// Name of this simulator; several run side by side under different names.
    #[arg(long, value_name = "NAME", default_value = "main")]
    pub instance: String,
    /// Save stereo pictures.
    #[arg(long, value_name = "DIR")]
    pub stills: Option<PathBuf>,
    /// Save a film, by its ending: MP4 (H.264), or Y4M without compression.
    #[arg(long, value_name = "FILE.mp4|FILE.y4m", value_parser = video_file)]
    pub video: Option<PathBuf>,
    /// Go on when the attempt is over: its end screen stands until a restart, the next level
    /// (vitreo ctl, pedal or keys) or the end.
    #[arg(long, requires = "module")]
    pub stay: bool,
    /// A person at the desk in place of cameras and tracker: vitreo play.
    #[arg(skip)]
    pub desk: Option<DeskArgs>,
    /// Slow a stage down, to see that its budget notices.
    #[arg(long, value_name = "STAGE=MS", value_parser = injected_delay, hide = true)]
    pub inject_delay: Vec<(Stage, f64)>,
    /// Restarts of one process within two minutes after which the run ends.
    #[arg(long, value_name = "N", hide = true, default_value_t = MAX_RESTARTS)]
    pub max_restarts: usize,
    /// Lose the graphics device after so many frames, once, to see that the picture comes back.
    #[arg(long, value_name = "FRAMES", hide = true, conflicts_with = "no_picture")]
    pub lose_device_after: Option<u64>,
}

/// What the desk listens to.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DeskArgs {
    /// auto, mouse or gamepad.
    pub input: String,
    /// A file of inputs to play instead.
    pub inputs: Option<PathBuf>,
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

/// The camera that `--inject-delay camera-wait=MS` makes late.
const LATE_CAMERA: u32 = 2;

impl RunArgs {
    /// With the scene of a module, and the length of its attempt where no other duration is asked
    /// for.
    pub fn with_scene_of(&self, composed: Option<&Composed>) -> Self {
        let Some(composed) = composed else { return self.clone() };
        let scripted = self.is_scripted() && !self.stay;
        let attempt = scripted.then(|| self.attempt_s(composed));
        let after_round = attempt.filter(|_| self.duration.is_none()).map(|_| AFTER_S);
        let duration = self.duration.or(attempt);
        RunArgs { scene: Some(composed.name()), duration, after_round, ..self.clone() }
    }

    /// Longest scripted attempt with its end screen, s; it ends with the script's round.
    pub fn attempt_s(&self, composed: &Composed) -> f64 {
        composed.longest_s + AFTER_S
    }

    /// Whether a script moves the instruments, not a person and not a recorded stream.
    pub fn is_scripted(&self) -> bool {
        self.blobs.is_none() && self.desk.is_none() && self.cameras.is_none()
    }

    /// The process that begins a run and ends it: the virtual rig, or the desk in the place of rig,
    /// camera hardware and tracker.
    pub fn source(&self) -> Process {
        if self.desk.is_some() { Process::Desk } else { Process::VirtualRig }
    }

    /// The processes between the source and the simulation.
    pub fn trackers(&self) -> &'static [Process] {
        match (&self.desk, self.direct || self.blobs.is_some()) {
            (Some(_), _) => &[],
            (None, true) => &[Process::Tracker],
            (None, false) => &[Process::Tracker, Process::FpgaModel],
        }
    }

    /// With a place for the recording of a trainee's attempt where none is given. Refuses odd names
    /// and a store that cannot be used, before anybody works for nothing.
    ///
    /// # Errors
    /// Where the name is refused or the store cannot be used.
    pub fn with_recording_of_trainee(self) -> anyhow::Result<Self> {
        let Some(trainee) = &self.trainee else { return Ok(self) };
        check_name(trainee)?;
        let path = keeping::place(self.store.store.as_deref())?;
        open_store(&self.store)?;
        // The name stays out of the file name: deleting a trainee deletes the name.
        let module = self.module.as_deref().and_then(|m| Path::new(m).file_name()).unwrap_or_default();
        let began = seconds_since_1970(SystemTime::now());
        let name = format!("{}-{}-{began}-{}.mcap", module.display(), self.level, std::process::id());
        let beside = path.with_file_name("recordings").join(name);
        Ok(RunArgs { record: Some(self.record.clone().unwrap_or(beside)), ..self })
    }

    /// What becomes of the picture, given whether there is a display.
    pub fn view(&self, has_display: bool) -> View {
        match (self.no_picture, self.headless, self.window || self.full_screen || has_display) {
            (true, _, _) => View::None,
            (_, true, _) | (_, _, false) => View::Headless,
            _ => View::Window,
        }
    }

    /// Milliseconds by which `stage` is slowed down.
    fn delay_ms(&self, stage: Stage) -> Option<f64> {
        self.inject_delay.iter().rev().find(|(s, _)| *s == stage).map(|(_, ms)| *ms)
    }

    /// The arguments of one process. `remaining_s` is what is left of the duration, `restarts` how
    /// often the process was restarted before.
    pub fn arguments_of(
        &self,
        process: Process,
        view: View,
        remaining_s: Option<f64>,
        restarts: u32,
    ) -> Vec<String> {
        let mut args = Arguments::default();
        let (stage, takes_rig, takes_scene) = match process {
            // The scene's script is nothing to real cameras.
            Process::VirtualRig if self.cameras.is_some() => (None, true, false),
            // Without pixels there is no camera hardware: the rig sends the blobs.
            Process::VirtualRig if self.trackers().contains(&Process::FpgaModel) => (None, true, true),
            Process::VirtualRig => (Some(Stage::Camera), true, true),
            Process::FpgaModel => (Some(Stage::Camera), true, false),
            Process::Tracker => (Some(Stage::Tracking), true, false),
            Process::Simcore => (Some(Stage::Simulation), false, true),
            Process::Renderer => (Some(Stage::Rendering), true, true),
            // It has no cameras to wait for: what it does is tracking.
            Process::Desk => (Some(Stage::Tracking), true, true),
        };
        args.path("--rig", self.rig.as_deref().filter(|_| takes_rig));
        args.value("--scene", self.scene.as_ref().filter(|_| takes_scene));
        args.value("--inject-delay-ms", stage.and_then(|s| self.delay_ms(s)));
        match process {
            Process::VirtualRig if self.cameras.is_some() => {}
            Process::VirtualRig => self.rig_arguments(&mut args, remaining_s, restarts),
            Process::Renderer => {
                args.0.push(if view == View::Window { "--window" } else { "--headless" }.into());
                args.0.extend(self.fundus.arguments());
                args.path("--instruments", self.instruments.as_deref());
                args.value("--arrange", self.arrange);
                args.flag("--full-screen", self.full_screen);
                args.flag("--show-dose", self.show_dose);
                args.value("--lose-device-after", self.lose_device_after.filter(|_| restarts == 0));
                args.flag("--desk", self.desk.is_some());
                args.value("--monitor", self.monitor.as_ref());
                // A restarted renderer puts its film and stills beside those before: a-2.y4m.
                for (name, output) in [("--stills", &self.stills), ("--video", &self.video)] {
                    args.path(name, output.as_deref().map(|o| self.numbered(o, restarts)).as_deref());
                }
                args.flag("--force", self.force.force && (self.stills.is_some() || self.video.is_some()));
            }
            Process::Simcore => args.value("--collision", self.collision.as_ref()),
            Process::FpgaModel | Process::Tracker => {}
            Process::Desk => {
                let desk = self.desk.clone().unwrap_or_default();
                match desk.inputs {
                    Some(file) => args.path("--inputs", Some(&file)),
                    None => args.value("--input", Some(desk.input)),
                }
            }
        }
        args.0
    }

    fn rig_arguments(&self, args: &mut Arguments, remaining_s: Option<f64>, restarts: u32) {
        args.value("--seed", Some(self.seed));
        args.path("--motion", self.motion.as_deref());
        args.flag("--motion-full", self.motion_full);
        args.path("--blobs", self.blobs.as_deref());
        args.flag("--direct", self.direct);
        args.value("--faults", self.faults.as_ref());
        let log = self.fault_log.as_deref().map(|file| self.numbered(file, restarts));
        args.path("--fault-log", log.as_deref());
        args.flag("--force", self.force.force && log.is_some());
        args.value("--duration", remaining_s);
        args.value("--after-round", self.after_round);
        let late = self.delay_ms(Stage::CameraWait).map(|ms| format!("{LATE_CAMERA}={ms}"));
        args.value("--late-camera", late);
    }

    /// The budgets to judge by: the shipped table, the file's entries, the chosen percentile.
    ///
    /// # Errors
    /// Where the file of budgets is refused.
    pub fn budget_table(&self) -> anyhow::Result<Budgets> {
        let mut budgets = match &self.budgets {
            None => Budgets::default(),
            Some(file) => {
                let name = file.display().to_string();
                let text =
                    read_text(file, MAX_SETTINGS_BYTES).with_context(|| format!("budget file {name}"))?;
                Budgets::parse(&text, &name)?
            }
        };
        budgets.percentile = self.percentile.unwrap_or(budgets.percentile);
        Ok(budgets)
    }

    /// The name of an output where something began again: `a-2.y4m`.
    pub(super) fn numbered(&self, file: &Path, number: u32) -> PathBuf {
        numbered(file, number, self.force.force)
    }

    /// The files that the run reads.
    fn inputs(&self) -> impl Iterator<Item = PathBuf> {
        let photograph = &self.fundus.fundus;
        let files = [&self.rig, &self.motion, &self.blobs, &self.budgets, photograph, &self.instruments];
        let desk = self.desk.as_ref().and_then(|d| d.inputs.clone());
        // Of these, those that are no files have no place on the disk.
        let names = [&self.scene, &self.module, &self.faults].into_iter().flatten().map(PathBuf::from);
        files.into_iter().flatten().cloned().chain(desk).chain(names)
    }

    /// Looks at every file before anything is started: what is read must be there, what is written
    /// must not.
    ///
    /// # Errors
    /// Where a file cannot be read or an output is refused.
    pub fn prepare(&self) -> anyhow::Result<Outputs> {
        let inputs = self.desk.as_ref().and_then(|d| d.inputs.clone());
        let faults = self.faults.as_ref().filter(|f| f.ends_with(".toml")).map(PathBuf::from);
        for (option, file) in [
            ("--rig", &self.rig),
            ("--motion", &self.motion),
            ("--blobs", &self.blobs),
            ("--inputs", &inputs),
            ("--budgets", &self.budgets),
            ("--fundus", &self.fundus.fundus),
            ("--faults", &faults),
        ] {
            file.as_deref().map_or(Ok(()), |file| check_file(option, file))?;
        }
        self.cameras.as_deref().map_or(Ok(()), check_program)?;
        self.instruments.as_deref().map_or(Ok(()), |folder| check_folder("--instruments", folder))?;
        let mut outputs = Outputs::new(self.force.force).reading_all(self.inputs());
        for file in [&self.record, &self.report, &self.video, &self.fault_log].into_iter().flatten() {
            outputs.claim(file)?;
        }
        self.stills.as_deref().map_or(Ok(()), |folder| outputs.claim_folder(folder, STILLS))?;
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
