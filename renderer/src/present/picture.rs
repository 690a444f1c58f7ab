//! A window that shows a picture as it is, pixel for pixel. It needs no graphics device.

use super::PresentError;
use super::window::name_of;
use protocol::inputs::Key;
use softbuffer::{Context, Surface};
use std::num::NonZeroU32;
use std::sync::Arc;
use std::time::Duration;
use winit::application::ApplicationHandler;
use winit::dpi::LogicalSize;
use winit::event::{ElementState, MouseButton, WindowEvent};
use winit::event_loop::{ActiveEventLoop, EventLoop};
use winit::keyboard::PhysicalKey;
use winit::platform::pump_events::{EventLoopExtPumpEvents, PumpStatus};
use winit::window::{Window, WindowId};

/// How long a window system may take to open a window.
const OPENING: Duration = Duration::from_millis(200);

/// What a person did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Event {
    /// A key was pressed, or is held down.
    Press(Key),
    /// The left button of the mouse went down, or the pointer moved with it held; px from the upper left corner.
    Point([f64; 2]),
    /// The window has another size, or shows again what was hidden.
    Uncovered,
    /// The window was closed.
    Closed,
}

/// The window.
pub struct PictureWindow {
    events: EventLoop<()>,
    state: State,
    surface: Surface<Arc<Window>, Arc<Window>>,
    window: Arc<Window>,
}

/// State that the window's events change.
struct State {
    title: String,
    size_px: [u32; 2],
    window: Option<Arc<Window>>,
    problem: Option<String>,
    pointer: [f64; 2],
    held: bool,
    events_seen: Vec<Event>,
}

impl ApplicationHandler for State {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.window.is_some() {
            return;
        }
        let [width, height] = self.size_px;
        let wish = Window::default_attributes()
            .with_title(&self.title)
            .with_inner_size(LogicalSize::new(width, height));
        match events.create_window(wish) {
            Ok(window) => self.window = Some(Arc::new(window)),
            Err(e) => self.problem = Some(e.to_string()),
        }
    }

    fn window_event(&mut self, _: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        match event {
            WindowEvent::CloseRequested | WindowEvent::Destroyed => self.events_seen.push(Event::Closed),
            WindowEvent::Resized(_)
            | WindowEvent::ScaleFactorChanged { .. }
            | WindowEvent::RedrawRequested => {
                self.events_seen.push(Event::Uncovered);
            }
            WindowEvent::KeyboardInput { event, .. } if event.state == ElementState::Pressed => {
                let PhysicalKey::Code(code) = event.physical_key else { return };
                self.events_seen.extend(Key::named(&name_of(code)).map(Event::Press));
            }
            WindowEvent::CursorMoved { position, .. } => {
                self.pointer = [position.x, position.y];
                self.point();
            }
            WindowEvent::MouseInput { state, button: MouseButton::Left, .. } => {
                self.held = state == ElementState::Pressed;
                self.point();
            }
            WindowEvent::Focused(false) => self.held = false,
            _ => {}
        }
    }
}

impl State {
    fn point(&mut self) {
        if self.held {
            self.events_seen.push(Event::Point(self.pointer));
        }
    }
}

impl PictureWindow {
    /// Opens a window of about `size_px`.
    ///
    /// # Errors
    /// Where there is no display.
    pub fn open(title: &str, size_px: [u32; 2]) -> Result<Self, PresentError> {
        let refused = PresentError::NoPictureWindow;
        let mut events = EventLoop::new().map_err(|_| refused("no X11 or Wayland server answers".into()))?;
        let mut state = State {
            title: title.into(),
            size_px,
            window: None,
            problem: None,
            pointer: [0.0; 2],
            held: false,
            events_seen: Vec::new(),
        };
        let _ = events.pump_app_events(Some(OPENING), &mut state);
        let problem = state.problem.take().unwrap_or_else(|| "it opened no window".into());
        let window = state.window.clone().ok_or_else(|| refused(problem))?;
        let context = Context::new(Arc::clone(&window)).map_err(|e| refused(e.to_string()))?;
        let surface = Surface::new(&context, Arc::clone(&window)).map_err(|e| refused(e.to_string()))?;
        Ok(PictureWindow { events, state, surface, window })
    }

    /// Width and height of what is shown, px.
    pub fn size_px(&self) -> [u32; 2] {
        let size = self.window.inner_size();
        [size.width, size.height]
    }

    /// Waits for events, up to a time limit, and passes them on.
    pub fn wait(&mut self, at_most: Duration) -> Vec<Event> {
        let status = self.events.pump_app_events(Some(at_most), &mut self.state);
        if matches!(status, PumpStatus::Exit(_)) {
            self.state.events_seen.push(Event::Closed);
        }
        std::mem::take(&mut self.state.events_seen)
    }

    /// Shows a picture of `size_px`, three bytes a pixel (red, green, blue). What of it does not fit the window is
    /// cut off, and where the window is larger it stays white.
    ///
    /// # Errors
    /// Where the window system refuses it.
    pub fn show(&mut self, rgb: &[u8], size_px: [u32; 2]) -> Result<(), PresentError> {
        let lost = |e: softbuffer::SoftBufferError| PresentError::NoPictureWindow(e.to_string());
        let [width, height] = self.size_px();
        let (Some(columns), Some(rows)) = (NonZeroU32::new(width), NonZeroU32::new(height)) else {
            return Ok(());
        };
        self.surface.resize(columns, rows).map_err(lost)?;
        let mut buffer = self.surface.buffer_mut().map_err(lost)?;
        copy(rgb, size_px, &mut buffer, width as usize);
        buffer.present().map_err(lost)
    }
}

/// Copies a picture into a buffer whose rows are `width` long: a pixel is `0x00RRGGBB`.
fn copy(rgb: &[u8], [columns, rows]: [u32; 2], buffer: &mut [u32], width: usize) {
    const WHITE: u32 = 0x00ff_ffff;
    let (columns, rows) = (columns as usize, rows as usize);
    for (y, row) in buffer.chunks_exact_mut(width).enumerate() {
        let from: &[u8] = if y < rows { &rgb[3 * columns * y..3 * columns * (y + 1)] } else { &[] };
        let mut pixels = from.chunks_exact(3).map(|p| u32::from_be_bytes([0, p[0], p[1], p[2]]));
        row.iter_mut().for_each(|pixel| *pixel = pixels.next().unwrap_or(WHITE));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_cut_or_white_is_added() {
        let rgb: Vec<u8> = (1..=12).collect();
        let mut larger = [0; 12];
        copy(&rgb, [2, 2], &mut larger, 4);
        let white = 0x00ff_ffff;
        let rows =
            [[0x01_02_03, 0x04_05_06, white, white], [0x07_08_09, 0x0a_0b_0c, white, white], [white; 4]];
        assert_eq!(larger.as_slice(), rows.as_flattened());
        let mut smaller = [0; 1];
        copy(&rgb, [2, 2], &mut smaller, 1);
        assert_eq!(smaller, [0x01_02_03]);
    }
}
