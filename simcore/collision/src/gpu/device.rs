//! Opens a graphics adapter for computing and runs what is submitted to it, with a bound on every
//! wait.

use super::part_clock::FEATURES;
use super::passes::Passes;
use std::sync::Arc;
use std::sync::OnceLock;
use std::time::Duration;
use wgpu::{Backends, Buffer, CommandEncoder, DeviceType, MapMode, PollType};

/// Storage buffers that the shaders use at once.
const STORAGE_BUFFERS: u32 = 8;
/// Longest wait for a submission. A look takes milliseconds at worst; the first ones also compile.
/// After this the device counts as lost and the processor goes on.
const LONGEST_WAIT: Duration = Duration::from_secs(5);

/// Why the adapter cannot be used, or no longer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GpuError {
    /// Neither Vulkan nor OpenGL answers.
    #[error("no graphics driver found (tried Vulkan and OpenGL)")]
    NoAdapter,
    /// The driver refused the device.
    #[error("graphics driver {name}: {problem}")]
    Refused {
        /// The adapter.
        name: String,
        /// Its answer.
        problem: String,
    },
    /// The mesh is larger than the adapter's buffers.
    #[error(
        "a mesh of {triangles} triangles and {vertices} vertices needs {bytes} bytes in a buffer, the adapter has {room}"
    )]
    TooLarge {
        /// Triangles.
        triangles: usize,
        /// Vertices.
        vertices: usize,
        /// Bytes of the largest buffer.
        bytes: u64,
        /// Bytes the adapter gives.
        room: u64,
    },
    /// The device went away, refused a command, or did not answer in time.
    #[error("graphics device lost: {0}")]
    Lost(String),
}

/// An open device with its compiled passes; copies share them.
#[derive(Debug, Clone)]
pub struct GpuDevice {
    /// The device.
    pub(super) device: wgpu::Device,
    /// Its queue.
    pub(super) queue: wgpu::Queue,
    /// The compiled shaders.
    pub(super) passes: Arc<Passes>,
    /// Most bytes of a storage buffer.
    pub(super) room: u64,
    name: String,
    is_software: bool,
    /// The first thing that went wrong outside a call.
    trouble: Arc<OnceLock<String>>,
}

impl GpuDevice {
    /// Opens the first adapter that can do the work: Vulkan, else OpenGL. `WGPU_BACKEND` limits the
    /// choice.
    pub fn open() -> Result<Self, GpuError> {
        let mut refused = GpuError::NoAdapter;
        let interfaces = Backends::from_env().map_or(vec![Backends::VULKAN, Backends::GL], |one| vec![one]);
        for backends in interfaces {
            let mut request = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
            request.backends = backends;
            let power = wgpu::RequestAdapterOptions {
                power_preference: wgpu::PowerPreference::HighPerformance,
                ..wgpu::RequestAdapterOptions::default()
            };
            let found = pollster::block_on(wgpu::Instance::new(request).request_adapter(&power));
            match found.map_err(|_| GpuError::NoAdapter).and_then(|adapter| Self::of(&adapter)) {
                Ok(device) => return Ok(device),
                Err(GpuError::NoAdapter) => {}
                Err(error) => refused = error,
            }
        }
        Err(refused)
    }

    fn of(adapter: &wgpu::Adapter) -> Result<Self, GpuError> {
        let info = adapter.get_info();
        let name = format!("{} ({})", info.name, info.backend);
        let has = adapter.limits();
        let limits = wgpu::Limits {
            max_storage_buffers_per_shader_stage: STORAGE_BUFFERS,
            max_storage_buffer_binding_size: has.max_storage_buffer_binding_size,
            max_buffer_size: has.max_buffer_size,
            ..wgpu::Limits::downlevel_defaults()
        };
        let room = limits.max_buffer_size.min(limits.max_storage_buffer_binding_size);
        let request = wgpu::DeviceDescriptor {
            label: Some("collision"),
            // For those who time the parts of a query.
            required_features: adapter.features() & FEATURES,
            required_limits: limits,
            ..wgpu::DeviceDescriptor::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&request))
            .map_err(|e| GpuError::Refused { name: name.clone(), problem: e.to_string() })?;
        let trouble = Arc::new(OnceLock::new());
        let (refused, lost) = (trouble.clone(), trouble.clone());
        device.on_uncaptured_error(Arc::new(move |error| {
            let _ = refused.set(error.to_string());
        }));
        device.set_device_lost_callback(move |reason, text| {
            let _ = lost.set(format!("{reason:?}: {text}"));
        });
        let passes = Arc::new(Passes::new(&device));
        let gpu = GpuDevice {
            device,
            queue,
            passes,
            room,
            name,
            is_software: info.device_type == DeviceType::Cpu,
            trouble,
        };
        gpu.check().map(|()| gpu)
    }

    /// Memory for `words`, filled with 0.
    pub(super) fn buffer(&self, label: &str, words: usize, usage: wgpu::BufferUsages) -> Buffer {
        let size = 4 * words.max(4) as u64;
        let descriptor =
            wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false };
        self.device.create_buffer(&descriptor)
    }

    /// Adapter and interface, for people.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// True if the processor does the adapter's work.
    pub fn is_software(&self) -> bool {
        self.is_software
    }

    /// Refuses to go on after trouble.
    pub(super) fn check(&self) -> Result<(), GpuError> {
        self.trouble.get().map_or(Ok(()), |problem| Err(GpuError::Lost(problem.clone())))
    }

    /// Submits, waits, and hands the first `bytes` of `staging`, which the commands fill, to
    /// `read`.
    pub(super) fn run<T>(
        &self,
        encoder: CommandEncoder,
        staging: &Buffer,
        bytes: u64,
        read: impl FnOnce(&[u32]) -> T,
    ) -> Result<T, GpuError> {
        let submission = self.queue.submit([encoder.finish()]);
        let slice = staging.slice(..bytes);
        slice.map_async(MapMode::Read, |_| {});
        let wait = PollType::Wait { submission_index: Some(submission), timeout: Some(LONGEST_WAIT) };
        self.device.poll(wait).map_err(|e| GpuError::Lost(e.to_string()))?;
        self.check()?;
        let mapped = slice.get_mapped_range().map_err(|e| GpuError::Lost(e.to_string()))?;
        let result = read(bytemuck::cast_slice(&mapped));
        drop(mapped);
        staging.unmap();
        Ok(result)
    }
}
