//! Scheduling of child processes and of the launcher's own threads.

use anyhow::{Context, ensure};
use ipc::programs::set_environment;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::OnceLock;

/// Priority of real-time processes, 1 to 99: above ordinary processes, below the kernel's threads.
pub const REALTIME_PRIORITY: &str = "10";

/// True if `chrt` is installed and this user may start real-time processes. The test runs once.
pub fn realtime_allowed() -> bool {
    static ALLOWED: OnceLock<bool> = OnceLock::new();
    *ALLOWED.get_or_init(|| {
        let mut attempt = Command::new("chrt");
        attempt.args(["--rr", REALTIME_PRIORITY, "true"]);
        attempt.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        attempt.status().is_ok_and(|s| s.success())
    })
}

/// Puts the calling thread under the real-time scheduler with the same priority as the child processes, so
/// that it waits no longer for the processor than they do.
///
/// # Errors
/// If `chrt` is missing or refuses.
pub fn raise_this_thread() -> anyhow::Result<()> {
    let thread = rustix::thread::gettid().as_raw_nonzero().to_string();
    let mut raise = Command::new("chrt");
    raise.args(["--rr", "--pid", REALTIME_PRIORITY, &thread]);
    let raised = raise.stdin(Stdio::null()).output().context("chrt")?;
    let message = String::from_utf8_lossy(&raised.stderr).trim().to_owned();
    ensure!(raised.status.success(), "real-time scheduling is refused: {message}");
    Ok(())
}

/// A command that starts a program, under the real-time scheduler if `realtime`.
pub fn scheduled_command(program: &Path, realtime: bool) -> Command {
    let mut command = Command::new(if realtime { Path::new("chrt") } else { program });
    if realtime {
        // `chrt` replaces itself with the program, so the child's id is that of the program.
        command.args(["--rr", REALTIME_PRIORITY]).arg(program);
    }
    set_environment(&mut command);
    command
}
