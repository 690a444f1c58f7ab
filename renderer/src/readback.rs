//! Brings finished pictures back from the device, only when an output asks for one.

use crate::compose::output_px;
use crate::governor::TIERS;
use crate::gpu::{Gpu, GpuError};
use crate::passes::buffer;
use wgpu::{Buffer, BufferUsages, COPY_BYTES_PER_ROW_ALIGNMENT, MapMode, Texture};

/// A picture of both channels side by side, RGBA, 8 bits, rows from top to bottom.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Picture {
    /// px.
    pub width_px: u32,
    /// px.
    pub height_px: u32,
    /// `width_px * height_px * 4` bytes.
    pub rgba: Vec<u8>,
}

impl Picture {
    /// With room for the largest picture in files of the tiers from `first_tier` on.
    pub fn with_room(first_tier: usize) -> Self {
        let [width, height] = largest_px(first_tier);
        let rgba = Vec::with_capacity((2 * width * height * 4) as usize);
        Self { width_px: 0, height_px: 0, rgba }
    }

    /// RGB of a pixel.
    pub fn rgb(&self, x: u32, y: u32) -> [u8; 3] {
        let at = ((y * self.width_px + x) * 4) as usize;
        [self.rgba[at], self.rgba[at + 1], self.rgba[at + 2]]
    }
}

/// The buffer through which pictures come back.
pub struct ReadBack {
    buffer: Buffer,
}

/// Size of a channel that holds every picture of the tiers from `first_tier` on, in files too, px.
fn largest_px(first_tier: usize) -> [u32; 2] {
    let sizes = TIERS[first_tier..].iter().map(output_px);
    sizes.fold([0, 0], |most, size| [most[0].max(size[0]), most[1].max(size[1])])
}

fn row_bytes(width_px: u32) -> u32 {
    (width_px * 4).next_multiple_of(COPY_BYTES_PER_ROW_ALIGNMENT)
}

impl ReadBack {
    /// With room for every tier from `first_tier` on.
    pub fn new(gpu: &Gpu, first_tier: usize) -> Self {
        let [width, height] = largest_px(first_tier);
        let size = (row_bytes(2 * width) * height) as usize;
        Self { buffer: buffer(&gpu.device, "read-back", size, BufferUsages::MAP_READ) }
    }

    /// Copies `texture`, the picture of a tier or of a file, into `picture`, whose memory is used
    /// again.
    ///
    /// # Errors
    /// If the device was lost.
    pub fn read(&self, gpu: &Gpu, texture: &Texture, picture: &mut Picture) -> Result<(), GpuError> {
        let size = texture.size();
        let stride = row_bytes(size.width);
        let bytes = u64::from(stride * size.height);
        let layout = wgpu::TexelCopyBufferLayout { bytes_per_row: Some(stride), ..Default::default() };
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let to = wgpu::TexelCopyBufferInfo { buffer: &self.buffer, layout };
        encoder.copy_texture_to_buffer(texture.as_image_copy(), to, size);
        gpu.queue.submit([encoder.finish()]);
        let slice = self.buffer.slice(..bytes);
        slice.map_async(MapMode::Read, |_| {});
        gpu.wait()?;
        let mapped = slice.get_mapped_range().map_err(|e| GpuError::Lost(e.to_string()))?;
        picture.rgba.clear();
        for row in mapped.chunks_exact(stride as usize) {
            picture.rgba.extend_from_slice(&row[..size.width as usize * 4]);
        }
        drop(mapped);
        self.buffer.unmap();
        (picture.width_px, picture.height_px) = (size.width, size.height);
        Ok(())
    }
}
