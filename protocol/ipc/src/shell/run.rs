//! The loop of every process. A turn is: rest, work, heartbeat, at most one command.
//!
//! Work comes before commands, so that nothing stands between a message and the work that it woke the
//! process for, and so that a command finds everything done that came before it.

use super::Shell;
use crate::IpcError;
use crate::clock::now;
use protocol::control::Command;
use protocol::health::STATE_RUNNING;
use protocol::time::Nanos;
use std::fmt::Display;

/// What one process does in the loop. An error of it ends the process.
pub trait Work<E> {
    /// The process's ties to the launcher.
    fn shell(&mut self) -> &mut Shell;

    /// The state in which it begins. What has to wait for something first begins with
    /// [`STATE_STARTING`](protocol::health::STATE_STARTING), and says itself when it is at work.
    fn first_state(&self) -> u32 {
        STATE_RUNNING
    }

    /// Rests until there may be work, by [`Shell::rest`] or [`Shell::rest_to`], or not at all.
    fn rest(&mut self);

    /// How long the process slept before this turn ([`crate::awake`]), ns: what arrived meanwhile is outdated.
    /// Returns how many fields it passed over for that, which is logged.
    ///
    /// # Errors
    /// Where a channel fails.
    fn slept(&mut self, _slept_ns: u64) -> Result<u64, E> {
        Ok(0)
    }

    /// Does what there is to do, and brings the next heartbeat up to date. It may find nothing: any
    /// message and any command ends a rest. `woken`: when the rest ended.
    ///
    /// # Errors
    /// Where the process cannot go on.
    fn turn(&mut self, woken: Nanos) -> Result<(), E>;

    /// Executes a command, any but `Ping` and `Shutdown`.
    ///
    /// # Errors
    /// Where the process cannot go on. What it will not do it refuses instead.
    fn execute(&mut self, command: Command, argument: u64) -> Result<Served, E>;
}

/// What became of a command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Served {
    /// It is done.
    Done,
    /// It asks nothing of this process. Of what is asked of all together that is as good as done.
    NothingToDo,
    /// It is not possible, for this reason.
    Refused(String),
}

impl Served {
    /// Done, or refused with the error and its causes.
    pub fn of<E: Display>(done: Result<(), E>) -> Self {
        done.map_or_else(|e| Served::Refused(format!("{e:#}")), |()| Served::Done)
    }

    /// Why the answer is a refusal, if it is one.
    fn refusal(self, command: Command) -> Option<String> {
        match (self, command) {
            (Served::Refused(why), _) => Some(why),
            // What is asked of one process alone.
            (Served::NothingToDo, Command::Snapshot | Command::Next | Command::Help) => {
                Some(format!("does not support the command '{command:?}'").to_lowercase())
            }
            _ => None,
        }
    }
}

/// Runs a process that is ready: reports its first state, running, then takes turns until a request, a signal
/// or the process itself ([`Shell::stop`]) stops it; then leaves its part of the trace.
///
/// # Errors
/// Where a channel fails, or the work.
pub fn run<E: From<IpcError>>(work: &mut impl Work<E>) -> Result<(), E> {
    let ended = take_turns(work);
    work.shell().trace.leave();
    ended
}

fn take_turns<E: From<IpcError>>(work: &mut impl Work<E>) -> Result<(), E> {
    let state = work.first_state();
    let shell = work.shell();
    shell.report.state = state;
    shell.beat_now(now())?;
    while !work.shell().stopping() {
        work.rest();
        let woken = now();
        if let Some(slept_ns) = work.shell().awake.slept(woken) {
            let passed_over = work.slept(slept_ns)?;
            if passed_over > 0 {
                tracing::warn!(
                    "the machine was suspended for {:.1} s: {passed_over} fields skipped",
                    slept_ns as f64 * 1e-9
                );
            }
        }
        work.turn(woken)?;
        serve(work)?;
    }
    Ok(())
}

/// Sends the heartbeat if it is due, and serves the next command. One a turn: of two commands the second
/// finds everything done that came before it.
fn serve<E: From<IpcError>>(work: &mut impl Work<E>) -> Result<(), E> {
    let next = work.shell().next_command(now())?;
    work.shell().served = next.is_some();
    let Some((request, command)) = next else { return Ok(()) };
    let begun = now();
    let refusal = work.execute(command, request.argument)?.refusal(command);
    let shell = work.shell();
    // What a command takes is no sleep.
    shell.awake.excuse(now() - begun);
    let refusal = refusal.map(|why| format!("{}: {why}", shell.process.name()));
    Ok(shell.answer(&request, refusal.as_deref())?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::awake::SLEPT_NS;
    use crate::clock::sleep_until;
    use crate::logging::LogArgs;
    use crate::shell::ShellArgs;
    use crate::trace::TraceArgs;
    use crate::{Instance, Queue, Receiver, Sender};
    use protocol::control::{Answer, EVERY_PROCESS, Request};
    use protocol::health::{Health, Process};

    /// What a test asks of the process, in this order.
    const ANY: [Command; 4] = [Command::Start, Command::Reset, Command::Snapshot, Command::Load];

    #[derive(Debug, PartialEq)]
    enum Failure {
        Channel,
        Broken,
    }

    impl From<IpcError> for Failure {
        fn from(_: IpcError) -> Self {
            Failure::Channel
        }
    }

    /// A process that notes what it does, and whoever speaks with it.
    struct Fake {
        shell: Shell,
        done: Vec<String>,
        /// What it does in its turn, beside noting it.
        work: fn(&mut Fake) -> Result<(), Failure>,
        /// For how long a command keeps it, ns.
        takes_ns: u64,
        requests: Sender<Request>,
        answers: Receiver<Answer>,
        health: Receiver<Health>,
        _instance: Instance,
    }

    impl Fake {
        fn new(test: &str, work: fn(&mut Fake) -> Result<(), Failure>) -> Fake {
            let name = format!("r{}-{test}", std::process::id() % 1_000_000);
            let instance = Instance::own(&name).unwrap();
            let (log, trace) = (LogArgs::default(), TraceArgs { trace_spans: Some(100) });
            let args = ShellArgs { instance: name, supervised: false, inject_delay_ms: 0.0, log, trace };
            let (_, shell) = Shell::start(Process::Tracker, &args).unwrap();
            Fake {
                shell,
                done: Vec::new(),
                work,
                takes_ns: 0,
                requests: instance.sender().unwrap(),
                answers: instance.receiver(Queue::InOrder).unwrap(),
                health: instance.receiver(Queue::InOrder).unwrap(),
                _instance: instance,
            }
        }

        fn ask(&mut self, target: u32, commands: &[Command]) {
            for &command in commands {
                let seq = self.requests.sent();
                self.requests.send(&Request { seq, argument: 7, target, command: command as u32 }).unwrap();
            }
        }

        /// Every answer, with its text.
        fn answers(&mut self) -> Vec<(u64, u32, String)> {
            let next = || self.answers.next_valid().unwrap();
            std::iter::from_fn(next).map(|a| (a.seq, a.result, a.text())).collect()
        }
    }

    impl Work<Failure> for Fake {
        fn shell(&mut self) -> &mut Shell {
            &mut self.shell
        }

        fn rest(&mut self) {
            self.shell.rest(&[], Nanos::MAX);
        }

        fn slept(&mut self, slept_ns: u64) -> Result<u64, Failure> {
            assert!(slept_ns >= SLEPT_NS);
            self.done.push("slept".into());
            Ok(1)
        }

        fn turn(&mut self, _woken: Nanos) -> Result<(), Failure> {
            self.done.push("turn".into());
            (self.work)(self)
        }

        fn execute(&mut self, command: Command, argument: u64) -> Result<Served, Failure> {
            sleep_until(now() + self.takes_ns);
            self.done.push(format!("{command:?} {argument}"));
            Ok(match command {
                Command::Reset => Served::Done,
                Command::Load => Served::of(Err("no such file")),
                _ => Served::NothingToDo,
            })
        }
    }

    #[test]
    fn every_command_is_answered_and_a_refusal_says_who_and_why() {
        let mut fake = Fake::new("answer", |_| Ok(()));
        fake.ask(Process::Simcore as u32, &[Command::Reset]);
        fake.ask(EVERY_PROCESS, &ANY);
        fake.ask(Process::Tracker as u32, &[Command::Ping, Command::Shutdown]);
        assert_eq!(run(&mut fake), Ok(()));
        let told = fake.answers();
        let done = |seq| (seq, 0, String::new());
        assert_eq!(told[..2], [done(1), done(2)]);
        assert_eq!(told[2], (3, 1, "tracker: does not support the command 'snapshot'".into()));
        assert_eq!(told[3], (4, 1, "tracker: no such file".into()));
        assert_eq!(told[4..], [done(5), done(6)]);
    }

    #[test]
    fn a_turn_lies_before_every_command_and_none_is_begun_after_the_end() {
        let mut fake = Fake::new("order", |_| Ok(()));
        fake.ask(EVERY_PROCESS, &[Command::Start, Command::Help, Command::Shutdown, Command::Reset]);
        run(&mut fake).unwrap();
        assert_eq!(fake.done, ["turn", "Start 7", "turn", "Help 7", "turn"]);
    }

    #[test]
    fn a_turn_that_fails_ends_the_loop_with_its_error() {
        let mut fake = Fake::new("fail", |_| Err(Failure::Broken));
        assert_eq!(run(&mut fake), Err(Failure::Broken));
        assert_eq!(fake.done, ["turn"]);
    }

    #[test]
    fn the_heart_beats_at_work_and_goes_on_while_nothing_comes() {
        let mut fake = Fake::new("beat", |fake| {
            while let Some(beat) = fake.health.next_valid()? {
                assert_eq!((beat.process, beat.state), (Process::Tracker as u32, STATE_RUNNING));
                fake.done.push("beat".into());
            }
            if fake.done.iter().filter(|done| *done == "beat").count() == 3 {
                fake.shell.stop();
            }
            Ok(())
        });
        assert_eq!(run(&mut fake), Ok(()));
        assert_eq!(fake.done[..2], ["turn", "beat"], "at once");
    }

    #[test]
    fn a_long_turn_is_a_sleep_and_a_long_command_is_none() {
        let mut fake = Fake::new("sleep", |fake| {
            if fake.done.len() == 1 {
                sleep_until(now() + SLEPT_NS);
            }
            Ok(())
        });
        fake.takes_ns = SLEPT_NS;
        fake.ask(EVERY_PROCESS, &[Command::Reset, Command::Load, Command::Shutdown]);
        run(&mut fake).unwrap();
        assert_eq!(fake.done, ["turn", "Reset 7", "slept", "turn", "Load 7", "turn"]);
    }
}
