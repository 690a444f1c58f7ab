//! Depth of field of the full tiers: points out of focus are spread over circles of confusion, see
//! [`crate::optics::blur_mm`]. Three passes find each pixel's radius and the widest in each tile
//! and its neighbours; where nothing is out of focus, the last pass only copies.

use super::{
    COLOUR, FILTERED, PassDevice, PipelineSpec, UNFILTERED, UNIFORM, bind_group, bind_group_layout, buffer,
    clear_colour, drawn_and_read, texture_type,
};
use crate::target::Multisampled;
use crate::view::FocusPlane;
use bytemuck::{Pod, Zeroable};
use wgpu::{
    BindGroup, BindGroupLayout, BindingResource, BindingType, Buffer, BufferUsages, CommandEncoder, Device,
    Queue, RenderPass, RenderPipeline, ShaderStages, TextureFormat, TextureView, TextureViewDimension,
};

/// Edge of a tile, px, as in the shader.
const TILE_PX: u32 = 16;
/// Widest circle of confusion in a tile, share of the largest possible.
const REACH: TextureFormat = TextureFormat::R8Unorm;
/// Radius of a pixel's circle of confusion.
const RADIUS: TextureFormat = TextureFormat::R16Float;

/// Uniform of the shader.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct FocusUniform {
    /// A and B of distance = B / (A − depth), distance of the plane in focus (mm), half the
    /// aperture in pixels of that plane.
    optics: [f32; 4],
}

/// The pass.
pub struct Focus {
    uniform: Buffer,
    layout: BindGroupLayout,
    /// For the radii, the widest of a tile, that of it and its neighbours, the picture; none where no
    /// tier has full shading.
    pipelines: Option<[RenderPipeline; 4]>,
}

/// Textures and bind groups that the pass needs beside a target.
pub struct Tiles {
    /// Radii of the circles of confusion; the widest of each tile; the widest of a tile and its
    /// neighbours.
    views: [TextureView; 3],
    /// For the passes that write these, and for the last pass.
    groups: [BindGroup; 4],
}

impl Focus {
    /// Makes the pipelines.
    pub fn new(device: &PassDevice<'_>) -> Self {
        let layout = layout(device);
        let groups = [&layout];
        let spec = |fragment, format| PipelineSpec {
            fragment: Some(fragment),
            strip: true,
            format: Some(format),
            ..PipelineSpec::new("focus", "vs_main", &groups)
        };
        Self {
            pipelines: device.for_full(|| {
                let stages =
                    [("fs_radius", RADIUS), ("fs_tile", REACH), ("fs_reach", REACH), ("fs_main", COLOUR)];
                stages.map(|(fragment, format)| device.pipeline(&spec(fragment, format)))
            }),
            uniform: buffer(device, "focus", size_of::<FocusUniform>(), BufferUsages::UNIFORM),
            layout,
        }
    }

    /// Room for the tiles of a target of `size_px`, both channels.
    pub fn tiles(&self, device: &Device, samples: &Multisampled, size_px: [u32; 2]) -> Tiles {
        let make = |format, size_px| drawn_and_read(device, "focus", format, size_px);
        let tiles_px = size_px.map(|n| n.div_ceil(TILE_PX));
        let (radii, tiles, reach) = (make(RADIUS, size_px), make(REACH, tiles_px), make(REACH, tiles_px));
        // A pass must not read the texture that it writes; another one stands in.
        let groups = [(&samples.resolved, &tiles), (&radii, &reach), (&radii, &tiles), (&radii, &reach)];
        let groups = groups.map(|(radii, tiles)| self.group(device, samples, radii, tiles));
        Tiles { views: [radii, tiles, reach], groups }
    }

    fn group(
        &self,
        device: &Device,
        samples: &Multisampled,
        radii: &TextureView,
        tiles: &TextureView,
    ) -> BindGroup {
        let [drawn, depths, tiles, radii] =
            [&samples.resolved, &samples.depth, tiles, radii].map(BindingResource::TextureView);
        let uniform = self.uniform.as_entire_binding();
        bind_group(device, "focus", &self.layout, [uniform, drawn, depths, tiles, radii])
    }

    /// Sets the plane in focus; `px_per_mm`: pixels of a millimetre of that plane.
    pub fn set(&self, queue: &Queue, plane: &FocusPlane, px_per_mm: f64) {
        let [a, b] = plane.distance_of_depth;
        let half = 0.5 * plane.aperture_mm * px_per_mm;
        let uniform = FocusUniform { optics: [a, b, plane.distance_mm, half].map(|x| x as f32) };
        queue.write_buffer(&self.uniform, 0, bytemuck::bytes_of(&uniform));
    }

    /// Finds the widest circles of confusion, by tile.
    pub fn find_reach(&self, encoder: &mut CommandEncoder, tiles: &Tiles) {
        for (i, pipeline) in self.pipelines.iter().flat_map(|all| &all[..3]).enumerate() {
            let mut pass = begin(encoder, &tiles.views[i], "reach of patches", None);
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &tiles.groups[i], &[]);
            pass.draw(0..3, 0..1);
        }
    }

    /// Draws the blurred picture into `pass`.
    pub fn draw(&self, pass: &mut RenderPass<'_>, tiles: &Tiles) {
        let Some([.., spread]) = &self.pipelines else { return };
        pass.set_pipeline(spread);
        pass.set_bind_group(0, &tiles.groups[3], &[]);
        pass.draw(0..3, 0..1);
    }
}

/// A pass that writes every pixel of `view`.
pub fn begin<'a>(
    encoder: &'a mut CommandEncoder,
    view: &TextureView,
    label: &str,
    timestamp_writes: Option<wgpu::RenderPassTimestampWrites<'_>>,
) -> RenderPass<'a> {
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some(label),
        color_attachments: &[clear_colour(view, wgpu::Color::BLACK)],
        timestamp_writes,
        ..wgpu::RenderPassDescriptor::default()
    })
}

fn layout(device: &Device) -> BindGroupLayout {
    let texture = texture_type(FILTERED, TextureViewDimension::D2);
    let samples = BindingType::Texture {
        sample_type: UNFILTERED,
        view_dimension: TextureViewDimension::D2,
        multisampled: true,
    };
    let types = [UNIFORM, texture, samples, texture, texture];
    bind_group_layout(device, "focus", ShaderStages::FRAGMENT, &types)
}
