//! The user at the window: forwards inputs on channel `inputs`, and overlays help, pause, hints of the desk
//! and notices of the launcher on the picture.

use crate::present::Present;
use ipc::{Instance, IpcError, Queue, Receiver, Sender};
use protocol::bindings::{Action, help};
use protocol::control::Notice;
use protocol::inputs::{Hint, Input, InputEvent, Origin};
use protocol::scene_text::{Place, Row, push_line, push_sentence};
use protocol::time::Nanos;
use protocol::transport;

/// Text over the picture, in the format of `protocol::scene_text`.
pub struct Overlay {
    /// The lines.
    pub lines: String,
    /// True if the lines replace the scene's text.
    pub hides_scene_text: bool,
}

/// What the window's keys control.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Keys {
    /// The run: pause, restart, next level.
    Run,
    /// The run and the instruments (desk mode).
    Desk,
    /// A replay, whose picture is never marked as paused or held.
    Replay,
}

/// Channels to and from the user, and the state of the overlay.
pub struct User {
    inputs: Sender<InputEvent>,
    hints: Receiver<Hint>,
    notices: Receiver<Notice>,
    hint: String,
    notice: String,
    keys: Keys,
    help: bool,
    dose: bool,
    paused: bool,
    /// True if the overlay has changed since it was last taken.
    changed: bool,
}

impl User {
    /// Opens the channels. `dose`: the light dose is shown from the start.
    ///
    /// # Errors
    /// If a channel cannot be opened.
    pub fn open(instance: &Instance, keys: Keys, dose: bool) -> Result<Self, IpcError> {
        let (inputs, hints) = (instance.sender()?, instance.receiver(Queue::Newest)?);
        let notices = instance.receiver(Queue::Newest)?;
        let (hint, notice) = (String::new(), String::new());
        let (help, paused, changed) = (false, false, false);
        Ok(User { inputs, hints, notices, hint, notice, keys, help, dose, paused, changed })
    }

    /// True if the light dose is shown.
    pub fn shows_dose(&self) -> bool {
        self.dose
    }

    /// True while the session is paused, and always for a replay, whose pictures have their own time.
    pub fn is_paused(&self) -> bool {
        self.paused || self.keys == Keys::Replay
    }

    /// Sets the pause.
    pub fn pause(&mut self, paused: bool) {
        self.changed |= paused != self.paused;
        self.paused = paused;
    }

    /// Shows or hides the help, as commanded by the launcher.
    pub fn show_help(&mut self, shown: bool) {
        self.changed |= shown != self.help;
        self.help = shown;
    }

    /// Publishes the window's inputs, and receives the newest hint and notice.
    ///
    /// # Errors
    /// If a channel fails.
    pub fn forward_inputs(&mut self, present: &mut Present, at: Nanos) -> Result<(), IpcError> {
        let (inputs, dose, mut sent) = (&mut self.inputs, &mut self.dose, Ok(()));
        present.take_inputs(|input| {
            *dose ^= matches!(input, Input::Press(key) if Action::of(key) == Some(Action::Dose));
            if sent.is_ok() {
                sent = inputs.send(&InputEvent::new(input, Origin::Window, at));
            }
        });
        if let Some(hint) = self.hints.next_valid()? {
            self.hint = hint.text();
            self.changed = true;
        }
        if let Some(notice) = self.notices.next_valid()? {
            let text = notice.text();
            self.changed |= text != self.notice;
            self.notice = text;
        }
        sent
    }

    /// The overlay, if it has changed since the last call.
    pub fn take_overlay(&mut self) -> Option<Overlay> {
        let help = match (self.help, self.keys) {
            (false, _) => String::new(),
            (true, Keys::Replay) => transport::help(),
            (true, keys) => help(keys == Keys::Desk),
        };
        std::mem::take(&mut self.changed).then(|| Overlay {
            lines: lines(&self.hint, &self.notice, self.paused, &help),
            hides_scene_text: self.help,
        })
    }
}

/// Text of the overlay, each line with its place.
fn lines(hint: &str, notice: &str, paused: bool, help: &str) -> String {
    let mut text = String::new();
    if !hint.is_empty() {
        push_line(&mut text, Place::BottomLeft, hint);
    }
    if !notice.is_empty() {
        push_sentence(&mut text, Place::BottomRight, notice);
    }
    if paused {
        push_line(&mut text, Place::Top, "Paused");
    }
    help.lines().for_each(|line| Row::Plain(line).push(&mut text));
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn help_pause_notice_and_hint_stand_at_their_places() {
        assert_eq!(lines("", "", false, ""), "");
        let text = lines("Hand 2: pick", "camera 1 stands still", true, "");
        assert_eq!(text, "[Hand 2: pick\n]Camera 1 stands still\n^Paused\n");
        assert!(lines("", "", false, &help(true)).lines().all(|l| l.starts_with('=')));
    }
}
