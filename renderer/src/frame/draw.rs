//! The layers of a stereo frame, each drawn by the pass that owns it.

use super::Renderer;
use crate::governor::{Shading, TIERS};
use crate::lamp::lamp_index;
use crate::layers::Layers;
use crate::passes::focus::{self, Tiles};
use crate::passes::shadow::{Casters, ShadowMap};
use crate::passes::{VIEW_STRIDE, clear_depth};
use crate::target::Target;
use crate::timing::{Pass, Timing};
use protocol::limits::INSTRUMENTS;
use wgpu::{BindGroup, CommandEncoder, RenderPass};

/// What the passes of one frame draw into and with.
pub struct FrameContext<'a> {
    /// What the shaders compute.
    pub shading: Shading,
    /// Layers to draw.
    pub layers: Layers,
    /// The picture.
    pub target: &'a Target,
    /// Tiles of the depth of field; `None` where the tier or the layers have none.
    pub tiles: Option<&'a Tiles>,
    /// The lamp's shadow map.
    pub shadow_map: &'a ShadowMap,
    /// Bind group 1: fundus map, shadow map.
    pub light: &'a BindGroup,
    /// Timestamps of the passes.
    pub timing: Option<&'a Timing>,
}

impl FrameContext<'_> {
    /// True if overlays are drawn with the picture; full tiers draw them after the depth of field.
    pub fn draws_overlay_with_picture(&self) -> bool {
        self.target.multisampled.is_none()
    }

    /// Begins the pass that draws both channels.
    pub fn begin_picture<'e>(&self, encoder: &'e mut CommandEncoder) -> RenderPass<'e> {
        let target = self.target;
        // Without depth of field the samples are resolved into the picture at once.
        let resolve = |m| if self.tiles.is_some() { m } else { &target.colour };
        let resolved = target.multisampled.as_ref().map(|m| resolve(&m.resolved));
        let store = if resolved.is_some() { wgpu::StoreOp::Discard } else { wgpu::StoreOp::Store };
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("picture"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: target.multisampled.as_ref().map_or(&target.colour, |m| &m.samples),
                depth_slice: None,
                resolve_target: resolved,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store },
            })],
            depth_stencil_attachment: Some(clear_depth(&target.depth, self.tiles.is_some())),
            timestamp_writes: self.timing.map(|t| t.writes(Pass::Picture)),
            ..wgpu::RenderPassDescriptor::default()
        })
    }

    /// Writes the timestamps of the frame's passes to where they can be read.
    pub fn resolve_timestamps(&self, encoder: &mut CommandEncoder) {
        if let Some(timing) = self.timing {
            timing.resolve(encoder, if self.tiles.is_some() { Pass::Focus } else { Pass::Picture });
        }
    }
}

impl Renderer {
    pub(super) fn frame_context(&self, tier_index: usize, layers: Layers) -> FrameContext<'_> {
        let tier = &TIERS[tier_index];
        let serves = |m: &&(ShadowMap, Vec<BindGroup>)| m.0.serves(tier);
        let (shadow_map, lights) =
            self.shadow_maps.iter().find(serves).expect("a shadow map for each tier that was configured");
        FrameContext {
            shading: tier.shading,
            layers,
            target: self.target(tier_index),
            tiles: self.tiles[tier_index].as_ref().filter(|_| layers.has(Layers::FOCUS)),
            shadow_map,
            light: &lights[self.map_level(tier)],
            // A pass that is left out would leave its timestamps unwritten.
            timing: self.timing.as_ref().filter(|_| layers == Layers::ALL),
        }
    }

    /// Instruments, bodies and membrane as the lamp sees them; the lamp itself casts no shadow.
    pub(super) fn draw_shadow_map(&self, encoder: &mut CommandEncoder, frame: &FrameContext<'_>) {
        if frame.layers.has(Layers::SHADOW) {
            let lamp = lamp_index(&self.tools);
            let casters = Casters {
                meshes: &self.meshes,
                tools: [0, 1].map(|i| self.tools[i].filter(|_| lamp != Some(i))),
                bodies: &self.bodies,
                tissue: &self.tissue_buffers,
            };
            let timed = frame.timing.map(|t| t.writes(Pass::Shadow));
            self.shadow.draw(encoder, frame.shadow_map, &self.uniforms, &casters, timed);
        }
    }

    /// Viewport, scissor and bind groups of a channel.
    pub(super) fn set_channel(&self, pass: &mut RenderPass<'_>, frame: &FrameContext<'_>, channel: u32) {
        let (width_px, height_px) = (frame.target.width_px, frame.target.height_px);
        let (width, height) = (width_px as f32, height_px as f32);
        pass.set_viewport(channel as f32 * width, 0.0, width, height, 0.0, 1.0);
        // Overlong triangles must not reach into the other channel.
        pass.set_scissor_rect(channel * width_px, 0, width_px, height_px);
        pass.set_bind_group(0, &self.uniforms.group, &[channel * VIEW_STRIDE]);
        pass.set_bind_group(1, frame.light, &[]);
    }

    /// Instruments whose tracking is `lost`, or those where it is not.
    pub(super) fn draw_instruments(&self, pass: &mut RenderPass<'_>, frame: &FrameContext<'_>, lost: bool) {
        for which in (0..INSTRUMENTS).filter(|_| frame.layers.has(Layers::INSTRUMENTS)) {
            if let (Some(tool), true) = (self.tools[which], self.lost_before[which] == lost) {
                self.instruments.draw(pass, &self.meshes, which, tool, frame.shading);
            }
        }
    }

    /// Edges of the instruments' shafts, where a pixel has one sample. After everything that lies
    /// behind them: they let it through by the share of a pixel that they leave free.
    pub(super) fn draw_edges(&self, pass: &mut RenderPass<'_>, frame: &FrameContext<'_>) {
        let drawn = frame.layers.has(Layers::INSTRUMENTS) && frame.shading == Shading::Lean;
        for which in (0..INSTRUMENTS).filter(|_| drawn) {
            if let Some(tool) = self.tools[which] {
                self.instruments.draw_edges(pass, &self.meshes, which, tool);
            }
        }
    }

    /// Rigid bodies of abstract tasks.
    pub(super) fn draw_bodies(&self, pass: &mut RenderPass<'_>, frame: &FrameContext<'_>) {
        if frame.layers.has(Layers::BODIES) {
            self.bodies.draw(pass, frame.shading);
        }
    }

    /// Lifted retina, the fundus behind it, and the dose of light where it is shown.
    pub(super) fn draw_retina(&self, pass: &mut RenderPass<'_>, frame: &FrameContext<'_>) {
        if frame.layers.has(Layers::RETINA) {
            self.retina.draw(pass, &self.tissue_buffers, frame.shading);
            self.fundus.draw(pass, &frame.target.cells, frame.shading);
            self.dose.draw(pass, &frame.target.cells, frame.shading);
        }
    }

    /// Marks on the retina: targets, bleeding points.
    pub(super) fn draw_marks(&self, pass: &mut RenderPass<'_>, frame: &FrameContext<'_>) {
        if frame.layers.has(Layers::BODIES) {
            self.marks.draw(pass, frame.shading);
        }
    }

    /// The translucent membrane.
    pub(super) fn draw_membrane(&self, pass: &mut RenderPass<'_>, frame: &FrameContext<'_>) {
        if frame.layers.has(Layers::MEMBRANE) {
            self.membrane.draw(pass, &self.tissue_buffers, frame.shading);
        }
    }

    /// The vitreous.
    pub(super) fn draw_haze(&self, pass: &mut RenderPass<'_>, frame: &FrameContext<'_>) {
        if frame.layers.has(Layers::HAZE) {
            self.haze.draw(pass, &frame.target.cells, frame.shading);
        }
    }

    /// Depth of the membrane, for the depth of field of full tiers.
    pub(super) fn draw_membrane_depth(&self, pass: &mut RenderPass<'_>, frame: &FrameContext<'_>) {
        if frame.layers.has(Layers::MEMBRANE) && frame.shading == Shading::Full {
            self.membrane.draw_depth(pass, &self.tissue_buffers);
        }
    }

    /// The picture with what is out of focus blurred, and the overlays, which stay sharp.
    pub(super) fn draw_depth_of_field(&self, encoder: &mut CommandEncoder, frame: &FrameContext<'_>) {
        let Some(tiles) = frame.tiles else { return };
        self.focus.find_reach(encoder, tiles);
        let timed = frame.timing.map(|t| t.writes(Pass::Focus));
        let mut pass = focus::begin(encoder, &frame.target.colour, "focus", timed);
        self.focus.draw(&mut pass, tiles);
        for channel in self.channels.clone() {
            self.set_channel(&mut pass, frame, channel);
            self.draw_overlay(&mut pass, frame);
        }
    }

    /// The ring that warns of lost tracking.
    pub(super) fn draw_overlay(&self, pass: &mut RenderPass<'_>, frame: &FrameContext<'_>) {
        if self.lost_before.contains(&true) || self.eye_lost_before {
            self.fundus.draw_lost_ring(pass, frame.shading);
        }
    }
}
