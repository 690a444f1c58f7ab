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
    /// Play the scene's script alone, write the scene of every N-th field to standard output, and end.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), conflicts_with_all = ["resume", "again"])]
    pub film: Option<u64>,
    /// Seed of the tremor in a film; none without it.
    #[arg(long, value_name = "SEED", requires = "film")]
    pub film_seed: Option<u64>,
    /// Length of a film, s; without it a round of the script.
    #[arg(long, value_name = "S", requires = "film")]
    pub film_length: Option<f64>,
}
