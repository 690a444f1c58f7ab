//! Arguments of the process.

use collision::backend::Backend;
use ipc::shell::ShellArgs;
use settings::commands::processes::{CollisionArgs, SceneArgs};
use std::path::PathBuf;

/// Collision and tissue of the vitreo eye.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "vitreo-simcore", version)]
pub struct Args {
    /// What every process takes.
    #[command(flatten)]
    pub shell: ShellArgs,
    /// The scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Back end of collision detection.
    #[command(flatten)]
    pub collision: CollisionArgs,
    /// Journal to go on from: the newest checkpoint, and the inputs since.
    #[arg(long, value_name = "FILE")]
    pub resume: Option<PathBuf>,
}

impl Args {
    /// The back end of collisions.
    pub fn backend(&self) -> Backend {
        self.collision.collision.as_deref().and_then(Backend::named).unwrap_or_default()
    }
}
