//! Wayland's *presentation-time*: of each commit of the window's surface, the instant at which its picture turned into
//! light, by the compositor's word.
//!
//! The objects live on the connection that the window has, in an event queue of their own: whoever serves the
//! window's events reads the socket for both, and nothing here waits.

#![allow(unsafe_code)] // the window's connection and surface come as pointers; each use has its SAFETY note

use super::Answer;
use protocol::time::Nanos;
use rustix::time::{ClockId, clock_gettime};
use std::ffi::c_void;
use std::ptr::NonNull;
use wayland_client::backend::{Backend, ObjectId};
use wayland_client::globals::{GlobalListContents, registry_queue_init};
use wayland_client::protocol::wl_registry::WlRegistry;
use wayland_client::protocol::wl_surface::WlSurface;
use wayland_client::{Connection, Dispatch, EventQueue, Proxy, QueueHandle};
use wayland_protocols::wp::presentation_time::client::wp_presentation::{self, WpPresentation};
use wayland_protocols::wp::presentation_time::client::wp_presentation_feedback::{
    self, WpPresentationFeedback,
};

/// Clocks of Linux by which compositors may count.
const CLOCKS: [(u32, ClockId); 5] = [
    (0, ClockId::Realtime),
    (1, ClockId::Monotonic),
    (4, ClockId::MonotonicRaw),
    (6, ClockId::MonotonicCoarse),
    (7, ClockId::Boottime),
];

/// Asks a compositor about the pictures of a surface.
pub struct Presentation {
    connection: Connection,
    queue: EventQueue<Answers>,
    answers: Answers,
    presentation: WpPresentation,
    surface: WlSurface,
    clock: ClockId,
}

#[derive(Default)]
struct Answers {
    clock: Option<u32>,
    come: Vec<Answer>,
}

impl Presentation {
    /// For the surface of a window, which must outlive this.
    ///
    /// # Errors
    /// In words, where the compositor does not have the protocol, or counts by a clock that this machine does not have.
    pub fn open(display: NonNull<c_void>, surface: NonNull<c_void>) -> Result<Self, String> {
        // SAFETY: winit hands out the wl_display of its own connection, which is open as long as its window is;
        // a backend made from a foreign display never closes it.
        let backend = unsafe { Backend::from_foreign_display(display.as_ptr().cast()) };
        let connection = Connection::from_backend(backend);
        // SAFETY: the wl_surface of the same window on the same connection.
        let id = unsafe { ObjectId::from_ptr(WlSurface::interface(), surface.as_ptr().cast()) };
        let surface = id.ok().and_then(|id| WlSurface::from_id(&connection, id).ok());
        let surface = surface.ok_or("the window has no Wayland surface")?;
        let (globals, mut queue) = registry_queue_init(&connection).map_err(|e| e.to_string())?;
        let presentation: WpPresentation = globals
            .bind(&queue.handle(), 1..=1, ())
            .map_err(|_| "the compositor lacks presentation-time".to_owned())?;
        let mut answers = Answers::default();
        queue.roundtrip(&mut answers).map_err(|e| e.to_string())?;
        let clock_id = answers.clock.ok_or("the compositor names no clock")?;
        let clock = CLOCKS.iter().find(|(number, _)| *number == clock_id).map(|(_, clock)| *clock);
        let clock = clock.ok_or_else(|| format!("the compositor uses clock {clock_id}"))?;
        Ok(Presentation { connection, queue, answers, presentation, surface, clock })
    }

    /// Asks about the next commit of the surface, which is to show `frame`.
    pub fn ask(&mut self, frame: u64) {
        self.presentation.feedback(&self.surface, &self.queue.handle(), frame);
        // The commit comes through the same connection; what cannot be sent now goes with it.
        let _ = self.connection.flush();
    }

    /// Hands on what the compositor answered.
    pub fn take_answers(&mut self, mut answer: impl FnMut(Answer)) {
        // A lost connection is reported by the window.
        let _ = self.queue.dispatch_pending(&mut self.answers);
        // The clocks drift apart slowly; an answer is some milliseconds old.
        let ahead = nanos(self.clock).wrapping_sub(nanos(ClockId::Monotonic));
        for Answer { frame, displayed } in self.answers.come.drain(..) {
            answer(Answer { frame, displayed: displayed.map(|at| at.wrapping_sub(ahead)) });
        }
    }
}

fn nanos(clock: ClockId) -> Nanos {
    let now = clock_gettime(clock);
    now.tv_sec.cast_unsigned().wrapping_mul(1_000_000_000).wrapping_add(now.tv_nsec.cast_unsigned())
}

impl Dispatch<WpPresentation, ()> for Answers {
    fn event(
        answers: &mut Self,
        _: &WpPresentation,
        event: wp_presentation::Event,
        (): &(),
        _: &Connection,
        _: &QueueHandle<Self>,
    ) {
        if let wp_presentation::Event::ClockId { clk_id } = event {
            answers.clock = Some(clk_id);
        }
    }
}

impl Dispatch<WpPresentationFeedback, u64> for Answers {
    fn event(
        answers: &mut Self,
        _: &WpPresentationFeedback,
        event: wp_presentation_feedback::Event,
        frame: &u64,
        _: &Connection,
        _: &QueueHandle<Self>,
    ) {
        use wp_presentation_feedback::Event::{Discarded, Presented};
        let displayed = match event {
            Presented { tv_sec_hi, tv_sec_lo, tv_nsec, .. } => {
                let seconds = u64::from(tv_sec_hi) << 32 | u64::from(tv_sec_lo);
                Some(seconds.saturating_mul(1_000_000_000).saturating_add(u64::from(tv_nsec)))
            }
            Discarded => None,
            _ => return,
        };
        answers.come.push(Answer { frame: *frame, displayed });
    }
}

impl Dispatch<WlRegistry, GlobalListContents> for Answers {
    fn event(
        _: &mut Self,
        _: &WlRegistry,
        _: wayland_client::protocol::wl_registry::Event,
        _: &GlobalListContents,
        _: &Connection,
        _: &QueueHandle<Self>,
    ) {
    }
}
