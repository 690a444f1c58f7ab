//! The scripted surgeon of the scene file.

use crate::config::Config;
use anyhow::{Context, Result};
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};
use surgeon::motion::recorded::RecordedMotion;
use surgeon::motion::{MotionSource, MotionUse};

/// Note of a scene without a script.
const NO_SCRIPT: &str = "the scene has no script: instruments rest";

/// The surgeon of the scene, with a recorded motion where one is given.
pub(super) struct ScriptedSurgeon {
    /// Motion of instruments, eye and pedal.
    pub(super) motion: MotionSource,
    /// The motion as before the first field, without perception.
    pub(super) fresh: MotionSource,
    /// Note in the heartbeat while the process runs without a defect.
    pub(super) note: &'static str,
}

impl ScriptedSurgeon {
    /// Loads the scene and the recorded motion.
    pub(super) fn load(config: &Config, rig: &Rig) -> Result<Self> {
        let scene = SceneFile::load(config.scene.name(DEFAULT_SCENE))?;
        let recorded =
            config.cameras.motion.as_deref().map(RecordedMotion::load).transpose().context("--motion")?;
        let recorded =
            recorded.map(if config.cameras.motion_full { MotionUse::Full } else { MotionUse::Tremor });
        let motion = MotionSource::new(&scene, rig, recorded, config.cameras.seed);
        let scripted = scene.script.is_some() || config.cameras.motion_full;
        Ok(ScriptedSurgeon { fresh: motion.clone(), motion, note: if scripted { "" } else { NO_SCRIPT } })
    }
}
