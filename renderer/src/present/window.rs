//! A window that shows both channels, arranged for its display and synchronised to it.

use super::blit::{Blit, Shown};
use super::feedback::{Answer, Feedback};
use super::{PresentError, Ready};
use crate::gpu::Gpu;
use crate::stereo::Arrangement;
use crate::target::Target;
use protocol::bindings::Action;
use protocol::inputs::{Input, Key as OurKey};
use protocol::time::Nanos;
use std::sync::Arc;
use std::time::Duration;
use wgpu::{CurrentSurfaceTexture, Surface, SurfaceConfiguration, SurfaceTexture};
use winit::application::ApplicationHandler;
use winit::dpi::LogicalSize;
use winit::event::{
    DeviceEvent, DeviceId, ElementState, KeyEvent, MouseButton, MouseScrollDelta, WindowEvent,
};
use winit::event_loop::{ActiveEventLoop, EventLoop};
use winit::keyboard::{Key, KeyCode, NamedKey, PhysicalKey};
use winit::monitor::MonitorHandle;
use winit::platform::pump_events::{EventLoopExtPumpEvents, PumpStatus};
use winit::window::{CursorGrabMode, Fullscreen, WindowId};

/// Size of a channel of the window at the start, where both stand side by side and where one
/// stands alone, px.
const PAIRED: [u32; 2] = [640, 512];
const ALONE: [u32; 2] = [960, 768];
/// The same where the processor draws: every pixel of the window costs it time.
const SOFTWARE_PAIRED: [u32; 2] = [400, 320];
const SOFTWARE_ALONE: [u32; 2] = [800, 640];
/// Number of no frame: of the other channel's picture.
const NO_FRAME: u64 = u64::MAX;
/// Refresh period assumed where the display does not report one, ns.
const USUAL_REFRESH_NS: u64 = 16_666_667;

/// Configuration of a window.
#[derive(Debug, Clone, Default)]
pub struct WindowConfig {
    /// How the channels share it.
    pub arrangement: Arrangement,
    /// It fills its monitor from the start.
    pub full_screen: bool,
    /// A person works by mouse and keyboard: a click takes the mouse.
    pub desk: bool,
    /// Letters have a meaning of their own: only F11 fills the monitor.
    pub letters: bool,
    /// The monitor to fill: its name, or its number from 0; the one where the window opens if
    /// `None`.
    pub monitor: Option<String>,
}

/// A window with its surface.
pub struct Window {
    /// It uses the window's connection, so it goes first.
    feedback: Feedback,
    events: EventLoop<()>,
    state: State,
    surface: Surface<'static>,
    surface_config: SurfaceConfiguration,
    blit: Blit,
    config: WindowConfig,
    acquired: Option<SurfaceTexture>,
    refresh_ns: u64,
}

/// State that the window's events change.
#[derive(Default)]
struct State {
    config: WindowConfig,
    window: Option<Arc<winit::window::Window>>,
    problem: Option<String>,
    monitor: Option<MonitorHandle>,
    resized: bool,
    closed: bool,
    /// What the person did since it was asked for last.
    inputs: Vec<Input>,
    mouse: Mouse,
}

/// What the mouse moves.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
enum Mouse {
    /// The person.
    #[default]
    Free,
    /// The instruments; the pointer is hidden and held, its movements come from the device.
    Held,
    /// The instruments, on a display that holds no pointer: movements are those of the pointer,
    /// which was here last, px.
    Followed(Option<[f64; 2]>),
}

/// Pixels of a notch, for wheels that report pixels.
const NOTCH_PX: f64 = 40.0;
/// Most inputs kept between two frames.
const MAX_INPUTS: usize = 256;

impl ApplicationHandler for State {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.window.is_some() {
            return;
        }
        let monitors: Vec<_> = events.available_monitors().collect();
        let monitor = match self.config.monitor.as_deref().map(|wanted| choose(wanted, &monitors)) {
            Some(Err(problem)) => return self.problem = Some(problem),
            Some(Ok(monitor)) => Some(monitor),
            None => None,
        };
        let full = self.config.full_screen.then_some(Fullscreen::Borderless(monitor.clone()));
        self.monitor = monitor;
        let wish = winit::window::Window::default_attributes()
            .with_title("vitreo")
            .with_inner_size(size(self.config.arrangement, false))
            .with_fullscreen(full);
        match events.create_window(wish) {
            Ok(window) => self.window = Some(Arc::new(window)),
            Err(e) => self.problem = Some(e.to_string()),
        }
    }

    fn window_event(&mut self, _: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        match event {
            WindowEvent::CloseRequested | WindowEvent::Destroyed => self.closed = true,
            WindowEvent::Resized(_) | WindowEvent::ScaleFactorChanged { .. } => self.resized = true,
            WindowEvent::KeyboardInput { event, .. } => {
                self.key(&event);
                self.handle_key(&event);
            }
            WindowEvent::MouseInput { state, button, .. } => self.click(button, state),
            WindowEvent::CursorMoved { position, .. } => self.follow([position.x, position.y]),
            WindowEvent::MouseWheel { delta, .. } if self.mouse != Mouse::Free => {
                self.push_input(Input::Wheel(match delta {
                    MouseScrollDelta::LineDelta(_, lines) => f64::from(lines),
                    MouseScrollDelta::PixelDelta(px) => px.y / NOTCH_PX,
                }))
            }
            WindowEvent::Focused(false) => {
                self.free_mouse();
                self.push_input(Input::LetGo);
            }
            _ => {}
        }
    }

    fn device_event(&mut self, _: &ActiveEventLoop, _: DeviceId, event: DeviceEvent) {
        if let (DeviceEvent::MouseMotion { delta: (right, down) }, Mouse::Held) = (event, self.mouse) {
            self.push_input(Input::Move([right, down]));
        }
    }
}

/// The key's name for `protocol::inputs`, by its place on the keyboard: `w`, `a`, `s` and `d` lie
/// together on any layout.
pub(super) fn name_of(code: KeyCode) -> String {
    let name = format!("{code:?}");
    let known = match code {
        KeyCode::Minus | KeyCode::NumpadSubtract => "minus",
        KeyCode::Equal | KeyCode::NumpadAdd => "plus",
        KeyCode::PageUp => "page-up",
        KeyCode::PageDown => "page-down",
        KeyCode::ShiftLeft | KeyCode::ShiftRight => "shift",
        KeyCode::ControlLeft | KeyCode::ControlRight => "control",
        KeyCode::AltLeft => "alt",
        _ => {
            let short = ["Key", "Digit", "Arrow"].iter().find_map(|prefix| name.strip_prefix(prefix));
            return short.unwrap_or(&name).to_ascii_lowercase();
        }
    };
    known.to_owned()
}

impl State {
    fn push_input(&mut self, input: Input) {
        if self.inputs.len() < MAX_INPUTS {
            self.inputs.push(input);
        }
    }

    fn handle_key(&mut self, event: &KeyEvent) {
        let PhysicalKey::Code(code) = event.physical_key else { return };
        let Some(key) = OurKey::named(&name_of(code)).or_else(|| OurKey::named("other")) else { return };
        if event.repeat {
            return;
        }
        if event.state == ElementState::Pressed && Action::of(key) == Some(Action::Mouse) {
            self.free_mouse();
        }
        self.push_press(key, event.state);
    }

    fn push_press(&mut self, key: OurKey, state: ElementState) {
        self.push_input(if state == ElementState::Pressed { Input::Press(key) } else { Input::Release(key) });
    }

    /// The first click takes the mouse; later ones are for the hands.
    fn click(&mut self, button: MouseButton, state: ElementState) {
        if self.mouse == Mouse::Free {
            if self.config.desk && state == ElementState::Pressed {
                self.take_mouse();
            }
            return;
        }
        let name = match button {
            MouseButton::Left => "mouse-left",
            MouseButton::Middle => "mouse-middle",
            MouseButton::Right => "mouse-right",
            MouseButton::Back => "mouse-back",
            MouseButton::Forward => "mouse-forward",
            MouseButton::Other(_) => return,
        };
        if let Some(key) = OurKey::named(name) {
            self.push_press(key, state);
        }
    }

    /// The pointer moved to `at`.
    fn follow(&mut self, at: [f64; 2]) {
        let Mouse::Followed(last) = self.mouse else { return };
        self.mouse = Mouse::Followed(Some(at));
        if let Some([x, y]) = last {
            self.push_input(Input::Move([at[0] - x, at[1] - y]));
        }
    }

    fn take_mouse(&mut self) {
        let Some(window) = &self.window else { return };
        let held = [CursorGrabMode::Locked, CursorGrabMode::Confined]
            .into_iter()
            .any(|mode| window.set_cursor_grab(mode).is_ok());
        window.set_cursor_visible(!held);
        self.mouse = if held { Mouse::Held } else { Mouse::Followed(None) };
    }

    fn free_mouse(&mut self) {
        if let (Some(window), Mouse::Held) = (&self.window, self.mouse) {
            // A pointer that cannot be let go is let go when the window closes.
            let _ = window.set_cursor_grab(CursorGrabMode::None);
            window.set_cursor_visible(true);
        }
        self.mouse = Mouse::Free;
    }

    /// F11 and F switch between window and full screen, Escape leaves it; F is for a hand where one
    /// works by the keyboard.
    fn key(&mut self, event: &KeyEvent) {
        let Some(window) = &self.window else { return };
        if event.state != ElementState::Pressed || event.repeat {
            return;
        }
        let full = window.fullscreen().is_some();
        let wanted = match &event.logical_key {
            Key::Named(NamedKey::F11) => !full,
            Key::Character(key) if key.eq_ignore_ascii_case("f") && !self.config.letters => !full,
            Key::Named(NamedKey::Escape) => false,
            _ => return,
        };
        if wanted != full {
            window.set_fullscreen(wanted.then(|| Fullscreen::Borderless(self.monitor.clone())));
        }
    }
}

/// Size of the window at the start.
fn size(arrangement: Arrangement, is_software: bool) -> LogicalSize<u32> {
    let paired = arrangement == Arrangement::SideBySide;
    let [width, height] = match (paired, is_software) {
        (true, false) => PAIRED,
        (false, false) => ALONE,
        (true, true) => SOFTWARE_PAIRED,
        (false, true) => SOFTWARE_ALONE,
    };
    let [width, height] = arrangement.size_px(width, height);
    LogicalSize::new(width, height)
}

/// The monitor of that name or number, or what there is instead.
fn choose(wanted: &str, monitors: &[MonitorHandle]) -> Result<MonitorHandle, String> {
    let name = |m: &MonitorHandle| m.name().unwrap_or_default();
    let by_number = wanted.parse::<usize>().ok().and_then(|i| monitors.get(i));
    let found = monitors.iter().find(|m| name(m) == wanted).or(by_number);
    found.cloned().ok_or_else(|| {
        let list: Vec<_> = monitors.iter().enumerate().map(|(i, m)| format!("{i} ({})", name(m))).collect();
        format!("no monitor '{wanted}'; there are: {}", list.join(", "))
    })
}

impl Window {
    /// Opens a window and the device that shows in it.
    ///
    /// # Errors
    /// If there is no display, no such monitor, or no graphics device for the window.
    pub fn open(config: &WindowConfig) -> Result<(Gpu, Self), PresentError> {
        let no_display = PresentError::NoDisplay;
        let mut events =
            EventLoop::new().map_err(|_| no_display("no X11 or Wayland server answers".into()))?;
        let mut state = State { config: config.clone(), ..State::default() };
        let _ = events.pump_app_events(Some(Duration::from_millis(200)), &mut state);
        let problem = state.problem.take().unwrap_or_else(|| "it opened no window".into());
        let window = state.window.clone().ok_or_else(|| no_display(problem))?;
        let (gpu, surface) = Gpu::for_surface(Arc::clone(&window))?;
        let monitor = window.current_monitor().and_then(|m| m.refresh_rate_millihertz());
        let refresh_ns =
            monitor.filter(|&mhz| mhz > 0).map_or(USUAL_REFRESH_NS, |mhz| 1_000_000_000_000 / u64::from(mhz));
        let shrinks = gpu.is_software && !config.full_screen;
        let small = shrinks.then(|| window.request_inner_size(size(config.arrangement, true))).flatten();
        let size = small.unwrap_or_else(|| window.inner_size());
        let default = surface
            .get_default_config(&gpu.adapter, size.width.max(1), size.height.max(1))
            .ok_or_else(|| no_display("the graphics driver cannot draw into this window".into()))?;
        // The picture holds display values already; a plain format takes them as they are.
        let plain = [wgpu::TextureFormat::Bgra8Unorm, wgpu::TextureFormat::Rgba8Unorm];
        let formats = surface.get_capabilities(&gpu.adapter).formats;
        let format = plain.into_iter().find(|f| formats.contains(f)).unwrap_or(default.format);
        // Fifo waits for the display; one frame at most lies ready, so that nothing queues up.
        let surface_config = SurfaceConfiguration {
            format,
            present_mode: wgpu::PresentMode::Fifo,
            desired_maximum_frame_latency: 1,
            ..default
        };
        surface.configure(&gpu.device, &surface_config);
        let blit = Blit::new(&gpu.device, surface_config.format);
        let (config, acquired) = (config.clone(), None);
        let feedback = Feedback::open(&window);
        Ok((
            gpu,
            Self { feedback, events, state, surface, surface_config, blit, config, acquired, refresh_ns },
        ))
    }

    /// Period of the display, ns.
    pub fn refresh_ns(&self) -> u64 {
        self.refresh_ns
    }

    /// Serves events, then waits for a free picture of the surface.
    pub fn begin(&mut self, gpu: &Gpu, now: impl Fn() -> Nanos) -> Ready {
        if self.is_closed() {
            return Ready::Closed;
        }
        if self.state.resized {
            self.state.resized = false;
            self.configure(gpu);
        }
        if self.acquire(gpu) { Ready::At(now()) } else { Ready::NotNow }
    }

    /// Hands on what the person did since the last call.
    pub fn take_inputs(&mut self, mut done: impl FnMut(Input)) {
        self.state.inputs.drain(..).for_each(&mut done);
    }

    /// Serves events; true if the person closed the window.
    pub fn is_closed(&mut self) -> bool {
        let status = self.events.pump_app_events(Some(Duration::ZERO), &mut self.state);
        self.state.closed || matches!(status, PumpStatus::Exit(_))
    }

    /// Waits for a free picture of the surface; false if it has none to give now.
    fn acquire(&mut self, gpu: &Gpu) -> bool {
        match self.surface.get_current_texture() {
            CurrentSurfaceTexture::Success(texture) => self.acquired = Some(texture),
            CurrentSurfaceTexture::Suboptimal(texture) => {
                self.state.resized = true;
                self.acquired = Some(texture);
            }
            CurrentSurfaceTexture::Outdated | CurrentSurfaceTexture::Lost => self.configure(gpu),
            CurrentSurfaceTexture::Timeout
            | CurrentSurfaceTexture::Occluded
            | CurrentSurfaceTexture::Validation => {}
        }
        self.acquired.is_some()
    }

    fn configure(&mut self, gpu: &Gpu) {
        if let Some(size) = self.state.window.as_ref().map(|w| w.inner_size()) {
            (self.surface_config.width, self.surface_config.height) = (size.width.max(1), size.height.max(1));
            self.surface.configure(&gpu.device, &self.surface_config);
            self.feedback.forget();
        }
    }

    /// Copies the picture, as large as fits without distortion, with `text` over it; of alternating
    /// channels the left one.
    pub fn copy(&mut self, gpu: &Gpu, target: &Target, text: &str) {
        self.copy_channel(gpu, target, text, 0);
    }

    fn copy_channel(&mut self, gpu: &Gpu, target: &Target, text: &str, channel: u32) {
        let Some(acquired) = &self.acquired else { return };
        let view = acquired.texture.create_view(&wgpu::TextureViewDescriptor::default());
        let size_px = [self.surface_config.width, self.surface_config.height];
        let arrangement = self.config.arrangement;
        let shown = Shown { arrangement, channel, text, text_scale: arrangement.text_scale() };
        self.blit.draw(gpu, target, &view, size_px, shown);
    }

    /// Queues the picture for the next refresh; where channels alternate, the right one for the
    /// refresh after that. True if the display will say when it showed the picture of `frame`.
    pub fn show(&mut self, gpu: &Gpu, target: &Target, text: &str, frame: u64, now: Nanos) -> bool {
        let mut asked = false;
        if let Some(acquired) = self.acquired.take() {
            asked = self.feedback.ask(frame, now);
            gpu.queue.present(acquired);
        }
        if self.config.arrangement == Arrangement::Sequential {
            self.acquire(gpu);
            self.copy_channel(gpu, target, text, 1);
            if let Some(acquired) = self.acquired.take() {
                // Answers that do not name their picture are counted.
                self.feedback.ask(NO_FRAME, now);
                gpu.queue.present(acquired);
            }
        }
        asked
    }

    /// Hands on what the display has said of pictures since the last call.
    pub fn take_answers(&mut self, answer: impl FnMut(Answer)) {
        self.feedback.take_answers(answer);
    }

    /// No answer is of use any more.
    pub fn stop_asking(&mut self) {
        self.feedback = Feedback::None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_that_mean_something_have_their_names() {
        let named = [
            (KeyCode::KeyW, "w"),
            (KeyCode::Digit3, "3"),
            (KeyCode::ArrowLeft, "left"),
            (KeyCode::F10, "f10"),
            (KeyCode::Tab, "tab"),
            (KeyCode::Space, "space"),
            (KeyCode::Escape, "escape"),
            (KeyCode::PageDown, "page-down"),
            (KeyCode::ShiftRight, "shift"),
            (KeyCode::NumpadAdd, "plus"),
            (KeyCode::Pause, "pause"),
        ];
        for (code, name) in named {
            assert_eq!(name_of(code), name);
            assert!(OurKey::named(name).is_some(), "{name}");
        }
        assert_eq!(OurKey::named(&name_of(KeyCode::Backquote)), None);
        assert!(OurKey::named("other").is_some_and(|other| Action::of(other).is_none()));
    }

    #[test]
    fn one_channel_alone_is_larger_than_each_of_two() {
        let of = |arrangement, is_software| {
            let LogicalSize { width, height } = size(arrangement, is_software);
            [width, height]
        };
        assert_eq!(of(Arrangement::SideBySide, true), [800, 320]);
        assert_eq!((of(Arrangement::Left, true), of(Arrangement::Left, false)), ([800, 640], [960, 768]));
    }

    #[test]
    fn the_pointer_leads_only_after_a_click() {
        let mut state = State::default();
        state.follow([10.0, 10.0]);
        state.click(MouseButton::Left, ElementState::Pressed);
        assert!(state.inputs.is_empty() && state.mouse == Mouse::Free, "no desk, no hands");
        state.mouse = Mouse::Followed(None);
        state.follow([10.0, 10.0]);
        state.follow([13.0, 6.0]);
        state.click(MouseButton::Back, ElementState::Pressed);
        let back = OurKey::named("mouse-back").unwrap();
        assert_eq!(state.inputs, [Input::Move([3.0, -4.0]), Input::Press(back)]);
    }
}
