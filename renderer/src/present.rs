//! Where finished pictures go: nowhere (headless), or into a window.

pub mod blit;
pub mod window;

use crate::gpu::{Gpu, GpuError};
use crate::target::Target;
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
    /// The graphics driver.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

/// A place for pictures.
pub enum Present {
    /// The picture is complete when it is drawn.
    Headless,
    /// A window.
    Window(Box<Window>),
}

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

impl Present {
    /// Opens the device and, if asked for, a window.
    ///
    /// # Errors
    /// If there is no display for a window, or no graphics device.
    pub fn open(window: Option<&WindowConfig>) -> Result<(Gpu, Self), PresentError> {
        match window {
            Some(config) => {
                let (gpu, window) = Window::open(config)?;
                Ok((gpu, Present::Window(Box::new(window))))
            }
            None => Ok((Gpu::headless()?, Present::Headless)),
        }
    }

    /// Period of the display, ns.
    pub fn refresh_ns(&self) -> Option<u64> {
        match self {
            Present::Headless => None,
            Present::Window(window) => Some(window.refresh_ns()),
        }
    }

    /// Serves the window's events and waits until it takes the next picture.
    pub fn begin(&mut self, gpu: &Gpu, now: impl Fn() -> Nanos) -> Ready {
        match self {
            Present::Headless => Ready::At(now()),
            Present::Window(window) => window.begin(gpu, now),
        }
    }

    /// Serves the window's events while there is nothing to show yet; true if the person closed it.
    pub fn is_closed(&mut self) -> bool {
        match self {
            Present::Headless => false,
            Present::Window(window) => window.is_closed(),
        }
    }

    /// Hands on what a person did in the window since the last call.
    pub fn take_inputs(&mut self, done: impl FnMut(Input)) {
        if let Present::Window(window) = self {
            window.take_inputs(done);
        }
    }

    /// Copies the picture into the window; part of drawing.
    pub fn copy(&mut self, gpu: &Gpu, target: &Target) {
        if let Present::Window(window) = self {
            window.copy(gpu, target);
        }
    }

    /// Lets the display have it, if there is one.
    pub fn show(&mut self, gpu: &Gpu, target: &Target) -> bool {
        match self {
            Present::Headless => false,
            Present::Window(window) => {
                window.show(gpu, target);
                true
            }
        }
    }
}
