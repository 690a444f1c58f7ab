//! A window that shows both channels, arranged for its display and synchronised to it.

use super::blit::Blit;
use super::{PresentError, Ready};
use crate::gpu::Gpu;
use crate::stereo::Arrangement;
use crate::target::Target;
use protocol::time::Nanos;
use std::sync::Arc;
use std::time::Duration;
use wgpu::{CurrentSurfaceTexture, Surface, SurfaceConfiguration, SurfaceTexture};
use winit::application::ApplicationHandler;
use winit::dpi::LogicalSize;
use winit::event::{ElementState, KeyEvent, WindowEvent};
use winit::event_loop::{ActiveEventLoop, EventLoop};
use winit::keyboard::{Key, NamedKey};
use winit::monitor::MonitorHandle;
use winit::platform::pump_events::{EventLoopExtPumpEvents, PumpStatus};
use winit::window::{Fullscreen, WindowId};

/// Size of the window at the start: two channels of 5:4.
const SIZE: LogicalSize<u32> = LogicalSize::new(1280, 512);
/// The same where the processor draws: every pixel of the window costs it time.
const SOFTWARE_SIZE: LogicalSize<u32> = LogicalSize::new(800, 320);
/// Period where the display does not tell, ns.
const USUAL_REFRESH_NS: u64 = 16_666_667;

/// What the window shall be.
#[derive(Debug, Clone, Default)]
pub struct WindowPlan {
    /// How the channels share it.
    pub arrangement: Arrangement,
    /// It fills its monitor from the start.
    pub full_screen: bool,
    /// The monitor to fill: its name, or its number from 0; the one where the window opens if `None`.
    pub monitor: Option<String>,
}

/// A window with its surface.
pub struct Window {
    events: EventLoop<()>,
    state: State,
    surface: Surface<'static>,
    config: SurfaceConfiguration,
    blit: Blit,
    plan: WindowPlan,
    acquired: Option<SurfaceTexture>,
    refresh_ns: u64,
}

/// What the events leave behind.
#[derive(Default)]
struct State {
    plan: WindowPlan,
    window: Option<Arc<winit::window::Window>>,
    problem: Option<String>,
    monitor: Option<MonitorHandle>,
    resized: bool,
    closed: bool,
}

impl ApplicationHandler for State {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.window.is_some() {
            return;
        }
        let monitors: Vec<_> = events.available_monitors().collect();
        let monitor = match self.plan.monitor.as_deref().map(|wanted| choose(wanted, &monitors)) {
            Some(Err(problem)) => return self.problem = Some(problem),
            Some(Ok(monitor)) => Some(monitor),
            None => None,
        };
        let full = self.plan.full_screen.then_some(Fullscreen::Borderless(monitor.clone()));
        self.monitor = monitor;
        let wish = winit::window::Window::default_attributes()
            .with_title("vitreo")
            .with_inner_size(SIZE)
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
            WindowEvent::KeyboardInput { event, .. } => self.key(&event),
            _ => {}
        }
    }
}

impl State {
    /// F11 and F switch between window and full screen, Escape leaves it.
    fn key(&mut self, event: &KeyEvent) {
        let Some(window) = &self.window else { return };
        if event.state != ElementState::Pressed || event.repeat {
            return;
        }
        let full = window.fullscreen().is_some();
        let wanted = match &event.logical_key {
            Key::Named(NamedKey::F11) => !full,
            Key::Character(key) if key.eq_ignore_ascii_case("f") => !full,
            Key::Named(NamedKey::Escape) => false,
            _ => return,
        };
        if wanted != full {
            window.set_fullscreen(wanted.then(|| Fullscreen::Borderless(self.monitor.clone())));
        }
    }
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
    pub fn open(plan: &WindowPlan) -> Result<(Gpu, Self), PresentError> {
        let no_display = |problem: String| PresentError::NoDisplay(problem);
        let mut events =
            EventLoop::new().map_err(|_| no_display("no X11 or Wayland server answers".into()))?;
        let mut state = State { plan: plan.clone(), ..State::default() };
        let _ = events.pump_app_events(Some(Duration::from_millis(200)), &mut state);
        let problem = state.problem.take().unwrap_or_else(|| "it opened no window".into());
        let window = state.window.clone().ok_or_else(|| no_display(problem))?;
        let (gpu, surface) = Gpu::for_surface(Arc::clone(&window))?;
        let monitor = window.current_monitor().and_then(|m| m.refresh_rate_millihertz());
        let refresh_ns =
            monitor.filter(|&mhz| mhz > 0).map_or(USUAL_REFRESH_NS, |mhz| 1_000_000_000_000 / u64::from(mhz));
        let small = if gpu.is_software && !plan.full_screen {
            window.request_inner_size(SOFTWARE_SIZE)
        } else {
            None
        };
        let size = small.unwrap_or_else(|| window.inner_size());
        let config = surface
            .get_default_config(&gpu.adapter, size.width.max(1), size.height.max(1))
            .ok_or_else(|| no_display("the graphics driver cannot draw into this window".into()))?;
        // The picture holds display values already; a plain format takes them as they are.
        let plain = [wgpu::TextureFormat::Bgra8Unorm, wgpu::TextureFormat::Rgba8Unorm];
        let formats = surface.get_capabilities(&gpu.adapter).formats;
        let format = plain.into_iter().find(|f| formats.contains(f)).unwrap_or(config.format);
        // Fifo waits for the display; one frame at most lies ready, so that nothing queues up.
        let config = SurfaceConfiguration {
            format,
            present_mode: wgpu::PresentMode::Fifo,
            desired_maximum_frame_latency: 1,
            ..config
        };
        surface.configure(&gpu.device, &config);
        let blit = Blit::new(&gpu.device, config.format);
        let plan = plan.clone();
        let window = Self { events, state, surface, config, blit, plan, acquired: None, refresh_ns };
        Ok((gpu, window))
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
            (self.config.width, self.config.height) = (size.width.max(1), size.height.max(1));
            self.surface.configure(&gpu.device, &self.config);
        }
    }

    /// Copies the picture, as large as fits without distortion; of alternating channels the left one.
    pub fn copy(&mut self, gpu: &Gpu, target: &Target) {
        self.copy_channel(gpu, target, 0);
    }

    fn copy_channel(&mut self, gpu: &Gpu, target: &Target, channel: u32) {
        let Some(acquired) = &self.acquired else { return };
        let view = acquired.texture.create_view(&wgpu::TextureViewDescriptor::default());
        let size_px = [self.config.width, self.config.height];
        self.blit.draw(gpu, target, &view, size_px, self.plan.arrangement, channel);
    }

    /// Queues the picture for the next refresh; where channels alternate, the right one for the refresh
    /// after that.
    pub fn show(&mut self, gpu: &Gpu, target: &Target) {
        if let Some(acquired) = self.acquired.take() {
            gpu.queue.present(acquired);
        }
        if self.plan.arrangement == Arrangement::Sequential {
            self.acquire(gpu);
            self.copy_channel(gpu, target, 1);
            if let Some(acquired) = self.acquired.take() {
                gpu.queue.present(acquired);
            }
        }
    }
}
