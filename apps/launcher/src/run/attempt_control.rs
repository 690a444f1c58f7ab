//! Queue of requests for a pause, a restart, the next level or the end of the run. Pure.
//!
//! Requests from the window's keys and the gamepad (channel `inputs`), from three buttons of the pedal
//! (`pedal`) and from `vitreo ctl` (`control`) are collected here, whether a user or a script operates.

use protocol::bindings::Action;
use protocol::control::{Command, LAUNCHER, Request};
use protocol::handles::PedalState;
use protocol::inputs::{Input, InputEvent};
use protocol::optics::PedalButton;

/// Requests to the launcher, from any of its sources.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ControlRequest {
    /// Pause the simulation.
    Pause,
    /// Continue after a pause.
    Resume,
    /// Pause if the simulation runs, continue if it is paused.
    PauseOrResume,
    /// Open or close the help; the simulation is paused while the help is open.
    Help,
    /// Restart the attempt.
    Restart,
    /// Go to the module's next level.
    Next,
    /// End the run.
    Quit,
}

/// A request that has not been served yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PendingRequest {
    /// The request.
    pub request: ControlRequest,
    /// Sequence number of the message to answer, if the request came on channel `control`.
    pub seq: Option<u64>,
}

/// Queue of requests that have not been served yet.
#[derive(Debug, Default)]
pub struct AttemptControl {
    pending: std::collections::VecDeque<PendingRequest>,
    /// Bits of the pedal's pressed buttons.
    buttons: u32,
}

/// Capacity of the queue. Further requests, such as those of a held key, are dropped.
const MAX_PENDING: usize = 8;

impl AttemptControl {
    fn ask(&mut self, request: ControlRequest, seq: Option<u64>) {
        if self.pending.len() < MAX_PENDING {
            self.pending.push_back(PendingRequest { request, seq });
        }
    }

    /// Adds the request of a pressed key or button, if it has one.
    pub fn note_input(&mut self, event: &InputEvent) {
        let Some(Input::Press(key)) = event.input() else { return };
        match Action::of(key) {
            Some(Action::Pause) => self.ask(ControlRequest::PauseOrResume, None),
            Some(Action::Help) => self.ask(ControlRequest::Help, None),
            Some(Action::Restart) => self.ask(ControlRequest::Restart, None),
            Some(Action::Next) => self.ask(ControlRequest::Next, None),
            Some(Action::Quit) => self.ask(ControlRequest::Quit, None),
            _ => {}
        }
    }

    /// Adds the requests of pedal buttons that have been pressed since the last state.
    pub fn note_pedal(&mut self, pedal: &PedalState) {
        let fresh = pedal.buttons & !self.buttons;
        self.buttons = pedal.buttons;
        let buttons = [
            (PedalButton::Pause, ControlRequest::PauseOrResume),
            (PedalButton::Restart, ControlRequest::Restart),
            (PedalButton::Next, ControlRequest::Next),
        ];
        for (button, request) in buttons {
            if button.is_in(fresh) {
                self.ask(request, None);
            }
        }
    }

    /// Adds the request of a message on channel `control`. Returns the sequence number of a message that the
    /// launcher cannot serve.
    pub fn note_request(&mut self, message: &Request) -> Option<u64> {
        if message.target != LAUNCHER {
            return None;
        }
        let request = match Command::from_wire(message.command) {
            Some(Command::Pause) => ControlRequest::Pause,
            Some(Command::Start) => ControlRequest::Resume,
            Some(Command::Reset) => ControlRequest::Restart,
            Some(Command::Next) => ControlRequest::Next,
            Some(Command::Shutdown) => ControlRequest::Quit,
            _ => return Some(message.seq),
        };
        self.ask(request, Some(message.seq));
        None
    }

    /// Removes and returns the oldest request.
    pub fn take(&mut self) -> Option<PendingRequest> {
        self.pending.pop_front()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::inputs::{Key, Origin};

    fn key(name: &str) -> InputEvent {
        InputEvent::new(Input::Press(Key::named(name).unwrap()), Origin::Window, 1)
    }

    fn all(control: &mut AttemptControl) -> Vec<ControlRequest> {
        std::iter::from_fn(|| control.take()).map(|a| a.request).collect()
    }

    #[test]
    fn keys_foot_and_requests_ask_alike() {
        let mut control = AttemptControl::default();
        for name in ["p", "a", "f5", "mouse-left", "n", "f1", "f10"] {
            control.note_input(&key(name));
        }
        assert_eq!(
            all(&mut control),
            [
                ControlRequest::PauseOrResume,
                ControlRequest::Restart,
                ControlRequest::Next,
                ControlRequest::Help,
                ControlRequest::Quit
            ]
        );
        let press = |control: &mut AttemptControl, buttons| {
            control.note_pedal(&PedalState { buttons, ..PedalState::zeroed() });
        };
        for buttons in [32, 33, 1, 0, 64, 64, 128, 0] {
            press(&mut control, buttons);
        }
        assert_eq!(
            all(&mut control),
            [ControlRequest::PauseOrResume, ControlRequest::Restart, ControlRequest::Next],
            "not while they are held"
        );
        for (seq, command) in
            [(1, Command::Pause), (2, Command::Start), (3, Command::Reset), (4, Command::Next)]
        {
            let request = Request { seq, argument: 0, target: LAUNCHER, command: command as u32 };
            assert_eq!(control.note_request(&request), None);
        }
        assert_eq!(control.take(), Some(PendingRequest { request: ControlRequest::Pause, seq: Some(1) }));
        assert_eq!(
            all(&mut control),
            [ControlRequest::Resume, ControlRequest::Restart, ControlRequest::Next]
        );
    }

    #[test]
    fn what_is_for_others_is_passed_over_and_what_cannot_be_done_comes_back() {
        let mut control = AttemptControl::default();
        let request = |target, command| Request { seq: 9, argument: 0, target, command };
        assert_eq!(control.note_request(&request(2, Command::Reset as u32)), None);
        assert_eq!(control.note_request(&request(LAUNCHER, Command::Snapshot as u32)), Some(9));
        assert_eq!(control.take(), None);
    }

    #[test]
    fn leaning_on_a_key_fills_no_memory() {
        let mut control = AttemptControl::default();
        (0..1000).for_each(|_| control.note_input(&key("f5")));
        assert_eq!(all(&mut control).len(), MAX_PENDING);
    }
}
