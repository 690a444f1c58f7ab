//! Maps this program's errors to exit codes.

pub use outputs::exit::*;

use ipc::IpcError;
use std::error::Error;

/// The exit code of a command that ends with an error.
pub fn code_of(error: &anyhow::Error) -> u8 {
    if error.chain().find_map(is_wrong_use) == Some(true) { WRONG_USE } else { FAILED }
}

/// True if the cause is wrong usage, false if it is another failure; `None` if that depends on its own cause.
fn is_wrong_use(cause: &(dyn Error + 'static)) -> Option<bool> {
    let own = cause.downcast_ref().map(|error| matches!(error, IpcError::InstanceName(_)));
    let known =
        own.or_else(|| surgeon::is_wrong_use(cause)).or_else(|| results::keeping::is_wrong_use(cause));
    known.or((cause.is::<WrongUse>() || cause.is::<settings::Problem>()).then_some(true))
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::anyhow;
    use scene::SceneError;
    use scene::module::ModuleError;

    #[test]
    fn unknown_names_are_wrong_use_and_missing_or_defective_files_are_failures() {
        let scene = |name: &str| SceneError::Missing { name: name.into(), shipped: "peel".into() };
        let module = |name: &str| ModuleError::Missing { name: name.into(), shipped: "peeling".into() };
        let wrong: [anyhow::Error; 6] = [
            results::store::check_name("a b").unwrap_err().into(),
            WrongUse("--until".into()).into(),
            anyhow::Error::from(scene("x")).context("the scene"),
            module("x").into(),
            ModuleError::Level { name: "peeling".into(), levels: 2, found: 9 }.into(),
            IpcError::InstanceName("a b".into()).into(),
        ];
        wrong.iter().for_each(|error| assert_eq!(code_of(error), WRONG_USE, "{error:#}"));
        let failed: [anyhow::Error; 6] = [
            scene("own.toml").into(),
            scene("scenes/own").into(),
            module("/nowhere/own").into(),
            anyhow!("no"),
            ModuleError::Scene { name: "own".into(), source: scene("x") }.into(),
            IpcError::InUse("main".into()).into(),
        ];
        failed.iter().for_each(|error| assert_eq!(code_of(error), FAILED, "{error:#}"));
    }
}
