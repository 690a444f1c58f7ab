//! Exit codes of this program's errors.

use crate::pace::Stopped;
use crate::score::objects::ObjectError;
use ipc::IpcError;
use outputs::exit::{FAILED, INTERRUPTED, WRONG_USE, WrongUse};
use std::error::Error;

/// The exit code of a command that ends with an error.
pub fn code_of(error: &anyhow::Error) -> u8 {
    if error.is::<Stopped>() {
        return INTERRUPTED;
    }
    if error.chain().find_map(is_wrong_use) == Some(true) { WRONG_USE } else { FAILED }
}

/// Whether a cause is wrong use; `None` where that depends on its own cause.
fn is_wrong_use(cause: &(dyn Error + 'static)) -> Option<bool> {
    let named = || cause.downcast_ref().map(|error| matches!(error, IpcError::InstanceName(_)));
    let own = cause.downcast_ref().map(ObjectError::is_wrong_use).or_else(named);
    let known =
        own.or_else(|| surgeon::is_wrong_use(cause)).or_else(|| results::keeping::is_wrong_use(cause));
    known.or(cause.is::<WrongUse>().then_some(true))
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::anyhow;
    use results::StoreError;
    use scene::SceneError;
    use scene::module::ModuleError;

    #[test]
    fn unknown_names_are_wrong_use_and_missing_or_defective_files_are_failures() {
        let scene = |name: &str| SceneError::Missing { name: name.into(), shipped: "peel".into() };
        let module = |name: &str| ModuleError::Missing { name: name.into(), shipped: "peeling".into() };
        let wrong: [anyhow::Error; 8] = [
            IpcError::InstanceName("a b".into()).into(),
            results::store::check_name("a b").unwrap_err().into(),
            WrongUse("--until".into()).into(),
            surgeon::skill::named("genius").unwrap_err().into(),
            ObjectError::NotBuilt("s3://b/a.mcap".into()).into(),
            anyhow::Error::from(scene("x")).context("the scene"),
            module("x").into(),
            ModuleError::Level { name: "peeling".into(), levels: 2, found: 9 }.into(),
        ];
        wrong.iter().for_each(|error| assert_eq!(code_of(error), WRONG_USE, "{error:#}"));
        let failed: [anyhow::Error; 7] = [
            scene("own.toml").into(),
            scene("scenes/own").into(),
            module("/nowhere/own").into(),
            anyhow!("no"),
            ObjectError::Absent("s3://b/a.mcap".into()).into(),
            ModuleError::Scene { name: "own".into(), source: scene("x") }.into(),
            StoreError::Value { field: "module", found: String::new(), expected: "a name".into() }.into(),
        ];
        assert_eq!(code_of(&Stopped.into()), INTERRUPTED);
        failed.iter().for_each(|error| assert_eq!(code_of(error), FAILED, "{error:#}"));
    }
}
