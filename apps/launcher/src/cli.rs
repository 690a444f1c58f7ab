//! The command line of `vitreo`; each sub-command has its own module.

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
    /// Whether files of settings are read.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// Logging, of this program and of those that it starts.
    #[command(flatten)]
    pub log: LogArgs,
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The sub-commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the simulator: cameras, tracker, tissue and picture.
    Run(Box<crate::run::RunArgs>),
    /// Train with mouse, keyboard or gamepad.
    Play(Box<crate::play::PlayArgs>),
    /// Control a running simulator: pause, resume, restart, next level, quit.
    Ctl(crate::ctl::CtlArgs),
    /// Those on recordings.
    #[command(flatten)]
    OnRecording(RecordingCommand),
    /// To other programs.
    #[command(flatten)]
    ToOthers(BridgeCommand),
    /// List the training modules.
    Modules(crate::modules::ModulesArgs),
    /// Find blobs in pictures and clips.
    Blobs(ForwardArgs),
    /// Learn, show and check colour classes.
    Colours(ForwardArgs),
    /// Print registers, memories and clocks of the camera hardware.
    Hardware(ForwardArgs),
    /// Write test vectors for the camera hardware.
    Vectors(ForwardArgs),
    /// Calibrate lenses, camera poses, markers and trocars; check for drift.
    Calibrate(ForwardArgs),
    /// Commission a new rig step by step: colours, lenses, camera poses, trocars, final check.
    Commission(ForwardArgs),
    /// List this machine's cameras, or monitor a rig's cameras.
    Cameras(ForwardArgs),
    /// Show a foot pedal's inputs, or learn its mapping.
    Pedal(ForwardArgs),
    /// Show the handles' inputs, or calibrate their jaws.
    Handles(ForwardArgs),
    /// Check a rig file: how much its cameras see, and how accurately they measure.
    Rig(ForwardArgs),
    /// Measure the cost of a part on this machine.
    Bench(ForwardArgs),
    /// Check reports of runs against the latency budgets.
    Budgets(crate::budgets::BudgetsArgs),
    /// Measure this machine's latency and write a certificate.
    Certify(Box<crate::certify::CertifyArgs>),
    /// Check this machine for everything the simulator needs.
    Doctor(crate::doctor::DoctorArgs),
    /// Show the settings and their sources, or write a settings file.
    Config(crate::config::ConfigArgs),
    /// Print shell completions.
    Completions(crate::manual::CompletionsArgs),
    /// Write the manual pages.
    Man(crate::manual::ManArgs),
}

/// Runs the chosen sub-command.
///
/// # Errors
/// The errors of the sub-command.
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
