//! What the display server says afterwards of a picture: when it was shown.
//!
//! wgpu presents and reports nothing afterwards, so the display server is asked as well: with Wayland's
//! *presentation-time* on the connection of the window, with X11's extension *Present* on a connection of its own.
//! Answers come later, some not at all: a driver that copies pictures to an X server by other means presents nothing.

mod wayland;
mod x11;

use protocol::time::Nanos;
use std::collections::VecDeque;
use winit::raw_window_handle::{HasDisplayHandle, HasWindowHandle, RawDisplayHandle, RawWindowHandle};

/// An answer of the display server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Answer {
    /// Number of the frame.
    pub frame: u64,
    /// When it began to be shown, on `CLOCK_MONOTONIC`; `None` for a picture that another one replaced before.
    pub displayed: Option<Nanos>,
}

/// The way to the display server's answers.
pub enum Feedback {
    /// It has none.
    None,
    /// Wayland's presentation-time.
    Wayland(wayland::Presentation),
    /// X11's Present.
    X11(Box<x11::Present>),
}

impl Feedback {
    /// For a window. What the display server lacks is logged.
    pub fn open(window: &winit::window::Window) -> Self {
        let (Ok(display), Ok(handle)) = (window.display_handle(), window.window_handle()) else {
            return Feedback::None;
        };
        let opened = match (display.as_raw(), handle.as_raw()) {
            (RawDisplayHandle::Wayland(display), RawWindowHandle::Wayland(window)) => {
                wayland::Presentation::open(display.display, window.surface).map(Feedback::Wayland)
            }
            (_, RawWindowHandle::Xlib(window)) => match u32::try_from(window.window) {
                Ok(window) => x11::Present::open(window).map(Box::new).map(Feedback::X11),
                Err(e) => Err(e.to_string()),
            },
            (_, RawWindowHandle::Xcb(window)) => {
                x11::Present::open(window.window.get()).map(Box::new).map(Feedback::X11)
            }
            _ => Err("unknown window system".into()),
        };
        opened.unwrap_or_else(|problem| {
            tracing::info!("the display does not report presentation times ({problem}): they are estimated");
            Feedback::None
        })
    }

    /// Asks at `now` about the picture of `frame`, which is presented next. False if nothing will be answered.
    pub fn ask(&mut self, frame: u64, now: Nanos) -> bool {
        match self {
            Feedback::None => return false,
            Feedback::Wayland(presentation) => presentation.ask(frame),
            Feedback::X11(present) => present.ask(frame, now),
        }
        true
    }

    /// Discards pending requests: the surface was created again.
    pub fn forget(&mut self) {
        if let Feedback::X11(present) = self {
            present.forget();
        }
    }

    /// Hands on the answers that have come since the last call. Never waits.
    pub fn take_answers(&mut self, answer: impl FnMut(Answer)) {
        match self {
            Feedback::None => {}
            Feedback::Wayland(presentation) => presentation.take_answers(answer),
            Feedback::X11(present) => present.take_answers(answer),
        }
    }
}

/// Pictures whose answers come in the order in which they were presented, without naming them. Pure.
#[derive(Debug, Default)]
struct InOrder {
    asked: VecDeque<(u64, Nanos)>,
}

/// Most pictures that an answer is awaited of.
const MOST_ASKED: usize = 64;

impl InOrder {
    fn ask(&mut self, frame: u64, now: Nanos) {
        if self.asked.len() == MOST_ASKED {
            self.asked.pop_front();
        }
        self.asked.push_back((frame, now));
    }

    fn forget(&mut self) {
        self.asked.clear();
    }

    /// The answer that one of a picture shown (or not) at an instant is. An instant before the picture was presented
    /// belongs to a former surface, and answers nothing.
    fn answer(&mut self, at: Nanos, shown: bool) -> Option<Answer> {
        let (frame, _) = *self.asked.front().filter(|(_, asked)| *asked <= at)?;
        self.asked.pop_front();
        Some(Answer { frame, displayed: shown.then_some(at) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn answers_of_a_former_surface_are_left_out() {
        let mut order = InOrder::default();
        order.ask(7, 100);
        order.forget();
        order.ask(8, 200);
        assert_eq!(order.answer(150, true), None, "of frame 7");
        assert_eq!(order.answer(210, false), Some(Answer { frame: 8, displayed: None }));
        assert_eq!(order.answer(220, true), None, "nothing was asked");
    }

    proptest! {
        #[test]
        fn every_answer_is_that_of_its_frame(shown in prop::collection::vec(any::<bool>(), 1..200)) {
            let mut order = InOrder::default();
            let mut told = Vec::new();
            for (frame, shown) in shown.iter().enumerate() {
                order.ask(frame as u64, 100 * frame as u64);
                // Two pictures are on their way.
                if frame > 0 {
                    told.extend(order.answer(100 * frame as u64 + 50, *shown));
                }
            }
            for (frame, answer) in told.iter().enumerate() {
                prop_assert_eq!(answer.frame, frame as u64);
                prop_assert_eq!(answer.displayed.is_some(), shown[frame + 1]);
            }
            prop_assert_eq!(told.len(), shown.len() - 1);
        }
    }
}
