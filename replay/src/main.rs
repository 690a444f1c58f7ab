//! `vitreo-replay`: `vitreo replay`, and the simulation without cameras and clock for `vitreo score
//! --resimulate` and `vitreo film`.

use anyhow::Context;
use ipc::logging::{LogArgs, message};
use outputs::exit::{DIFFERS, LOSS, WRONG_USE, WrongUse};
use outputs::{Force, Outputs};
use replay::recorded_film::{self, Part};
use replay::resimulate;
use replay::steps::Resimulated;
use scene::{DEFAULT_SCENE, SceneFile};
use settings::commands::RecordingCommand;
use settings::{Program, SettingsArgs};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// What vitreo.toml says to this program: to the command that people type, under its own name.
const SETTINGS: Program =
    Program { prefix: "", without: &["resimulate", "scenes", "recorded-scenes"], elsewhere: None };

/// Recordings again, in one process and without a clock.
#[derive(Debug, clap::Parser)]
#[command(name = "vitreo", version)]
struct Args {
    #[command(flatten)]
    log: LogArgs,
    #[command(flatten)]
    settings: SettingsArgs,
    #[command(subcommand)]
    command: Command,
}

/// The sub-commands.
#[derive(Debug, clap::Subcommand)]
enum Command {
    #[command(flatten)]
    OnRecording(RecordingCommand),
    /// Do every step of a recording again, and write what comes of it into another.
    Resimulate {
        /// The recording.
        #[arg(value_name = "FILE.mcap")]
        file: PathBuf,
        /// Poses, steps and events of the resimulated run; - is standard output.
        #[arg(value_name = "OUT.mcap")]
        out: PathBuf,
        #[command(flatten)]
        force: Force,
    },
    /// Play a scene's script, and write the scene of every N-th field to standard output.
    Scenes {
        /// Scene: a shipped one by name, or a TOML file.
        #[arg(long, default_value = DEFAULT_SCENE)]
        scene: String,
        /// One scene every so many fields.
        #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
        every: u64,
        /// Seed of the tremor; none without it.
        #[arg(long)]
        seed: Option<u64>,
        /// Length, s; without it a round of the script.
        #[arg(long, value_name = "S")]
        length: Option<f64>,
    },
    /// Do every step of a recording again, and write the scene of every 40 ms to standard output.
    RecordedScenes {
        /// The recording.
        #[arg(value_name = "FILE.mcap")]
        file: PathBuf,
        /// Where the film begins, s after the first exposure.
        #[arg(long, value_name = "S", default_value_t = 0.0)]
        from: f64,
        /// Where it ends; without it at the recording's end.
        #[arg(long, value_name = "S")]
        until: Option<f64>,
    },
}

fn main() -> ExitCode {
    let args: Args = match settings::parse(&SETTINGS) {
        Ok(args) => args,
        Err((problem, log)) => return ipc::logging::wrong_use("replay", &log, &problem),
    };
    ipc::logging::init("replay", &args.log);
    let fail = |error: &anyhow::Error| match (ipc::logging::fail(error.as_ref()), error.is::<WrongUse>()) {
        (_, true) => ExitCode::from(WRONG_USE),
        (code, false) => code,
    };
    outputs::exit_code(run(args.command), fail, ipc::logging::warn)
}

fn run(command: Command) -> anyhow::Result<ExitCode> {
    match command {
        Command::OnRecording(command) => match command {
            RecordingCommand::Replay(args) => replay::command::run(&args),
            RecordingCommand::Import(args) => replay::import::run(&args),
            RecordingCommand::Export(args) => replay::export::run(&args),
            RecordingCommand::Recover(args) => replay::recover::run(&args),
            RecordingCommand::Info(args) => replay::info::run(&args),
            RecordingCommand::Trace(args) => replay::trace::run(&args),
        },
        Command::Scenes { scene, every, seed, length } => {
            let scene = SceneFile::load(&scene).context("scene")?;
            let mut out = BufWriter::new(std::io::stdout().lock());
            replay::film::write(&scene, seed, every, length, &mut out)?;
            Ok(ExitCode::SUCCESS)
        }
        Command::RecordedScenes { file, from, until } => {
            Ok(ExitCode::from(film_recording(&file, Part { from_s: from, until_s: until })?))
        }
        Command::Resimulate { file, out, force } => {
            let mut out = Outputs::new(force.force).reading(&file).grow(&out)?;
            let done = resimulate::run(&file, &out)?;
            out.appear()?;
            Ok(ExitCode::from(tell(&file, &done)))
        }
    }
}

/// Writes the scenes of a recording; the exit code. A film shows what happened: whoever looks at it
/// must know where it does not.
fn film_recording(file: &Path, part: Part) -> anyhow::Result<u8> {
    let mut out = BufWriter::new(std::io::stdout().lock());
    let done = recorded_film::write(file, part, &mut out)?;
    if let Some(damage) = &done.damage {
        message(tracing::Level::WARN, damage);
    }
    if let Some(version) = done.other_state_hash_version {
        let file = file.display();
        let told = format!("{file}: its state hashes are of version {version}: states cannot be compared");
        message(tracing::Level::WARN, &told);
    }
    Ok(match (tell(file, &done), &done) {
        (_, Resimulated { differs_at: Some(_), .. }) => DIFFERS,
        (0, Resimulated { other_state_hash_version: Some(_), .. }) => LOSS,
        (code, _) => code,
    })
}

/// Tells what is not as it was recorded; the exit code.
fn tell(file: &Path, done: &Resimulated) -> u8 {
    let warn = |text: String| message(tracing::Level::WARN, &format!("{}: {text}", file.display()));
    if let Some(step) = done.differs_at {
        warn(format!("from step {step} on the state is not the recorded one"));
    }
    let (undone, gaps) = (done.undone, done.gaps);
    if undone > 0 || gaps > 0 {
        warn(format!("inputs of {undone} steps are missing; gone on from a checkpoint {gaps} times"));
    }
    if done.has_gaps() { LOSS } else { 0 }
}
