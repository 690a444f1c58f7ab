//! Sub-commands of `vitreo-controls`, for a person at a terminal.
//!
//! `vitreo pedal …` is `vitreo-controls pedal …`, and so on for each of them.

pub mod handles;
pub mod pedal;
mod person;

/// The sub-commands, one a module.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum Command {
    /// Show a foot pedal's inputs, or learn its mapping.
    Pedal(pedal::PedalArgs),
    /// Show the handles' inputs, or calibrate their jaws.
    Handles(handles::HandlesArgs),
}

/// Runs a sub-command.
///
/// # Errors
/// As the command run.
pub fn run(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Pedal(args) => pedal::run(args),
        Command::Handles(args) => handles::run(args),
    }
}
