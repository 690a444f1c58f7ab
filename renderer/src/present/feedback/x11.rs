//! X11's extension *Present*: the server says of every pixmap that is presented to a window when that was complete,
//! whoever presents it. The driver presents on a connection of its own, so answers are matched to frames by their order.

use super::{Answer, InOrder};
use protocol::time::Nanos;
use x11rb::connection::{Connection, RequestConnection};
use x11rb::protocol::Event;
use x11rb::protocol::present::{CompleteKind, CompleteMode, ConnectionExt, EventMask, X11_EXTENSION_NAME};
use x11rb::rust_connection::RustConnection;

/// Listens to what an X server completes on a window.
pub struct Present {
    connection: RustConnection,
    order: InOrder,
}

impl Present {
    /// For a window of the display that `DISPLAY` names.
    ///
    /// # Errors
    /// In words, where the server is not reached or lacks the extension.
    pub fn open(window: u32) -> Result<Self, String> {
        let (connection, _) = x11rb::connect(None).map_err(|e| e.to_string())?;
        let there = connection.extension_information(X11_EXTENSION_NAME).map_err(|e| e.to_string())?;
        there.ok_or("the X server lacks the extension Present")?;
        let listen = || -> Result<(), x11rb::errors::ReplyOrIdError> {
            connection.present_query_version(1, 0)?.reply()?;
            let id = connection.generate_id()?;
            connection.present_select_input(id, window, EventMask::COMPLETE_NOTIFY)?.check()?;
            Ok(())
        };
        listen().map_err(|e| e.to_string())?;
        Ok(Present { connection, order: InOrder::default() })
    }

    /// The next pixmap that is presented, from `now` on, shows `frame`.
    pub fn ask(&mut self, frame: u64, now: Nanos) {
        self.order.ask(frame, now);
    }

    /// Forgets what was asked.
    pub fn forget(&mut self) {
        self.order.forget();
    }

    /// Hands on what the server has completed.
    pub fn take_answers(&mut self, mut answer: impl FnMut(Answer)) {
        // A lost connection is reported by the window.
        while let Ok(Some(event)) = self.connection.poll_for_event() {
            if let Event::PresentCompleteNotify(done) = event
                && done.kind == CompleteKind::PIXMAP
                && let Some(completed) = self.order.answer(nanos(done.ust), done.mode != CompleteMode::SKIP)
            {
                answer(completed);
            }
        }
    }
}

/// The server counts microseconds of `CLOCK_MONOTONIC`. Rounded up, so that no picture is complete before it was
/// presented within the same microsecond.
fn nanos(ust: u64) -> Nanos {
    ust.saturating_add(1).saturating_mul(1_000)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc::clock::now;
    use std::time::{Duration, Instant};
    use x11rb::protocol::xproto::{ConnectionExt as _, CreateWindowAux, WindowClass};
    use x11rb::{COPY_DEPTH_FROM_PARENT, COPY_FROM_PARENT, NONE};

    /// Another connection presents pixmaps, as a graphics driver does.
    #[test]
    #[ignore = "needs an X server: make test-display"]
    fn an_x_server_says_when_it_showed_pixmaps() {
        let (driver, screen) = x11rb::connect(None).unwrap();
        let screen = &driver.setup().roots[screen];
        let [window, pixmap] = [(); 2].map(|()| driver.generate_id().unwrap());
        let (depth, class) = (COPY_DEPTH_FROM_PARENT, WindowClass::INPUT_OUTPUT);
        let wish = CreateWindowAux::new();
        driver
            .create_window(depth, window, screen.root, 0, 0, 64, 64, 0, class, COPY_FROM_PARENT, &wish)
            .unwrap();
        driver.create_pixmap(screen.root_depth, pixmap, window, 64, 64).unwrap();
        driver.map_window(window).unwrap().check().unwrap();
        let mut present = Present::open(window).unwrap();
        let (mut told, mut shown) = (Vec::new(), Vec::new());
        for frame in 10..20 {
            let began = now();
            present.ask(frame, began);
            driver
                .present_pixmap(window, pixmap, 1, NONE, NONE, 0, 0, NONE, NONE, NONE, 0, 0, 0, 0, &[])
                .unwrap()
                .check()
                .unwrap();
            let waited = Instant::now();
            while told.len() < shown.len() + 1 && waited.elapsed() < Duration::from_secs(5) {
                present.take_answers(|answer| told.push(answer));
            }
            shown.push((frame, began));
        }
        let frames: Vec<_> = told.iter().map(|answer| answer.frame).collect();
        assert_eq!(frames, (10..20).collect::<Vec<_>>());
        for (answer, (_, began)) in told.iter().zip(shown) {
            let at = answer.displayed.expect("nothing replaced it");
            assert!(at >= began && at <= now(), "{at}: presented at {began}");
        }
        assert_eq!(Present::open(NONE).err().map(|problem| problem.is_empty()), Some(false));
    }
}
