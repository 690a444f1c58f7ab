//! `vitreo doctor`: checks this machine and names a remedy for each problem.

mod devices;
mod graphics;
mod leftovers;
mod rig;
mod system;

use crate::exit::FAILED;
use outputs::{print, println};
use serde::Serialize;
use std::process::ExitCode;

/// Arguments of `vitreo doctor`.
#[derive(Debug, clap::Args)]
pub struct DoctorArgs {
    /// Also check the devices configured in table [run] of the settings: rig file, cameras, pedal, handles and
    /// display, and this user's access to them.
    #[arg(long)]
    pub rig: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Result of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// No problem.
    Ok,
    /// Works with a limitation.
    Warn,
    /// Does not work.
    Fail,
}

/// A check with its result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Check {
    /// Name of the check.
    pub name: &'static str,
    /// Result.
    pub state: State,
    /// What was found.
    pub found: String,
    /// Command or advice that fixes the problem.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mend: Option<String>,
}

impl Check {
    fn ok(name: &'static str, found: impl Into<String>) -> Self {
        Check { name, state: State::Ok, found: found.into(), mend: None }
    }

    fn warn(name: &'static str, found: impl Into<String>, mend: impl Into<String>) -> Self {
        Check { name, state: State::Warn, found: found.into(), mend: Some(mend.into()) }
    }

    fn fail(name: &'static str, found: impl Into<String>, mend: impl Into<String>) -> Self {
        Check { name, state: State::Fail, found: found.into(), mend: Some(mend.into()) }
    }
}

fn every_check() -> Vec<Check> {
    let mut checks = system::checks();
    checks.extend(leftovers::checks());
    checks.extend(graphics::checks());
    checks.extend(devices::checks());
    checks
}

fn table(checks: &[Check]) -> String {
    let line = |c: &Check| {
        let mark = match c.state {
            State::Ok => "ok  ",
            State::Warn => "warn",
            State::Fail => "FAIL",
        };
        let mend = c.mend.as_ref().map(|m| format!("\n        → {m}")).unwrap_or_default();
        format!("{mark}  {}: {}{mend}\n", c.name, c.found)
    };
    checks.iter().map(line).collect()
}

/// Runs `vitreo doctor`. The exit code is [`FAILED`] if a check fails.
///
/// # Errors
/// If the JSON cannot be written.
pub fn run(args: &DoctorArgs) -> anyhow::Result<ExitCode> {
    let mut checks = every_check();
    if args.rig {
        checks.extend(rig::checks());
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&checks)?);
    } else {
        print!("{}", table(&checks));
    }
    let failed = checks.iter().any(|c| c.state == State::Fail);
    Ok(if failed { ExitCode::from(FAILED) } else { ExitCode::SUCCESS })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_complaint_says_what_to_do() {
        for check in every_check().into_iter().chain(rig::checks()) {
            assert_eq!(check.state == State::Ok, check.mend.is_none(), "{check:?}");
            assert!(!check.found.is_empty(), "{check:?}");
        }
    }

    #[test]
    fn the_table_shows_state_and_remedy() {
        let text = table(&[Check::ok("a", "fine"), Check::fail("b", "absent", "install b")]);
        assert_eq!(text, "ok    a: fine\nFAIL  b: absent\n        → install b\n");
    }
}
