//! Arguments of the process.

use crate::collision::choice::Backend;
use protocol::scene_file::DEFAULT_SCENE;
use protocol::shell::ShellArgs;
use std::path::PathBuf;

/// Collision and tissue of the vitreo eye.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "vitreo-simcore", version)]
pub struct Args {
    /// What every process takes.
    #[command(flatten)]
    pub shell: ShellArgs,
    /// Scene: a shipped one by name, or a TOML file.
    #[arg(long, default_value = DEFAULT_SCENE)]
    pub scene: String,
    /// Who looks for collisions; it changes no result. `auto` measures at start-up which is faster.
    #[arg(long, value_enum, default_value_t, value_name = "WHO")]
    pub collision: Backend,
    /// Recording to go on from: its newest checkpoint, and the steps since.
    #[arg(long, value_name = "FILE.mcap")]
    pub resume: Option<PathBuf>,
    /// Do every step of a recording again, alone, write what comes of it into another, and end.
    #[arg(long, num_args = 2, value_names = ["FILE.mcap", "OUT.mcap"], conflicts_with = "resume")]
    pub again: Option<Vec<PathBuf>>,
}
