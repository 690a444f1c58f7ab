//! The shadow map: what the lamp sees. One depth pass, two tiles: instruments, which cast full
//! shadows, and the membrane, which dims. The lamp's own body is left out.

use super::instruments::Meshes;
use super::membrane::Sheet;
use super::{DEPTH, PipelinePlan, Uniforms, pipeline};
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;
use wgpu::{CommandEncoder, CompareFunction, Device, RenderPipeline, TextureUsages, TextureView};

/// A shadow map of two square tiles.
pub struct ShadowMap {
    /// The depth texture.
    pub view: TextureView,
    /// Edge of a tile, px.
    pub size: u32,
}

impl ShadowMap {
    /// With tiles of `size` pixels.
    pub fn new(device: &Device, size: u32) -> Self {
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("shadow map"),
            size: wgpu::Extent3d { width: 2 * size, height: size, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: DEPTH,
            usage: TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        Self { view: texture.create_view(&wgpu::TextureViewDescriptor::default()), size }
    }
}

/// The pass.
pub struct Shadow {
    instruments: RenderPipeline,
    membrane: RenderPipeline,
}

impl Shadow {
    /// Makes the pipelines.
    pub fn new(device: &Device, uniforms: &Uniforms) -> Self {
        let make = |vertex| {
            let plan = PipelinePlan {
                shader: "shadow",
                vertex,
                fragment: None,
                groups: &[&uniforms.layout],
                vertices: true,
                strip: false,
                depth: Some((CompareFunction::Less, true)),
                blend: None,
                shading: None,
            };
            pipeline(device, &plan)
        };
        Self { instruments: make("vs_instrument"), membrane: make("vs_membrane") }
    }

    /// Draws the map. `casters` are the tools that cast a shadow; the lamp is `None`.
    pub fn draw(
        &self,
        encoder: &mut CommandEncoder,
        map: &ShadowMap,
        uniforms: &Uniforms,
        (meshes, casters): (&Meshes, &[Option<Tool>; INSTRUMENTS]),
        sheet: Option<&Sheet>,
    ) {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow"),
            depth_stencil_attachment: Some(super::clear_depth(&map.view, true)),
            ..wgpu::RenderPassDescriptor::default()
        });
        let size = map.size as f32;
        pass.set_bind_group(0, &uniforms.group, &[0]);
        pass.set_viewport(0.0, 0.0, size, size, 0.0, 1.0);
        pass.set_pipeline(&self.instruments);
        for (which, tool) in casters.iter().enumerate() {
            if let Some(tool) = tool {
                meshes.draw(&mut pass, which, *tool);
            }
        }
        if let Some(sheet) = sheet {
            pass.set_viewport(size, 0.0, size, size, 0.0, 1.0);
            pass.set_pipeline(&self.membrane);
            sheet.draw(&mut pass);
        }
    }
}
