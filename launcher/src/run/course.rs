//! The course of an attempt: who may ask for a pause, a restart, the next level or the end, and what the launcher makes of it. Pure.
//!
//! Keys of the window and the gamepad ask by `inputs`, the foot by three buttons of the `pedal`, a command line (`vitreo ctl`) by
//! `control`. All of them end here, whether a person or a script works.

use protocol::bindings::Action;
use protocol::control::{Command, LAUNCHER, Request};
use protocol::handles::PedalState;
use protocol::inputs::{Input, InputEvent};
use protocol::optics::PedalButton;

/// What is asked of the launcher.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wish {
    /// Everything stands still.
    Pause,
    /// It goes on.
    Resume,
    /// Whichever of both changes something.
    PauseOrResume,
    /// The attempt from its beginning.
    Restart,
    /// The module's next level.
    Next,
    /// The end of the run.
    Quit,
}

/// A wish, and the request to answer where it came by one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Asked {
    /// What is asked.
    pub wish: Wish,
    /// Number of the request.
    pub request: Option<u64>,
}

/// What has been asked and not been done yet.
#[derive(Debug, Default)]
pub struct Course {
    asked: std::collections::VecDeque<Asked>,
    /// Buttons of the pedal that are down.
    buttons: u32,
}

/// Wishes that wait at most; more are somebody leaning on a key.
const MOST: usize = 8;

impl Course {
    fn ask(&mut self, wish: Wish, request: Option<u64>) {
        if self.asked.len() < MOST {
            self.asked.push_back(Asked { wish, request });
        }
    }

    /// Hears a key.
    pub fn note_input(&mut self, event: &InputEvent) {
        let Some(Input::Press(key)) = event.input() else { return };
        match Action::of(key) {
            Some(Action::Pause) => self.ask(Wish::PauseOrResume, None),
            Some(Action::Restart) => self.ask(Wish::Restart, None),
            Some(Action::Next) => self.ask(Wish::Next, None),
            Some(Action::Quit) => self.ask(Wish::Quit, None),
            _ => {}
        }
    }

    /// Hears the foot; a button acts when it goes down.
    pub fn note_pedal(&mut self, pedal: &PedalState) {
        let fresh = pedal.buttons & !self.buttons;
        self.buttons = pedal.buttons;
        let buttons = [
            (PedalButton::Pause, Wish::PauseOrResume),
            (PedalButton::Restart, Wish::Restart),
            (PedalButton::Next, Wish::Next),
        ];
        for (button, wish) in buttons {
            if button.is_in(fresh) {
                self.ask(wish, None);
            }
        }
    }

    /// Hears a request; one that the launcher cannot serve comes back, to be answered so.
    pub fn note_request(&mut self, request: &Request) -> Option<u64> {
        if request.target != LAUNCHER {
            return None;
        }
        let wish = match Command::from_wire(request.command) {
            Some(Command::Pause) => Wish::Pause,
            Some(Command::Start) => Wish::Resume,
            Some(Command::Reset) => Wish::Restart,
            Some(Command::Next) => Wish::Next,
            Some(Command::Shutdown) => Wish::Quit,
            _ => return Some(request.seq),
        };
        self.ask(wish, Some(request.seq));
        None
    }

    /// The oldest wish.
    pub fn take(&mut self) -> Option<Asked> {
        self.asked.pop_front()
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

    fn all(course: &mut Course) -> Vec<Wish> {
        std::iter::from_fn(|| course.take()).map(|a| a.wish).collect()
    }

    #[test]
    fn keys_foot_and_requests_ask_alike() {
        let mut course = Course::default();
        for name in ["p", "a", "f5", "mouse-left", "n", "f10"] {
            course.note_input(&key(name));
        }
        assert_eq!(all(&mut course), [Wish::PauseOrResume, Wish::Restart, Wish::Next, Wish::Quit]);
        let press = |course: &mut Course, buttons| {
            course.note_pedal(&PedalState { buttons, ..PedalState::zeroed() });
        };
        for buttons in [32, 33, 1, 0, 64, 64, 128, 0] {
            press(&mut course, buttons);
        }
        assert_eq!(
            all(&mut course),
            [Wish::PauseOrResume, Wish::Restart, Wish::Next],
            "not while they are held"
        );
        for (seq, command) in
            [(1, Command::Pause), (2, Command::Start), (3, Command::Reset), (4, Command::Next)]
        {
            let request = Request { seq, argument: 0, target: LAUNCHER, command: command as u32 };
            assert_eq!(course.note_request(&request), None);
        }
        assert_eq!(course.take(), Some(Asked { wish: Wish::Pause, request: Some(1) }));
        assert_eq!(all(&mut course), [Wish::Resume, Wish::Restart, Wish::Next]);
    }

    #[test]
    fn what_is_for_others_is_passed_over_and_what_cannot_be_done_comes_back() {
        let mut course = Course::default();
        let request = |target, command| Request { seq: 9, argument: 0, target, command };
        assert_eq!(course.note_request(&request(2, Command::Reset as u32)), None);
        assert_eq!(course.note_request(&request(LAUNCHER, Command::Snapshot as u32)), Some(9));
        assert_eq!(course.take(), None);
    }

    #[test]
    fn leaning_on_a_key_fills_no_memory() {
        let mut course = Course::default();
        (0..1000).for_each(|_| course.note_input(&key("f5")));
        assert_eq!(all(&mut course).len(), MOST);
    }
}
