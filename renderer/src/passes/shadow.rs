//! What the lamp sees, in one pass; the lamp's own body is left out. Full tiers: a depth map of two
//! tiles, instruments, which cast full shadows, and the membrane, which dims. Lean tiers: a mask of
//! light, which costs a pixel of the picture one fetch instead of several comparisons.

use super::bodies::Bodies;
use super::instruments::Meshes;
use super::membrane::TissueBuffers;
use super::{COLOUR, DEPTH, PassDevice, PipelineSpec, Uniforms, clear_colour, clear_depth, drawn_and_read};
use crate::governor::{Shading, Tier};
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;
use wgpu::{
    BlendComponent, BlendFactor, BlendOperation, BlendState, ColorWrites, CommandEncoder, CompareFunction,
    Device, RenderPass, RenderPassTimestampWrites, RenderPipeline, TextureView,
};

/// A shadow map for one shading: the texture that the other shading would use is a single pixel.
pub struct ShadowMap {
    /// Depth of two square tiles, side by side.
    pub depth: TextureView,
    /// Light past instruments, their distance from the lamp, light past the membrane.
    pub mask: TextureView,
    /// Edge of a tile or of the mask, px.
    pub size: u32,
    shading: Shading,
}

impl ShadowMap {
    /// For `tier`.
    pub fn new(device: &Device, tier: &Tier) -> Self {
        let texture = |format, size_px| drawn_and_read(device, "shadow map", format, size_px);
        let size = tier.shadow_px;
        let (depth_px, mask_px) = match tier.shading {
            Shading::Full => ([2 * size, size], [1, 1]),
            Shading::Lean => ([1, 1], [size, size]),
        };
        Self { depth: texture(DEPTH, depth_px), mask: texture(COLOUR, mask_px), size, shading: tier.shading }
    }

    /// True if it serves `tier`.
    pub fn serves(&self, tier: &Tier) -> bool {
        (self.size, self.shading) == (tier.shadow_px, tier.shading)
    }
}

/// What throws a shadow.
pub struct Casters<'a> {
    /// Meshes of the instruments.
    pub meshes: &'a Meshes,
    /// Tools of the instruments that throw a shadow; `None` for the lamp.
    pub tools: [Option<Tool>; INSTRUMENTS],
    /// Rigid bodies.
    pub bodies: &'a Bodies,
    /// Membrane.
    pub tissue: &'a TissueBuffers,
}

/// The pass: pipelines for each shading.
pub struct Shadow {
    instruments: [RenderPipeline; 2],
    /// Soft edges of round parts, in the mask.
    edges: RenderPipeline,
    membrane: [RenderPipeline; 2],
}

impl Shadow {
    /// Makes the pipelines.
    pub fn new(device: &PassDevice<'_>, uniforms: &Uniforms) -> Self {
        let groups = [&uniforms.layout];
        let spec = |vertex| PipelineSpec { vertices: true, ..PipelineSpec::new("shadow", vertex, &groups) };
        let depth = PipelineSpec {
            depth: Some((CompareFunction::Less, true)),
            closed: true,
            ..spec("vs_instrument")
        };
        let writes = ColorWrites::RED | ColorWrites::GREEN;
        let solid =
            PipelineSpec { fragment: Some("fs_solid"), writes, closed: true, ..spec("vs_instrument") };
        let edges =
            PipelineSpec { fragment: Some("fs_edge"), writes, blend: Some(the_darker()), ..spec("vs_edge") };
        let sheet = PipelineSpec {
            fragment: Some("fs_sheet"),
            blend: Some(multiplied()),
            homes: true,
            ..spec("vs_membrane")
        };
        let outline = PipelineSpec {
            fragment: Some("fs_outline"),
            depth: Some((CompareFunction::Less, true)),
            format: None,
            homes: true,
            ..spec("vs_membrane")
        };
        Self {
            instruments: [device.pipeline(&depth), device.pipeline(&solid.shaded(Shading::Lean))],
            edges: device.pipeline(&edges.shaded(Shading::Lean)),
            membrane: [device.pipeline(&outline), device.pipeline(&sheet)],
        }
    }

    /// Draws the map.
    pub fn draw(
        &self,
        encoder: &mut CommandEncoder,
        map: &ShadowMap,
        uniforms: &Uniforms,
        casters: &Casters<'_>,
        timed: Option<RenderPassTimestampWrites<'_>>,
    ) {
        let mut pass = begin(encoder, map, timed);
        let (size, shading) = (map.size as f32, map.shading as usize);
        pass.set_bind_group(0, &uniforms.group, &[0]);
        pass.set_viewport(0.0, 0.0, size, size, 0.0, 1.0);
        pass.set_pipeline(&self.instruments[shading]);
        let tools = (0..).zip(casters.tools).filter_map(|(which, tool)| Some((which, tool?)));
        for (which, tool) in tools.clone() {
            casters.meshes.draw(&mut pass, which, tool);
        }
        if map.shading == Shading::Lean {
            pass.set_pipeline(&self.edges);
            tools.for_each(|(which, tool)| casters.meshes.draw_edges(&mut pass, which, tool));
        }
        casters.bodies.cast(&mut pass, map.shading);
        if map.shading == Shading::Full {
            pass.set_viewport(size, 0.0, size, size, 0.0, 1.0);
        }
        pass.set_pipeline(&self.membrane[shading]);
        casters.tissue.draw(&mut pass);
    }
}

/// What is there times what comes.
fn multiplied() -> BlendState {
    blended(BlendFactor::Dst, BlendFactor::Zero, BlendOperation::Add)
}

/// The lesser of what is there and what comes.
fn the_darker() -> BlendState {
    blended(BlendFactor::One, BlendFactor::One, BlendOperation::Min)
}

fn blended(src_factor: BlendFactor, dst_factor: BlendFactor, operation: BlendOperation) -> BlendState {
    let component = BlendComponent { src_factor, dst_factor, operation };
    BlendState { color: component, alpha: component }
}

fn begin<'a>(
    encoder: &'a mut CommandEncoder,
    map: &ShadowMap,
    timestamp_writes: Option<RenderPassTimestampWrites<'_>>,
) -> RenderPass<'a> {
    let lean = map.shading == Shading::Lean;
    let mask = [clear_colour(&map.mask, wgpu::Color::WHITE)];
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("shadow"),
        color_attachments: if lean { &mask } else { &[] },
        timestamp_writes,
        depth_stencil_attachment: (!lean).then(|| clear_depth(&map.depth, true)),
        ..wgpu::RenderPassDescriptor::default()
    })
}
