//! `vitreo ctl`: sends a request (pause, resume, restart, next level, quit) to a running simulator.

use crate::runtime::{Wakeups, block_on};
use anyhow::{Context, bail};
use clap::ValueEnum;
use ipc::clock::now;
use ipc::{Instance, Queue, Receiver, instance_directory, wait};
use protocol::control::{Answer, Command, LAUNCHER, Request};
use protocol::limits::MAX_WAIT_MS;
use std::process::ExitCode;
use std::time::Duration;
use tokio::time::timeout;

/// Timeout for the launcher's answer. For the next level, it creates new tissue first.
const ANSWER: Duration = Duration::from_secs(60);

/// Arguments of `vitreo ctl`.
#[derive(Debug, clap::Args)]
pub struct CtlArgs {
    /// Request to the simulator.
    #[arg(value_enum)]
    pub what: What,
    /// Name of the simulator.
    #[arg(long, value_name = "NAME", default_value = "main")]
    pub instance: String,
}

/// Requests to a running simulator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum What {
    /// Pause the simulation.
    Pause,
    /// Continue after a pause.
    Resume,
    /// Restart the attempt at once.
    Restart,
    /// Go to the module's next level.
    Next,
    /// End the run cleanly.
    Quit,
}

impl What {
    fn command(self) -> Command {
        match self {
            What::Pause => Command::Pause,
            What::Resume => Command::Start,
            What::Restart => Command::Reset,
            What::Next => Command::Next,
            What::Quit => Command::Shutdown,
        }
    }
}

/// Runs `vitreo ctl`.
///
/// # Errors
/// If no such simulator is running, it refuses the request, or it does not answer within [`ANSWER`].
pub fn run(args: &CtlArgs) -> anyhow::Result<ExitCode> {
    block_on(request(args))
}

async fn request(args: &CtlArgs) -> anyhow::Result<ExitCode> {
    let name = &args.instance;
    if !instance_directory(name)?.join("nodes").exists() {
        bail!("no simulator named '{name}' is running; start one with: vitreo run --instance {name}");
    }
    let instance = Instance::join(name)?;
    let mut answers = instance.receiver::<Answer>(Queue::InOrder)?;
    let mut requests = instance.sender::<Request>()?;
    // A number that no other sender uses.
    let seq = now();
    requests.send(&Request { seq, argument: 0, target: LAUNCHER, command: args.what.command() as u32 })?;
    let answered = timeout(ANSWER, answer_to(seq, &mut answers)).await;
    let answer = answered
        .with_context(|| format!("the simulator '{name}' has not answered for {} s", ANSWER.as_secs()))??;
    if answer.result != 0 {
        bail!("{}", answer.text());
    }
    Ok(ExitCode::SUCCESS)
}

/// Waits for the launcher's answer to request `seq`.
async fn answer_to(seq: u64, answers: &mut Receiver<Answer>) -> anyhow::Result<Answer> {
    let wakeups = Wakeups::of(&[&*answers])?;
    loop {
        while let Some(answer) = answers.next_valid()? {
            if answer.seq == seq && answer.process == LAUNCHER {
                return Ok(answer);
            }
        }
        wakeups.wait(Duration::from_millis(MAX_WAIT_MS)).await;
        wait(&[&*answers], 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_simulator_that_does_not_run_is_named() {
        let args = CtlArgs { what: What::Pause, instance: "nobody-here-7".into() };
        let problem = run(&args).unwrap_err().to_string();
        assert!(problem.contains("nobody-here-7") && problem.contains("vitreo run"), "{problem}");
        assert!(!instance_directory("nobody-here-7").unwrap().exists(), "asking leaves nothing behind");
    }
}
