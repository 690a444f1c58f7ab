//! X11's extension *Present*: the server says of every pixmap that is presented to a window when that was complete,
//! whoever presents it. The driver presents on a connection of its own, so answers are matched to frames by their order.

use super::{Answer, InOrder};
use ipc::clock::now;
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

    /// The next pixmap that is presented shows `frame`.
    pub fn ask(&mut self, frame: u64) {
        self.order.ask(frame, now());
    }

    /// Forgets what was asked.
    pub fn forget(&mut self) {
        self.order.forget();
    }

    /// Hands on what the server has completed.
    pub fn take_answers(&mut self, mut answer: impl FnMut(Answer)) {
        // A connection that is gone is the window's to tell.
        while let Ok(Some(event)) = self.connection.poll_for_event() {
            if let Event::PresentCompleteNotify(done) = event
                && done.kind == CompleteKind::PIXMAP
                && let Some(told) = self.order.answer(nanos(done.ust), done.mode != CompleteMode::SKIP)
            {
                answer(told);
            }
        }
    }
}

/// The server counts microseconds of `CLOCK_MONOTONIC`. Rounded up, so that no picture is complete before it was
/// presented within the same microsecond.
fn nanos(ust: u64) -> Nanos {
    ust.saturating_add(1).saturating_mul(1_000)
}
