//! What the session does when somebody asks for a pause, a restart or the next level. Each attempt has a recording of its own.

use super::*;

impl Session<'_> {
    /// Takes in who asked for what, and what processes answered.
    pub(super) fn hear_wishes(&mut self) -> anyhow::Result<()> {
        while let Some(event) = self.tap.input()? {
            self.course.note_input(&event);
        }
        while let Some(request) = self.tap.request()? {
            if let Some(seq) = self.course.note_request(&request) {
                self.answer(
                    seq,
                    Err("the launcher knows start, pause, reset, next and shutdown only".into()),
                )?;
            }
        }
        let (awaited, waiting, problems) = &mut self.awaited;
        while let Some(answer) = self.tap.answer()? {
            if answer.seq == *awaited && waiting.contains(&answer.process) {
                waiting.retain(|p| *p != answer.process);
                if answer.result != 0 {
                    problems.push(answer.text());
                }
            }
        }
        Ok(())
    }

    fn answer(&mut self, seq: u64, done: Result<(), String>) -> anyhow::Result<()> {
        let text = text_bytes(done.as_ref().err().map_or("", String::as_str));
        Ok(self.answers.send(&Answer { seq, process: LAUNCHER, result: u32::from(done.is_err()), text })?)
    }

    /// Does what was asked; why the run shall end, if it shall.
    pub(super) fn serve_wishes(&mut self) -> anyhow::Result<Option<&'static str>> {
        while let Some(Asked { wish, request }) = self.course.take() {
            let done = match (wish, self.paused_ns) {
                (Wish::Pause | Wish::PauseOrResume, None) => self.pause(),
                (Wish::Resume | Wish::PauseOrResume, Some(since)) => self.resume(since),
                (Wish::Pause, Some(_)) | (Wish::Resume, None) => Ok(()),
                (Wish::Restart, _) => self.begin_again(Command::Reset),
                (Wish::Next, _) => self.next_level(),
                (Wish::Quit, _) => Ok(()),
            };
            if let Err(problem) = &done {
                self.screen.say(&format!("{problem:#}"));
            }
            if let Some(seq) = request {
                self.answer(seq, done.map_err(|e| format!("{e:#}")))?;
            }
            if wish == Wish::Quit {
                return Ok(Some("asked to end"));
            }
        }
        Ok(None)
    }

    fn pause(&mut self) -> anyhow::Result<()> {
        self.paused_ns = Some(now());
        // What is drawn while nothing moves is as old as the pause is long.
        self.hearing.ledger.cool();
        self.order(Command::Pause, 0)
    }

    fn resume(&mut self, since: Nanos) -> anyhow::Result<()> {
        self.order(Command::Start, 0)?;
        let at = now();
        self.paused_ns = None;
        self.attempt_ns += at.saturating_sub(since);
        self.hearing.ledger.warm_from(at + WARM_UP_NS);
        Ok(())
    }

    fn next_level(&mut self) -> anyhow::Result<()> {
        let Some(composed) = &mut self.composed else {
            bail!("there is no next level: no module is trained (--module)");
        };
        // A duration that somebody asked for stays.
        let scripted = self.args.duration == Some(self.args.attempt_s(composed));
        let level = composed.next_level()?;
        if scripted {
            self.args.duration = Some(self.args.attempt_s(composed));
        }
        self.supervisor.set_level(level);
        self.begin_again(Command::Load)?;
        Ok(())
    }

    /// Ends the attempt and begins one anew: everything stands still, so that no message belongs to both.
    fn begin_again(&mut self, command: Command) -> anyhow::Result<()> {
        self.hearing.ledger.cool();
        self.paused_ns = Some(now());
        self.order(Command::Pause, 0)?;
        self.end_attempt();
        let level = self.supervisor.level();
        let number = self.attempts.len() as u32;
        self.args.level = level;
        self.args.record = self.first_record.as_deref().map(|file| numbered(file, number));
        self.provenance = super::super::provenance(&self.args)?;
        let duration_ms = self.args.duration.map_or(0, |s| (s * 1e3) as u64);
        self.order(command, duration_ms)?;
        let file = self.args.record.as_deref();
        self.hearing.recorder = file.map(|file| Recorder::start(file, &self.provenance)).transpose()?;
        self.order(Command::Start, 0)?;
        let at = now();
        (self.paused_ns, self.attempt_ns) = (None, at);
        self.hearing.ledger.warm_from(at + WARM_UP_NS);
        let at_s = self.elapsed_s(at);
        self.happenings.push(Happened { at_s, what: format!("attempt {}, level {level}", number + 1) });
        Ok(())
    }

    /// Ends the recording of the attempt and keeps what is known of it.
    pub(super) fn end_attempt(&mut self) -> Option<super::super::report::RecordingFigures> {
        let recording = self.hearing.recorder.take().map(Recorder::finish);
        let (level, record) = (self.args.level, self.args.record.clone());
        let live = std::mem::take(&mut self.hearing.score);
        self.attempts.push(Attempt { level, record, live });
        self.hearing.resume.clear();
        recording
    }

    /// Sends a command to every process and waits until those that move the eye have obeyed.
    fn order(&mut self, command: Command, argument: u64) -> anyhow::Result<()> {
        let seq = self.supervisor.ask(EVERY_PROCESS, command, argument);
        let tracker = self.args.desk.is_none().then_some(Process::Tracker);
        let obeying = [self.args.source(), Process::Simcore].into_iter().chain(tracker);
        self.awaited = (seq, obeying.map(|p| p as u32).collect(), Vec::new());
        let deadline = now() + OBEY_NS;
        while !self.awaited.1.is_empty() && now() < deadline && !self.stop.load(Ordering::Relaxed) {
            self.tick()?;
        }
        // What was sent before the last answer.
        self.hear()?;
        if let Some(problem) = self.awaited.2.first() {
            bail!("{command:?}: {problem}");
        }
        Ok(())
    }
}
