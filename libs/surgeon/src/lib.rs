//! Scripted surgeons: plan ([`plan`]), error model ([`skill`]), movement ([`script`], [`motion`]),
//! and rehearsal of a scene's script without cameras ([`rehearsal`]). Everything is pure: no clock,
//! and no randomness without a seed.

mod attempt;
pub mod motion;
pub mod plan;
pub mod rehearsal;
pub mod script;
pub mod skill;
pub mod tremor;

pub use attempt::{compose, load, longest_s};

use scene::SceneError;
use scene::module::ModuleError;
use std::error::Error;

/// Whether an error says that what was asked for does not exist (a scene, module, level or surgeon), not
/// that it is defective; `None` for errors of another kind. A scene that a module's file names is the
/// file's defect.
pub fn is_wrong_use(cause: &(dyn Error + 'static)) -> Option<bool> {
    let module = cause.downcast_ref().map(ModuleError::is_wrong_use);
    let scene = cause.downcast_ref().map(SceneError::is_wrong_use);
    module.or(scene).or(cause.is::<skill::UnknownSkill>().then_some(true))
}
