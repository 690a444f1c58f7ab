//! What the lamp sees, in one pass; the lamp's own body is left out. Full tiers: a depth map of two
//! tiles, instruments, which cast full shadows, and the membrane, which dims. Lean tiers: a mask of
//! light, which costs a pixel of the picture one fetch instead of several comparisons.

use super::bodies::Bodies;
use super::instruments::Meshes;
use super::membrane::TissueBuffers;
use super::{COLOUR, DEPTH, PassDevice, PipelineSpec, Uniforms, clear_depth, drawn_and_read};
use super::{texture_descriptor, view};
use crate::governor::{Shading, Tier};
use crate::lamp::MAP_RAD;
use protocol::dose::beam_share;
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;
use wgpu::{
    BlendComponent, BlendFactor, BlendOperation, BlendState, ColorWrites, CommandEncoder, CompareFunction,
    Device, Queue, RenderPass, RenderPassColorAttachment, RenderPassTimestampWrites, RenderPipeline,
    TexelCopyBufferLayout, Texture, TextureUsages, TextureView,
};

/// A shadow map for one shading: the texture that the other shading would use is a single pixel.
pub struct ShadowMap {
    /// Depth of two square tiles, side by side.
    pub depth: TextureView,
    /// Light past instruments, their distance from the lamp, light of the beam past the membrane.
    pub mask: TextureView,
    /// The mask's texture, and one that nothing throws a shadow into; none in full tiers.
    lean: Option<[Texture; 2]>,
    /// Edge of a tile or of the mask, px.
    pub size: u32,
    shading: Shading,
}

impl ShadowMap {
    /// For `tier`.
    pub fn new(device: &Device, queue: &Queue, tier: &Tier) -> Self {
        let texture = |format, size_px| drawn_and_read(device, "shadow map", format, size_px);
        let (size, shading) = (tier.shadow_px, tier.shading);
        match shading {
            Shading::Full => {
                let (depth, mask) = (texture(DEPTH, [2 * size, size]), texture(COLOUR, [1, 1]));
                Self { depth, mask, lean: None, size, shading }
            }
            Shading::Lean => {
                let drawn = TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING;
                let mask = mask_texture(device, size, drawn | TextureUsages::COPY_DST);
                let unshadowed =
                    mask_texture(device, size, TextureUsages::COPY_SRC | TextureUsages::COPY_DST);
                let layout = TexelCopyBufferLayout { bytes_per_row: Some(4 * size), ..Default::default() };
                let pixels = beam_mask(size);
                queue.write_texture(unshadowed.as_image_copy(), &pixels, layout, unshadowed.size());
                let depth = texture(DEPTH, [1, 1]);
                Self { depth, mask: view(&mask), lean: Some([mask, unshadowed]), size, shading }
            }
        }
    }

    /// True if it serves `tier`.
    pub fn serves(&self, tier: &Tier) -> bool {
        (self.size, self.shading) == (tier.shadow_px, tier.shading)
    }
}

fn mask_texture(device: &Device, size: u32, usage: TextureUsages) -> Texture {
    device.create_texture(&texture_descriptor("shadow mask", COLOUR, [size, size], usage))
}

/// The mask where nothing throws a shadow: all light, up to any distance, and of the beam its share.
fn beam_mask(size: u32) -> Vec<u8> {
    let edge = |i: u32| (2.0 * (f64::from(i) + 0.5) / f64::from(size) - 1.0) * MAP_RAD.tan();
    let share = |x: f64, y: f64| beam_share(1.0 / (1.0 + x * x + y * y).sqrt());
    let texel = |i: u32| [255, 255, (255.0 * share(edge(i % size), edge(i / size))).round() as u8, 255];
    (0..size * size).flat_map(texel).collect()
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
    /// Round parts with their soft edges, in the mask.
    round: RenderPipeline,
    membrane: [RenderPipeline; 2],
}

impl Shadow {
    /// Makes the pipelines.
    pub fn new(device: &PassDevice<'_>, uniforms: &Uniforms) -> Self {
        let groups = [&uniforms.layout];
        let spec = |vertex| PipelineSpec { vertices: true, ..PipelineSpec::new("shadow", vertex, &groups) };
        let depth = Some((CompareFunction::Less, true));
        let writes = ColorWrites::RED | ColorWrites::GREEN;
        let instruments = |shading| {
            let spec = PipelineSpec { closed: true, ..spec("vs_instrument") };
            device.pipeline(&match shading {
                Shading::Full => PipelineSpec { depth, ..spec },
                Shading::Lean => PipelineSpec { fragment: Some("fs_solid"), writes, ..spec },
            })
        };
        let membrane = |shading| {
            let of =
                |vertex, fragment| PipelineSpec { homes: true, fragment: Some(fragment), ..spec(vertex) };
            device.pipeline(&match shading {
                Shading::Full => PipelineSpec { depth, format: None, ..of("vs_membrane", "fs_outline") },
                Shading::Lean => PipelineSpec { blend: Some(multiplied()), ..of("vs_sheet", "fs_sheet") },
            })
        };
        let round = PipelineSpec {
            fragment: Some("fs_round"),
            writes,
            blend: Some(the_darker()),
            ..spec("vs_round")
        };
        Self {
            instruments: device.shadings(instruments),
            round: device.pipeline(&round),
            membrane: device.shadings(membrane),
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
        if let Some([mask, unshadowed]) = &map.lean {
            encoder.copy_texture_to_texture(unshadowed.as_image_copy(), mask.as_image_copy(), mask.size());
        }
        let mut pass = begin(encoder, map, timed);
        let (size, shading) = (map.size as f32, map.shading as usize);
        pass.set_bind_group(0, &uniforms.group, &[0]);
        pass.set_viewport(0.0, 0.0, size, size, 0.0, 1.0);
        pass.set_pipeline(&self.instruments[shading]);
        let tools = (0..).zip(casters.tools).filter_map(|(which, tool)| Some((which, tool?)));
        match map.shading {
            Shading::Full => tools.for_each(|(which, tool)| casters.meshes.draw(&mut pass, which, tool)),
            Shading::Lean => {
                tools.clone().for_each(|(which, tool)| casters.meshes.draw_angular(&mut pass, which, tool));
                pass.set_pipeline(&self.round);
                tools.for_each(|(which, tool)| casters.meshes.draw_edges(&mut pass, which, tool));
            }
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
    let ops = wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store };
    let view = &map.mask;
    let mask = [Some(RenderPassColorAttachment { view, depth_slice: None, resolve_target: None, ops })];
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("shadow"),
        color_attachments: if lean { &mask } else { &[] },
        timestamp_writes,
        depth_stencil_attachment: (!lean).then(|| clear_depth(&map.depth, true)),
        ..wgpu::RenderPassDescriptor::default()
    })
}
