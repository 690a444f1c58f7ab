//! Sub-commands of `vitreo-fpga-model`.
//!
//! `vitreo blobs …` is `vitreo-fpga-model blobs …`, and so on for each of them.

pub mod blobs;
pub mod colours;
pub mod extractor;
pub mod finder;
pub mod hardware;
pub mod progress;
pub mod vectors;

/// The sub-commands, one a module.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum Command {
    /// Find blobs in pictures and clips.
    Blobs(Box<blobs::BlobsArgs>),
    /// Learn, show and check colour classes.
    Colours(colours::ColoursArgs),
    /// Print registers, memories and clocks of the camera hardware.
    Hardware(hardware::HardwareArgs),
    /// Write test vectors for the camera hardware.
    Vectors(vectors::VectorsArgs),
}

/// Runs a sub-command.
///
/// # Errors
/// As the command run.
pub fn run(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Blobs(args) => blobs::run(args),
        Command::Colours(args) => colours::run(args),
        Command::Hardware(args) => hardware::run(args),
        Command::Vectors(args) => vectors::run(args),
    }
}
