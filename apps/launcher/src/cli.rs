//! The command line: one sub-command a module.

use crate::forward::{self, ForwardArgs};
use crate::programs::{BRIDGE, CALIBRATION, CAMERA, COMMISSION, CONTROLS, RENDERER, REPLAY, STREAMS};
use clap::{CommandFactory, Parser, Subcommand};
use ipc::logging::LogArgs;
use settings::SettingsArgs;
use settings::commands::RecordingCommand;
use settings::commands::bridge::BridgeCommand;
use std::process::ExitCode;

/// A real-time simulator for training surgery inside the eye.
#[derive(Debug, Parser)]
#[command(name = "vitreo", version, about, arg_required_else_help = true)]
pub struct Cli {
    /// Logging, of this program and of those that it starts.
    #[command(flatten)]
    pub log: LogArgs,
    /// Whether files of settings are read.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The sub-commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the simulator: cameras, tracker, tissue and picture.
    Run(Box<crate::run::RunArgs>),
    /// Move the instruments yourself, by mouse, keyboard or gamepad.
    Play(Box<crate::play::PlayArgs>),
    /// Pause, restart, take the next level of or end a running simulator.
    Ctl(crate::ctl::CtlArgs),
    /// Those on recordings.
    #[command(flatten)]
    OnRecording(RecordingCommand),
    /// To other programs.
    #[command(flatten)]
    ToOthers(BridgeCommand),
    /// List the training modules.
    Modules(crate::modules::ModulesArgs),
    /// Find the blobs in pictures and clips.
    Blobs(ForwardArgs),
    /// Learn, show and check the camera's colour classes.
    Colours(ForwardArgs),
    /// Print the registers and memories of the camera hardware.
    Hardware(ForwardArgs),
    /// Write or replay the test vectors of the camera hardware.
    Vectors(ForwardArgs),
    /// Find lenses, places of cameras, markers and trocars; check whether they still hold.
    Calibrate(ForwardArgs),
    /// Take a new rig into use, step by step: colours, lenses, cameras, trocars, and a check of all.
    Commission(ForwardArgs),
    /// List the cameras of this machine, or show how those of a rig stand.
    Cameras(ForwardArgs),
    /// Show what a foot pedal does, or learn its mapping.
    Pedal(ForwardArgs),
    /// Show what the handles send, or calibrate their jaws.
    Handles(ForwardArgs),
    /// Look at a rig file: what its cameras see, and what is missing.
    Rig(ForwardArgs),
    /// Measure what a part costs on this machine.
    Bench(ForwardArgs),
    /// Judge reports of runs by their latency budgets.
    Budgets(crate::budgets::BudgetsArgs),
    /// Measure how long poses take on this machine, and write the certificate.
    Certify(Box<crate::certify::CertifyArgs>),
    /// Say what this machine has and lacks.
    Doctor(crate::doctor::DoctorArgs),
    /// Show what is set, and where; write a file of settings.
    Config(crate::config::ConfigArgs),
    /// Print completions for a shell.
    Completions(crate::manual::CompletionsArgs),
    /// Write the manual's pages.
    Man(crate::manual::ManArgs),
}

/// Runs the chosen sub-command.
///
/// # Errors
/// Those of the sub-command.
pub fn dispatch(cli: &Cli) -> anyhow::Result<ExitCode> {
    match &cli.command {
        Command::Run(args) => crate::run::run(args),
        Command::Play(args) => crate::play::run(args),
        Command::Ctl(args) => crate::ctl::run(args),
        Command::OnRecording(_) => forward::whole(REPLAY),
        Command::ToOthers(_) => forward::whole(BRIDGE),
        Command::Modules(args) => crate::modules::run(args),
        Command::Blobs(args) => forward::to(CAMERA, "vitreo", Some("blobs"), &cli.settings, args),
        Command::Colours(args) => forward::to(CAMERA, "vitreo", Some("colours"), &cli.settings, args),
        Command::Hardware(args) => forward::to(CAMERA, "vitreo", Some("hardware"), &cli.settings, args),
        Command::Vectors(args) => forward::to(CAMERA, "vitreo", Some("vectors"), &cli.settings, args),
        Command::Rig(args) => forward::to(CALIBRATION, "vitreo", Some("rig"), &cli.settings, args),
        Command::Calibrate(args) => forward::to(CALIBRATION, "vitreo calibrate", None, &cli.settings, args),
        Command::Commission(args) => forward::to(COMMISSION, "vitreo commission", None, &cli.settings, args),
        Command::Cameras(args) => forward::to(STREAMS, "vitreo", Some("cameras"), &cli.settings, args),
        Command::Pedal(args) => forward::to(CONTROLS, "vitreo", Some("pedal"), &cli.settings, args),
        Command::Handles(args) => forward::to(CONTROLS, "vitreo", Some("handles"), &cli.settings, args),
        Command::Bench(args) => forward::to(RENDERER, "vitreo", Some("bench"), &cli.settings, args),
        Command::Budgets(args) => crate::budgets::run(args),
        Command::Certify(args) => crate::certify::run(args),
        Command::Doctor(args) => crate::doctor::run(args),
        Command::Config(args) => crate::config::run(args, Cli::command()),
        Command::Completions(args) => crate::manual::completions(args, Cli::command()),
        Command::Man(args) => crate::manual::man(args, Cli::command()),
    }
}
