//! Arguments of the process.

use collision::backend::Backend;
use ipc::shell::ShellArgs;
use settings::commands::processes::{CollisionArgs, SceneArgs};
use std::path::PathBuf;

/// Simulate collisions and tissue of the eye.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "vitreo-simcore", version)]
pub struct Args {
    /// The scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Back end of collision detection.
    #[command(flatten)]
    pub collision: CollisionArgs,
    /// Resume from this journal: its newest checkpoint and the inputs since.
    #[arg(long, value_name = "FILE")]
    pub resume: Option<PathBuf>,
    /// Arguments of every process.
    #[command(flatten)]
    pub shell: ShellArgs,
}

impl Args {
    /// The back end of collisions.
    pub fn backend(&self) -> Backend {
        self.collision.collision.as_deref().and_then(Backend::named).unwrap_or_default()
    }
}
