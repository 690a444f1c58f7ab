//! `vitreo play`: a user at a desk moves the instruments with mouse, keyboard or gamepad.

use crate::machine::has_display;
use crate::run::{self, MAX_RESTARTS, OutputArgs, RunArgs, TraceOutArgs, TrainingArgs, TrialArgs, ViewArgs};
use clap::ArgGroup;
use ipc::logging::inform;
use outputs::{Force, print};
use protocol::bindings::rows;
use settings::commands::processes::{DeskArgs, PictureArgs, RigArgs, SceneArgs, VirtualRigArgs};
use settings::commands::{Arrangement, StoreArgs, WritingArgs};
use std::path::PathBuf;
use std::process::ExitCode;

/// Default module, the easiest one.
const FIRST_MODULE: &str = "navigation";

/// Arguments of `vitreo play`.
#[derive(Debug, clap::Args)]
#[command(group = ArgGroup::new("recorded").multiple(true).args(["record", "trainee"]))]
#[command(mut_arg("split", |arg| arg.requires("recorded")))]
pub struct PlayArgs {
    /// Module to train (vitreo modules lists them) [default: navigation].
    #[arg(value_name = "MODULE", conflicts_with = "scene")]
    pub module: Option<String>,
    /// Level of the module, from 1.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub level: u32,
    /// Explore a scene without a task instead: a shipped scene or a scene file.
    #[arg(long, value_name = "NAME|FILE")]
    pub scene: Option<String>,
    /// Input device.
    #[command(flatten)]
    pub desk: DeskArgs,
    /// Print the controls of keyboard, mouse and gamepad, and exit.
    #[arg(long)]
    pub keys: bool,
    /// Rig file; only its trocars are used.
    #[command(flatten)]
    pub rig: RigArgs,
    /// Name of this simulator.
    #[arg(long, value_name = "NAME", default_value = "main")]
    pub instance: String,
    /// Save the attempts in the results store under this pseudonym.
    #[arg(long, help_heading = "Results", value_name = "NAME", conflicts_with = "scene")]
    pub trainee: Option<String>,
    /// Folder of the results store.
    #[command(flatten, next_help_heading = "Results")]
    pub store: StoreArgs,
    /// Record the run; a restart or the next level begins another, numbered file.
    #[arg(long, help_heading = "Outputs", value_name = "FILE.mcap")]
    pub record: Option<PathBuf>,
    /// Compression and splitting.
    #[command(flatten, next_help_heading = "Outputs")]
    pub writing: WritingArgs,
    /// Write a report with the figures of the run.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    /// Trace options.
    #[command(flatten)]
    pub trace: TraceOutArgs,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
    /// Draw without a window.
    #[arg(long, help_heading = "Picture", requires = "inputs", conflicts_with = "no_picture")]
    pub headless: bool,
    /// Draw nothing.
    #[arg(long, help_heading = "Picture", requires = "inputs")]
    pub no_picture: bool,
    /// Stereo layout: left, right, side-by-side, anaglyph, interleaved or sequential.
    #[arg(long, help_heading = "Picture", value_enum, value_name = "LAYOUT", default_value_t = Arrangement::Left, hide_possible_values = true)]
    pub arrange: Arrangement,
    /// Fill the monitor.
    #[arg(long, help_heading = "Picture", conflicts_with_all = ["headless", "no_picture"])]
    pub full_screen: bool,
    /// Save stereo stills in this folder.
    #[arg(long, help_heading = "Picture", value_name = "DIR", conflicts_with = "no_picture")]
    pub stills: Option<PathBuf>,
    /// Save a film: .mp4 (H.264) or .y4m (uncompressed).
    #[arg(long, help_heading = "Picture", value_name = "FILE.mp4|FILE.y4m", value_parser = outputs::video_file, conflicts_with = "no_picture")]
    pub video: Option<PathBuf>,
}

/// Runs `vitreo play`.
///
/// # Errors
/// If there is neither a display nor a file of inputs; otherwise the errors of a run.
pub fn run(args: &PlayArgs) -> anyhow::Result<ExitCode> {
    if args.keys {
        print!("{}", aligned());
        return Ok(ExitCode::SUCCESS);
    }
    if args.desk.inputs.is_none() && has_display() {
        inform(
            "click into the picture to start; F1 shows the keys, vitreo play --keys prints them, F10 quits",
        );
    }
    run::run(&args.run_args())
}

impl PlayArgs {
    /// The arguments of the run that `vitreo play` stands for.
    fn run_args(&self) -> RunArgs {
        let module = self.module.clone().or_else(|| self.scene.is_none().then(|| FIRST_MODULE.into()));
        let training = TrainingArgs {
            stay: module.is_some(),
            module,
            level: self.level,
            surgeon: "expert".into(),
            trainee: self.trainee.clone(),
            store: self.store.clone(),
        };
        let files = OutputArgs {
            record: self.record.clone(),
            writing: self.writing.clone(),
            report: self.report.clone(),
            trace: self.trace.clone(),
            force: self.force,
        };
        RunArgs {
            scene: SceneArgs { scene: self.scene.clone() },
            training,
            rig: self.rig.clone(),
            virtual_rig: VirtualRigArgs { seed: 1, ..VirtualRigArgs::default() },
            outputs: files,
            view: self.view(),
            instance: self.instance.clone(),
            desk: Some(self.desk.clone()),
            trial: TrialArgs { max_restarts: MAX_RESTARTS, ..TrialArgs::default() },
            ..RunArgs::default()
        }
    }

    fn view(&self) -> ViewArgs {
        let picture = PictureArgs {
            arrange: Some(self.arrange),
            full_screen: self.full_screen,
            stills: self.stills.clone(),
            video: self.video.clone(),
            ..PictureArgs::default()
        };
        ViewArgs {
            headless: self.headless || (self.desk.inputs.is_some() && !self.no_picture && !has_display()),
            window: self.desk.inputs.is_none(),
            no_picture: self.no_picture,
            picture,
        }
    }
}

/// The effects of keys, mouse and gamepad, in two columns.
fn aligned() -> String {
    let width = rows().map(|(keys, _)| keys.chars().count()).max().unwrap_or(0);
    rows().map(|(keys, text)| format!("{keys:<width$}  {text}\n")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use std::path::Path;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        play: PlayArgs,
    }

    fn parse(words: &[&str]) -> Result<RunArgs, String> {
        let line = Line::try_parse_from(std::iter::once(&"play").chain(words));
        line.map(|l| l.play.run_args()).map_err(|e| e.to_string())
    }

    #[test]
    fn a_module_is_played_unless_a_scene_is_named() {
        assert_eq!(parse(&[]).unwrap().training.module.as_deref(), Some(FIRST_MODULE));
        let of = |run: &RunArgs| (run.training.module.clone(), run.training.stay);
        let shadow = parse(&["shadow", "--level", "2", "--input", "mouse"]).unwrap();
        assert_eq!((of(&shadow), shadow.training.level), ((Some("shadow".into()), true), 2));
        assert_eq!(shadow.view.picture.arrange, Some(Arrangement::Left), "one large eye");
        let scene = parse(&["--scene", "trim"]).unwrap();
        assert_eq!((of(&scene), scene.scene.scene.as_deref()), ((None, false), Some("trim")));
        for wrong in [
            &["shadow", "--scene", "trim"][..],
            &["--input", "feet"],
            &["--headless"],
            &["--input", "mouse", "--inputs", "f"],
        ] {
            assert!(parse(wrong).is_err(), "{wrong:?} was taken");
        }
    }

    #[test]
    fn the_page_shows_the_table_of_this_build() {
        let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/play.md");
        let page = std::fs::read_to_string(page).unwrap();
        let line = |(keys, text): (String, &str)| format!("| {keys} | {text} |\n");
        let table = format!("| key | what it does |\n|---|---|\n{}", rows().map(line).collect::<String>());
        assert!(page.contains(&table), "docs/play.md lacks this table:\n{table}");
    }

    #[test]
    fn keys_are_listed_in_aligned_columns() {
        let (list, rows): (_, Vec<(String, &str)>) = (aligned(), rows().collect());
        assert_eq!(list.lines().count(), rows.len());
        let column = |(line, (_, text)): (&str, &(String, &str))| {
            line.chars().count() - line.strip_suffix(text).map_or(0, |_| text.chars().count())
        };
        let columns: std::collections::BTreeSet<usize> = list.lines().zip(&rows).map(column).collect();
        assert_eq!(columns.len(), 1, "{list}");
    }
}
