//! Exit codes of this program's errors.

pub use outputs::exit::*;

use crate::objects::ObjectError;
use ipc::IpcError;
use results::store::StoreError;
use scene::SceneError;
use scene::module::ModuleError;
use std::error::Error;

/// The exit code of a command that ends with an error.
pub fn code_of(error: &anyhow::Error) -> u8 {
    if error.chain().find_map(is_wrong_use) == Some(true) { WRONG_USE } else { FAILED }
}

/// Whether a cause is wrong use; `None` where that depends on its own cause.
fn is_wrong_use(cause: &(dyn Error + 'static)) -> Option<bool> {
    if let Some(module) = cause.downcast_ref() {
        // A scene that a module's file names is the file's defect.
        return Some(matches!(module, ModuleError::Missing { .. } | ModuleError::Level { .. }));
    }
    if let Some(scene) = cause.downcast_ref() {
        return Some(matches!(scene, SceneError::Missing { .. }));
    }
    if let Some(transport) = cause.downcast_ref() {
        return Some(matches!(transport, IpcError::InstanceName(_)));
    }
    if let Some(store) = cause.downcast_ref() {
        return Some(matches!(store, StoreError::Value { field: "trainee", .. }));
    }
    if let Some(object) = cause.downcast_ref() {
        return Some(ObjectError::is_wrong_use(object));
    }
    cause.is::<WrongUse>().then_some(true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::anyhow;

    #[test]
    fn what_does_not_exist_is_wrong_use_and_what_is_defective_is_a_failure() {
        let missing = || SceneError::Missing { name: "x".into(), shipped: "peel".into() };
        let wrong: [anyhow::Error; 7] = [
            results::store::check_name("a b").unwrap_err().into(),
            WrongUse("--until".into()).into(),
            ObjectError::NotBuilt("s3://b/a.mcap".into()).into(),
            anyhow::Error::from(missing()).context("the scene"),
            ModuleError::Missing { name: "x".into(), shipped: "peeling".into() }.into(),
            ModuleError::Level { name: "peeling".into(), levels: 2, found: 9 }.into(),
            IpcError::InstanceName("a b".into()).into(),
        ];
        wrong.iter().for_each(|error| assert_eq!(code_of(error), WRONG_USE, "{error:#}"));
        let failed: [anyhow::Error; 4] = [
            anyhow!("no"),
            ObjectError::Absent("s3://b/a.mcap".into()).into(),
            ModuleError::Scene { name: "own".into(), source: missing() }.into(),
            IpcError::InUse("main".into()).into(),
        ];
        failed.iter().for_each(|error| assert_eq!(code_of(error), FAILED, "{error:#}"));
    }
}
