//! The graphics device: Vulkan where there is one, else OpenGL; for a window or headless.

use crate::governor::FIRST_LEAN;
use std::sync::{Arc, OnceLock};
use wgpu::{Adapter, Backend, Backends, Device, DeviceType, Instance, Queue, Surface, SurfaceTarget};

/// Why nothing can be drawn.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    /// Neither Vulkan nor OpenGL answers.
    #[error(
        "no graphics driver found (tried Vulkan and OpenGL); install the software driver with \
         `sudo apt-get install mesa-vulkan-drivers`, or run without a picture: `vitreo run --no-picture`"
    )]
    NoAdapter,
    /// The driver refused.
    #[error("graphics driver {name}: {problem}")]
    Refused {
        /// The adapter.
        name: String,
        /// Its answer.
        problem: String,
    },
    /// OpenGL draws full shading as a black field (seen with Mesa 22.3's llvmpipe).
    #[error(
        "tier {tier} has full shading, which needs Vulkan and not {name}; install a \
         driver with `sudo apt-get install mesa-vulkan-drivers`, or use --tier {FIRST_LEAN} or higher"
    )]
    LeanOnly {
        /// What was asked for.
        tier: usize,
        /// The adapter.
        name: String,
    },
    /// The device went away.
    #[error("graphics device lost: {0}")]
    Lost(String),
}

/// An open device; clones share it.
#[derive(Clone)]
pub struct Gpu {
    /// The adapter.
    pub adapter: Adapter,
    /// The device.
    pub device: Device,
    /// Its queue.
    pub queue: Queue,
    /// Name of adapter and interface, for people.
    pub name: String,
    /// True if the processor draws.
    pub is_software: bool,
    /// True if it draws tiers of lean shading alone, as through OpenGL.
    pub is_lean: bool,
    /// Why the device went away, once it has.
    lost: Arc<OnceLock<String>>,
}

impl Gpu {
    /// Opens a device that needs no display.
    ///
    /// # Errors
    /// If no driver answers or it refuses the device.
    pub fn headless() -> Result<Self, GpuError> {
        let mut opened = interfaces().into_iter().map(Self::headless_through);
        opened.find(|gpu| !matches!(gpu, Err(GpuError::NoAdapter))).unwrap_or(Err(GpuError::NoAdapter))
    }

    /// The same through one of `backends`.
    ///
    /// # Errors
    /// If none of them answers or the driver refuses the device.
    pub fn headless_through(backends: Backends) -> Result<Self, GpuError> {
        Self::open(adapter(&instance(backends), None).ok_or(GpuError::NoAdapter)?)
    }

    /// Opens a device that can show on `target`, and its surface.
    ///
    /// # Errors
    /// If no driver can draw onto `target` or it refuses the device.
    pub fn for_surface<T>(target: T) -> Result<(Self, Surface<'static>), GpuError>
    where
        T: Into<SurfaceTarget<'static>> + Clone,
    {
        for backends in interfaces() {
            let instance = instance(backends);
            let Ok(surface) = instance.create_surface(target.clone()) else { continue };
            if let Some(adapter) = adapter(&instance, Some(&surface)) {
                return Ok((Self::open(adapter)?, surface));
            }
        }
        Err(GpuError::NoAdapter)
    }

    fn open(adapter: Adapter) -> Result<Self, GpuError> {
        let info = adapter.get_info();
        let name = format!("{} ({})", info.name, info.backend);
        let limits = wgpu::Limits::downlevel_defaults().using_resolution(adapter.limits());
        let request = wgpu::DeviceDescriptor {
            label: Some("vitreo"),
            required_limits: limits,
            required_features: adapter.features() & wgpu::Features::TIMESTAMP_QUERY,
            ..wgpu::DeviceDescriptor::default()
        };
        let opened = pollster::block_on(adapter.request_device(&request));
        let (device, queue) =
            opened.map_err(|e| GpuError::Refused { name: name.clone(), problem: e.to_string() })?;
        // A refused command spoils one picture; the simulator goes on.
        let lost = Arc::new(OnceLock::new());
        let name_of_device = name.clone();
        let known = Arc::clone(&lost);
        device.on_uncaptured_error(Arc::new(move |e| {
            // A lost device refuses every command; `wait` returns that once, as an error.
            if known.get().is_none() {
                tracing::error!("graphics: {e}");
            }
        }));
        let tell = Arc::clone(&lost);
        device.set_device_lost_callback(move |reason, message| {
            let _ = tell.set(format!("{name_of_device}: {reason:?}, {message}"));
        });
        let (is_software, is_lean) = (info.device_type == DeviceType::Cpu, info.backend == Backend::Gl);
        Ok(Self { adapter, device, queue, name, is_software, is_lean, lost })
    }

    /// Asks for a tier that the user has chosen.
    ///
    /// # Errors
    /// If it has full shading and this adapter cannot draw that.
    pub fn check_tier(&self, tier: usize) -> Result<(), GpuError> {
        let refused = self.is_lean && tier < FIRST_LEAN;
        if refused { Err(GpuError::LeanOnly { tier, name: self.name.clone() }) } else { Ok(()) }
    }

    /// Waits until everything submitted is done.
    ///
    /// # Errors
    /// If the device was lost.
    pub fn wait(&self) -> Result<(), GpuError> {
        let done = self.device.poll(wgpu::PollType::wait_indefinitely());
        match (self.lost.get(), done) {
            (Some(why), _) => Err(GpuError::Lost(why.clone())),
            (None, Err(e)) => Err(GpuError::Lost(e.to_string())),
            (None, Ok(_)) => Ok(()),
        }
    }
}

/// What to try in turn; `WGPU_BACKEND` in the environment limits the choice.
fn interfaces() -> Vec<Backends> {
    match Backends::from_env() {
        Some(chosen) => vec![chosen],
        None => vec![Backends::VULKAN, Backends::GL],
    }
}

fn instance(backends: Backends) -> Instance {
    let mut request = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
    request.backends = backends;
    Instance::new(request)
}

fn adapter(instance: &Instance, surface: Option<&Surface<'static>>) -> Option<Adapter> {
    let request = wgpu::RequestAdapterOptions {
        power_preference: wgpu::PowerPreference::HighPerformance,
        compatible_surface: surface,
        ..wgpu::RequestAdapterOptions::default()
    };
    pollster::block_on(instance.request_adapter(&request)).ok()
}
