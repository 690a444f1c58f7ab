//! Where finished pictures go: nowhere (headless), or into a window; and a window for pictures of other programs.

pub mod blit;
pub mod feedback;
pub mod picture;
pub mod window;

use crate::gpu::{Gpu, GpuError};
use crate::target::Target;
use feedback::Answer;
use protocol::inputs::Input;
use protocol::time::Nanos;
use window::{Window, WindowConfig};

/// Why there is no window.
#[derive(Debug, thiserror::Error)]
pub enum PresentError {
    /// No display server.
    #[error(
        "no display for a window ({0}); use --headless, with --stills DIR or --video FILE.y4m to see the picture"
    )]
    NoDisplay(String),
    /// The same, where a program shows pictures of its own.
    #[error("no display for a window ({0}); use -o FILE.png instead")]
    NoPictureWindow(String),
    /// The graphics driver.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

/// A place for pictures: a window, or none; then the picture is complete when it is drawn.
pub struct Present(Option<Box<Window>>);

/// What the display says before a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ready {
    /// Draw now; it was last refreshed at this instant.
    At(Nanos),
    /// It cannot take a picture now.
    NotNow,
    /// The person closed it.
    Closed,
}

/// What became of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Handed {
    /// There is no display.
    Nowhere,
    /// The display has it.
    Over,
    /// The same, and it will say when it shows it.
    Asked,
}

impl Present {
    /// Opens the device and, if asked for, a window.
    ///
    /// # Errors
    /// If there is no display for a window, or no graphics device.
    pub fn open(window: Option<&WindowConfig>) -> Result<(Gpu, Self), PresentError> {
        let Some(config) = window else { return Ok((Gpu::headless()?, Self(None))) };
        let (gpu, window) = Window::open(config)?;
        Ok((gpu, Self(Some(Box::new(window)))))
    }

    /// True if there is no window.
    pub fn is_headless(&self) -> bool {
        self.0.is_none()
    }

    /// Period of the display, ns.
    pub fn refresh_ns(&self) -> Option<u64> {
        self.0.as_ref().map(|window| window.refresh_ns())
    }

    /// Serves the window's events and waits until it takes the next picture.
    pub fn begin(&mut self, gpu: &Gpu, now: impl Fn() -> Nanos) -> Ready {
        match &mut self.0 {
            Some(window) => window.begin(gpu, now),
            None => Ready::At(now()),
        }
    }

    /// Serves the window's events while there is nothing to show yet; true if the person closed it.
    pub fn is_closed(&mut self) -> bool {
        self.0.as_mut().is_some_and(|window| window.is_closed())
    }

    /// Hands on what a person did in the window since the last call.
    pub fn take_inputs(&mut self, done: impl FnMut(Input)) {
        if let Some(window) = &mut self.0 {
            window.take_inputs(done);
        }
    }

    /// Copies the picture into the window, with `text` (lines of `protocol::scene_text`) over it; part
    /// of drawing.
    pub fn copy(&mut self, gpu: &Gpu, target: &Target, text: &str) {
        if let Some(window) = &mut self.0 {
            window.copy(gpu, target, text);
        }
    }

    /// Lets the display have it at `now`, if there is one, as the picture of `frame`.
    pub fn show(&mut self, gpu: &Gpu, target: &Target, text: &str, frame: u64, now: Nanos) -> Handed {
        let Some(window) = &mut self.0 else { return Handed::Nowhere };
        if window.show(gpu, target, text, frame, now) { Handed::Asked } else { Handed::Over }
    }

    /// Hands on what the display has said of pictures since the last call.
    pub fn take_answers(&mut self, answer: impl FnMut(Answer)) {
        if let Some(window) = &mut self.0 {
            window.take_answers(answer);
        }
    }

    /// No answer of the display is of use any more.
    pub fn stop_asking(&mut self) {
        if let Some(window) = &mut self.0 {
            window.stop_asking();
        }
    }
}
