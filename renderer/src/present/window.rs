//! A window that shows both channels side by side, synchronised to the display.

use super::{PresentError, Ready};
use crate::gpu::Gpu;
use crate::passes::shader;
use crate::target::Target;
use protocol::time::Nanos;
use std::sync::Arc;
use std::time::Duration;
use wgpu::{
    BindGroupLayout, CurrentSurfaceTexture, RenderPipeline, Sampler, Surface, SurfaceConfiguration,
    SurfaceTexture,
};
use winit::application::ApplicationHandler;
use winit::dpi::LogicalSize;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, EventLoop};
use winit::platform::pump_events::{EventLoopExtPumpEvents, PumpStatus};
use winit::window::WindowId;

/// Size of the window at the start: two channels of 5:4.
const SIZE: LogicalSize<u32> = LogicalSize::new(1280, 512);
/// The same where the processor draws: every pixel of the window costs it time.
const SOFTWARE_SIZE: LogicalSize<u32> = LogicalSize::new(800, 320);
/// Period where the display does not tell, ns.
const USUAL_REFRESH_NS: u64 = 16_666_667;

/// A window with its surface.
pub struct Window {
    events: EventLoop<()>,
    state: State,
    surface: Surface<'static>,
    config: SurfaceConfiguration,
    layout: BindGroupLayout,
    pipeline: RenderPipeline,
    sampler: Sampler,
    acquired: Option<SurfaceTexture>,
    refresh_ns: u64,
}

/// What the events leave behind.
#[derive(Default)]
struct State {
    window: Option<Arc<winit::window::Window>>,
    problem: Option<String>,
    resized: bool,
    closed: bool,
}

impl ApplicationHandler for State {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.window.is_some() {
            return;
        }
        let wish = winit::window::Window::default_attributes().with_title("vitreo").with_inner_size(SIZE);
        match events.create_window(wish) {
            Ok(window) => self.window = Some(Arc::new(window)),
            Err(e) => self.problem = Some(e.to_string()),
        }
    }

    fn window_event(&mut self, _: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        match event {
            WindowEvent::CloseRequested | WindowEvent::Destroyed => self.closed = true,
            WindowEvent::Resized(_) | WindowEvent::ScaleFactorChanged { .. } => self.resized = true,
            _ => {}
        }
    }
}

impl Window {
    /// Opens a window and the device that shows in it.
    pub fn open() -> Result<(Gpu, Self), PresentError> {
        let no_display = |problem: String| PresentError::NoDisplay(problem);
        let mut events =
            EventLoop::new().map_err(|_| no_display("no X11 or Wayland server answers".into()))?;
        let mut state = State::default();
        let _ = events.pump_app_events(Some(Duration::from_millis(200)), &mut state);
        let problem = state.problem.take().unwrap_or_else(|| "it opened no window".into());
        let window = state.window.clone().ok_or_else(|| no_display(problem))?;
        let (gpu, surface) = Gpu::for_surface(Arc::clone(&window))?;
        let monitor = window.current_monitor().and_then(|m| m.refresh_rate_millihertz());
        let refresh_ns =
            monitor.filter(|&mhz| mhz > 0).map_or(USUAL_REFRESH_NS, |mhz| 1_000_000_000_000 / u64::from(mhz));
        let small = if gpu.is_software { window.request_inner_size(SOFTWARE_SIZE) } else { None };
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
        let layout = layout(&gpu.device);
        let pipeline = pipeline(&gpu.device, &layout, config.format);
        let sampler = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..wgpu::SamplerDescriptor::default()
        });
        let window =
            Self { events, state, surface, config, layout, pipeline, sampler, acquired: None, refresh_ns };
        Ok((gpu, window))
    }

    /// Period of the display, ns.
    pub fn refresh_ns(&self) -> u64 {
        self.refresh_ns
    }

    /// Serves events, then waits for a free picture of the surface.
    pub fn begin(&mut self, gpu: &Gpu, now: impl Fn() -> Nanos) -> Ready {
        let status = self.events.pump_app_events(Some(Duration::ZERO), &mut self.state);
        if self.state.closed || matches!(status, PumpStatus::Exit(_)) {
            return Ready::Closed;
        }
        if self.state.resized {
            self.state.resized = false;
            self.configure(gpu);
        }
        match self.surface.get_current_texture() {
            CurrentSurfaceTexture::Success(texture) => {
                self.acquired = Some(texture);
                Ready::At(now())
            }
            CurrentSurfaceTexture::Suboptimal(texture) => {
                self.state.resized = true;
                self.acquired = Some(texture);
                Ready::At(now())
            }
            CurrentSurfaceTexture::Outdated | CurrentSurfaceTexture::Lost => {
                self.configure(gpu);
                Ready::NotNow
            }
            CurrentSurfaceTexture::Timeout
            | CurrentSurfaceTexture::Occluded
            | CurrentSurfaceTexture::Validation => Ready::NotNow,
        }
    }

    fn configure(&mut self, gpu: &Gpu) {
        if let Some(size) = self.state.window.as_ref().map(|w| w.inner_size()) {
            (self.config.width, self.config.height) = (size.width.max(1), size.height.max(1));
            self.surface.configure(&gpu.device, &self.config);
        }
    }

    /// Copies the picture, as large as fits without distortion.
    pub fn copy(&mut self, gpu: &Gpu, target: &Target) {
        let Some(acquired) = &self.acquired else { return };
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("blit"),
            layout: &self.layout,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::TextureView(&target.colour),
                },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Sampler(&self.sampler) },
            ],
        });
        let view = acquired.texture.create_view(&wgpu::TextureViewDescriptor::default());
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let ops =
            wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store };
        let attachment =
            wgpu::RenderPassColorAttachment { view: &view, depth_slice: None, resolve_target: None, ops };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("blit"),
            color_attachments: &[Some(attachment)],
            ..wgpu::RenderPassDescriptor::default()
        });
        let [x, y, w, h] =
            fit([2 * target.width_px, target.height_px], [self.config.width, self.config.height]);
        pass.set_viewport(x, y, w, h, 0.0, 1.0);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.draw(0..4, 0..1);
        drop(pass);
        gpu.queue.submit([encoder.finish()]);
    }

    /// Queues the picture for the next refresh.
    pub fn show(&mut self, gpu: &Gpu) {
        if let Some(acquired) = self.acquired.take() {
            gpu.queue.present(acquired);
        }
    }
}

/// Rectangle (x, y, width, height) of a picture in the middle of a window, its shape kept.
fn fit(picture: [u32; 2], window: [u32; 2]) -> [f32; 4] {
    let [pw, ph, ww, wh] = [picture[0], picture[1], window[0], window[1]].map(|n| n.max(1) as f32);
    let scale = (ww / pw).min(wh / ph);
    let (w, h) = ((pw * scale).min(ww), (ph * scale).min(wh));
    [0.5 * (ww - w), 0.5 * (wh - h), w, h]
}

fn layout(device: &wgpu::Device) -> BindGroupLayout {
    let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::FRAGMENT,
        ty,
        count: None,
    };
    let texture = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Float { filterable: true },
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("blit"),
        entries: &[
            entry(0, texture),
            entry(1, wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering)),
        ],
    })
}

fn pipeline(device: &wgpu::Device, layout: &BindGroupLayout, format: wgpu::TextureFormat) -> RenderPipeline {
    let module = shader(device, "blit");
    let groups = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("blit"),
        bind_group_layouts: &[Some(layout)],
        immediate_size: 0,
    });
    let entry = if format.is_srgb() { "fs_linear" } else { "fs_main" };
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("blit"),
        layout: Some(&groups),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("vs_main"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState {
            topology: wgpu::PrimitiveTopology::TriangleStrip,
            ..wgpu::PrimitiveState::default()
        },
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some(entry),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_keep_their_shape() {
        assert_eq!(fit([640, 256], [1280, 512]), [0.0, 0.0, 1280.0, 512.0]);
        assert_eq!(fit([640, 256], [640, 512]), [0.0, 128.0, 640.0, 256.0]);
        assert_eq!(fit([640, 256], [0, 0])[2..], [1.0, 0.4]);
    }
}
