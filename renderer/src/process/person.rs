//! The person at the window: what they do goes out on `inputs`; help, pause and the desk's hints come onto the picture.

use crate::present::Present;
use ipc::{Instance, IpcError, Queue, Receiver, Sender};
use protocol::bindings::{Action, help};
use protocol::inputs::{Hint, Input, InputEvent, Origin};
use protocol::scene_text::{Place, push_line};
use protocol::time::Nanos;

/// Channels to and from a person, and what the picture tells them.
pub struct Person {
    inputs: Sender<InputEvent>,
    hints: Receiver<Hint>,
    hint: String,
    at_desk: bool,
    help: bool,
    dose: bool,
    paused: bool,
    /// The overlay has to be made anew.
    changed: bool,
}

impl Person {
    /// Joins the channels; `at_desk`: the person moves the instruments from here; `dose`: the dose of light is shown from the start.
    pub fn open(instance: &Instance, at_desk: bool, dose: bool) -> Result<Self, IpcError> {
        let (inputs, hints) = (instance.sender()?, instance.receiver(Queue::Newest)?);
        let (hint, help) = (String::new(), false);
        Ok(Person { inputs, hints, hint, at_desk, help, dose, paused: false, changed: false })
    }

    /// True while the dose of light shall be shown.
    pub fn shows_dose(&self) -> bool {
        self.dose
    }

    /// True while everything stands still.
    pub fn is_paused(&self) -> bool {
        self.paused
    }

    /// Everything stands still, or goes on.
    pub fn pause(&mut self, paused: bool) {
        self.changed |= paused != self.paused;
        self.paused = paused;
    }

    /// Sends what the window heard, and takes the newest hint.
    pub fn hear(&mut self, present: &mut Present, at: Nanos) -> Result<(), IpcError> {
        let (inputs, mut sent, mut help) = (&mut self.inputs, Ok(()), self.help);
        let dose = &mut self.dose;
        present.take_inputs(|input| {
            let asks = |action| matches!(input, Input::Press(key) if Action::of(key) == Some(action));
            help ^= asks(Action::Help);
            *dose ^= asks(Action::Dose);
            if sent.is_ok() {
                sent = inputs.send(&InputEvent::new(input, Origin::Window, at));
            }
        });
        self.changed |= help != self.help;
        self.help = help;
        if let Some(hint) = self.hints.next_valid()? {
            self.hint = hint.text();
            self.changed = true;
        }
        sent
    }

    /// The lines over the picture, if they have changed, and whether they stand in place of the scene's.
    pub fn overlay(&mut self) -> Option<(String, bool)> {
        let help = if self.help { help(self.at_desk) } else { String::new() };
        std::mem::take(&mut self.changed).then(|| (lines(&self.hint, self.paused, &help), self.help))
    }
}

/// What is told.
fn lines(hint: &str, paused: bool, help: &str) -> String {
    let mut text = String::new();
    if !hint.is_empty() {
        push_line(&mut text, Place::BottomLeft, hint);
    }
    if paused {
        push_line(&mut text, Place::Middle, "paused");
    }
    help.lines().for_each(|line| push_line(&mut text, Place::Middle, line));
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn help_pause_and_hint_stand_at_their_places() {
        assert_eq!(lines("", false, ""), "");
        let told = lines("hand 2: light", true, "");
        assert!(told.contains("[hand 2: light\n") && told.contains("=paused"), "{told}");
        assert!(lines("", false, &help(true)).lines().all(|l| l.starts_with('=')));
    }
}
