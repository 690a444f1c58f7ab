//! Uniforms of a frame: filled in from the scene and the latched poses just before submission.

use super::Renderer;
use crate::cells::cell_ndc;
use crate::governor::{Shading, TIERS, Tier};
use crate::lamp::{self, Lamp, lamp_index};
use crate::latch::Latched;
use crate::layout::{FrameUniform, InstrumentUniform, ViewUniform};
use crate::passes::VIEW_STRIDE;
use crate::tools::{JAW_LENGTH_MM, round_from_mm};
use crate::view::{CHANNELS, FIELD_FILL, focus_plane, view_uniform};
use crate::{fundus_map, optics};
use bytemuck::Zeroable;
use glam::Mat4;
use protocol::scene::Microscope;
use wgpu::Queue;

/// Opacity of an instrument that is not tracked.
const LOST_OPACITY: f32 = 0.35;
/// Share of light that the membrane takes away.
const MEMBRANE_SHADE: f32 = 0.30;
/// Strength of the retina's specular film at full detail.
const FILM: f32 = 0.07;
/// Tilt of the retina where a vessel rises by its full height within a texel.
const RELIEF: f32 = 0.35;
/// Tilt of the membrane's fine wrinkles.
const WRINKLES: f32 = 0.045;
/// Depth bias of the shadow map, in its depth.
const SHADOW_BIAS: f32 = 2e-5;
/// Least half width of the soft edge of a shadow: share of the map, and texels.
const SHADOW_SOFT: f32 = 1.2e-3;
const SHADOW_SOFT_PX: f32 = 0.75;
/// Greatest half width, share of the map: that of a caster 1.5 mm from the lamp.
const SHADOW_WIDEST: f32 = 0.03;

impl Renderer {
    /// Writes the uniforms of both channels for the latched poses.
    pub(super) fn write_uniforms(&self, queue: &Queue, tier_index: usize, latched: &Latched) {
        let tier = &TIERS[tier_index];
        let frame = self.frame_uniform(tier, latched);
        queue.write_buffer(&self.uniforms.frame, 0, bytemuck::bytes_of(&frame));
        let eye_from_world = latched.world_from_eye.inverse();
        let aspect = f64::from(tier.width_px) / f64::from(tier.height_px);
        let mut views = [0u8; CHANNELS * VIEW_STRIDE as usize];
        for (channel, slot) in views.chunks_exact_mut(VIEW_STRIDE as usize).enumerate() {
            let mut uniform = view_uniform(&self.microscope, channel, aspect, &eye_from_world);
            [uniform.plane_x[3], uniform.plane_y[3]] = cell_ndc(tier);
            uniform.camera[3] = 2.0 / tier.height_px as f32;
            slot[..size_of::<ViewUniform>()].copy_from_slice(bytemuck::bytes_of(&uniform));
        }
        queue.write_buffer(&self.uniforms.views, 0, &views);
        self.focus.set(queue, &focus_plane(&self.microscope), px_per_mm(&self.microscope, tier));
    }

    fn frame_uniform(&self, tier: &Tier, latched: &Latched) -> FrameUniform {
        let mut uniform = FrameUniform::zeroed();
        Lamp::find(&self.tools, latched).write(&mut uniform, self.filter);
        uniform.ambient[3] = MEMBRANE_SHADE;
        let radius = self.config.retina_radius_mm as f32;
        // Map coordinates are half an equal-area radius of the unit sphere: see the shader.
        uniform.retina = [radius, fundus_map::map_scale(), 0.0, FILM];
        uniform.penumbra = [lamp::soft_edge_per_depth() as f32, SHADOW_WIDEST, radius.recip(), 0.0];
        let softest = SHADOW_SOFT.max(SHADOW_SOFT_PX / tier.shadow_px as f32);
        uniform.shadow = [SHADOW_BIAS, softest, RELIEF, WRINKLES];
        let poses = latched.eye_from_instrument();
        self.haze.write(&mut uniform);
        let pipe = lamp_index(&self.tools);
        uniform.instruments = std::array::from_fn(|i| {
            let (pose, lit) = (poses[i].as_mat4(), pipe != Some(i));
            self.instrument_uniform(i, &pose, latched.tracked[i], lit)
        });
        uniform
    }

    /// Level of the fundus map to draw with.
    pub(super) fn map_level(&self, tier: &Tier) -> usize {
        let px_per_mm = f64::from(tier.height_px) / optics::field_in_eye_mm(&self.microscope);
        // Where no pass blurs what is out of focus, a coarser level of the photograph does it for
        // the retina.
        let lean = tier.shading == Shading::Lean;
        let blur = if lean { blur_at_target_px(&self.microscope, tier).max(1.0).log2().round() } else { 0.0 };
        self.map.level(px_per_mm as f32, self.config.retina_radius_mm as f32, blur as usize)
    }

    /// One instrument; a light pipe is not lit by its own beam.
    fn instrument_uniform(
        &self,
        which: usize,
        eye_from_instrument: &Mat4,
        tracked: bool,
        lit: bool,
    ) -> InstrumentUniform {
        let shaft = &self.config.shafts[which];
        let flag = |holds: bool| if holds { 1.0 } else { 0.0 };
        let round_from = self.tools[which].map_or(0.0, round_from_mm);
        InstrumentUniform {
            eye_from_instrument: eye_from_instrument.to_cols_array_2d(),
            shape: [
                (0.5 * self.jaws_rad[which]) as f32,
                JAW_LENGTH_MM,
                if tracked { 1.0 } else { LOST_OPACITY },
                flag(lit),
            ],
            shaft: [shaft.radius_mm, shaft.length_mm, flag(self.tools[which].is_some()), round_from],
        }
    }
}

/// Diameter of the patch that a point at the target's height makes, px.
fn blur_at_target_px(microscope: &Microscope, tier: &Tier) -> f64 {
    optics::blur_mm(microscope, microscope.working_distance_mm) * px_per_mm(microscope, tier)
}

/// Pixels of a millimetre of the plane of focus.
fn px_per_mm(microscope: &Microscope, tier: &Tier) -> f64 {
    f64::from(tier.height_px) * FIELD_FILL / microscope.field_mm.max(0.1)
}
