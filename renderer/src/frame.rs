//! `Renderer`: takes a scene, encodes its passes in order, then latches the poses and draws.

use crate::assets::{AssetError, Assets};
use crate::cells::{Cells, cell_ndc};
use crate::fundus_map;
use crate::governor::{Shading, TIERS, Tier};
use crate::gpu::Gpu;
use crate::lamp::{self, Lamp, lamp_index};
use crate::latch::Latched;
use crate::layers::Layers;
use crate::layout::{FrameUniform, InstrumentUniform, ViewUniform};
use crate::optics;
use crate::passes::bodies::Bodies;
use crate::passes::dose::Dose;
use crate::passes::focus::{self, Focus, Tiles};
use crate::passes::fundus::{Fundus, FundusMap, light_group, light_layout};
use crate::passes::haze::Haze;
use crate::passes::instruments::{Instruments, Meshes};
use crate::passes::marks::Marks;
use crate::passes::membrane::{Membrane, Sheet};
use crate::passes::retina::Retina;
use crate::passes::shadow::{Shadow, ShadowMap};
use crate::passes::text::Text;
use crate::passes::{Uniforms, VIEW_STRIDE, clear_depth};
use crate::target::Target;
use crate::timing::{Pass, PassTimes, Timing};
use crate::tissue::Tissue;
use crate::tools::{JAW_LENGTH_MM, Shaft};
use crate::view::{CHANNELS, FIELD_FILL, focus_plane, view};
use bytemuck::Zeroable;
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;
use protocol::message::Invalid;
use protocol::optics::Filter;
use protocol::scene::{
    Microscope, SceneBody, SceneBrick, SceneHeader, SceneHome, SceneMark, SceneNode, SceneTriangle, section,
};
use protocol::scene_text::{Place, push_line};
use scene::Side;
use wgpu::{BindGroup, CommandBuffer, CommandEncoder, RenderPass};

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
/// Least half width of the soft edge of a shadow, share of the map: about a texel.
const SHADOW_SOFT: f32 = 1.2e-3;
/// Greatest half width, share of the map: that of a caster 1.5 mm from the lamp.
const SHADOW_WIDEST: f32 = 0.03;

/// What a renderer is made for.
#[derive(Debug, Clone, Copy)]
pub struct Plan {
    /// Which eye.
    pub side: Side,
    /// Inner radius of the retina, mm.
    pub retina_radius_mm: f64,
    /// Shafts of the instruments.
    pub shafts: [Shaft; INSTRUMENTS],
    /// Nodes and triangles of the tissue to make room for.
    pub tissue: [usize; 2],
    /// Best tier that will be asked for.
    pub first_tier: usize,
    /// Edge of the fundus map, px.
    pub map_px: u32,
}

/// Everything needed to draw.
pub struct Renderer {
    plan: Plan,
    uniforms: Uniforms,
    map: FundusMap,
    shadow_maps: Vec<(ShadowMap, BindGroup)>,
    targets: Vec<Option<Target>>,
    tiles: Vec<Option<Tiles>>,
    meshes: Meshes,
    sheet: Sheet,
    tissue: Tissue,
    shadow: Shadow,
    fundus: Fundus,
    instruments: Instruments,
    membrane: Membrane,
    retina: Retina,
    bodies: Bodies,
    marks: Marks,
    haze: Haze,
    dose: Dose,
    focus: Focus,
    text: Text,
    timing: Option<Timing>,
    tools: [Option<Tool>; INSTRUMENTS],
    jaws_rad: [f64; INSTRUMENTS],
    microscope: Microscope,
    filter: Filter,
    scene_text: String,
    status: String,
    overlay: String,
    overlay_alone: bool,
    lines: String,
    lost_before: [bool; INSTRUMENTS],
    eye_lost_before: bool,
}

impl Renderer {
    /// Makes every resource; nothing is made later, unless a scene is larger than foreseen.
    pub fn new(gpu: &Gpu, plan: Plan) -> Result<Self, AssetError> {
        Ok(Self::with_assets(gpu, plan, &Assets::shipped()?))
    }

    /// As [`Self::new`], with a photograph and meshes that are not the shipped ones.
    pub fn with_assets(gpu: &Gpu, plan: Plan, assets: &Assets) -> Self {
        let (device, queue) = (&gpu.device, &gpu.queue);
        let uniforms = Uniforms::new(device);
        let layout = light_layout(device);
        let map = FundusMap::new(device, queue, &assets.photograph, plan.map_px, plan.side);
        let mut shadow_maps: Vec<(ShadowMap, BindGroup)> = Vec::new();
        for tier in &TIERS[plan.first_tier..] {
            if !shadow_maps.iter().any(|(map, _)| map.serves(tier)) {
                let shadow = ShadowMap::new(device, tier);
                let group = light_group(device, &layout, &map, &shadow);
                shadow_maps.push((shadow, group));
            }
        }
        let target = |(i, tier)| (i >= plan.first_tier).then(|| Target::new(device, tier));
        let targets: Vec<Option<Target>> = TIERS.iter().enumerate().map(target).collect();
        let focus = Focus::new(device);
        let tiles = |target: &Option<Target>| {
            let target = target.as_ref()?;
            let size_px = [2 * target.width_px, target.height_px];
            Some(focus.tiles(device, target.fine.as_ref()?, size_px))
        };
        Self {
            plan,
            shadow_maps,
            tiles: targets.iter().map(tiles).collect(),
            targets,
            meshes: Meshes::new(device, queue, &assets.models, &plan.shafts),
            sheet: Sheet::new(device, plan.tissue[0], plan.tissue[1]),
            tissue: Tissue::with_capacity(plan.tissue[0], plan.tissue[1]),
            shadow: Shadow::new(device, &uniforms),
            fundus: Fundus::new(device, queue, &uniforms, &layout),
            instruments: Instruments::new(device, &uniforms, &layout),
            membrane: Membrane::new(device, &uniforms, &layout),
            retina: Retina::new(device, &uniforms, &layout),
            bodies: Bodies::new(device, queue, &uniforms, &layout),
            marks: Marks::new(device, &uniforms, &layout),
            haze: Haze::new(device, &uniforms, &layout),
            dose: Dose::new(device, &uniforms, &layout),
            focus,
            text: Text::new(device, queue, &uniforms),
            timing: Timing::new(gpu),
            uniforms,
            map,
            tools: [None; INSTRUMENTS],
            jaws_rad: [0.0; INSTRUMENTS],
            microscope: Microscope::zeroed(),
            filter: Filter::Clear,
            scene_text: String::with_capacity(256),
            status: String::with_capacity(64),
            overlay: String::new(),
            overlay_alone: false,
            lines: String::with_capacity(512),
            lost_before: [false; INSTRUMENTS],
            eye_lost_before: false,
        }
    }

    /// Takes a scene in; refuses one whose sections do not lie in its payload.
    pub fn take_scene(&mut self, gpu: &Gpu, header: &SceneHeader, payload: &[u8]) -> Result<(), Invalid> {
        let nodes: &[SceneNode] = section(payload, header.nodes)?;
        let triangles: &[SceneTriangle] = section(payload, header.triangles)?;
        let (marks, bodies): (&[SceneMark], &[SceneBody]) =
            (section(payload, header.marks)?, section(payload, header.bodies)?);
        let bricks: &[SceneBrick] = section(payload, header.bricks)?;
        let text = section::<u8>(payload, header.text)?;
        let homes: &[SceneHome] = section(payload, header.homes)?;
        let doses: &[f32] = section(payload, header.doses)?;
        self.marks.set(&gpu.queue, marks);
        self.bodies.set(&gpu.queue, bodies);
        self.haze.set(&gpu.device, &gpu.queue, bricks);
        self.dose.set(&gpu.queue, doses);
        self.sheet.reserve(&gpu.device, nodes.len(), triangles.len());
        if self.tissue.take(nodes, triangles, homes, header.topology) {
            self.sheet.set_triangles(&gpu.queue, self.tissue.triangles(), self.tissue.counts());
        }
        self.microscope = header.microscope;
        self.filter = Filter::from_wire(header.filter);
        self.tools = header.instruments.map(|i| Tool::from_wire(i.tool));
        self.scene_text.clear();
        self.scene_text.push_str(std::str::from_utf8(text).unwrap_or_default());
        self.jaws_rad = header.instruments.map(|i| i.jaw_rad);
        Ok(())
    }

    /// Triangles of the present scene that could not be drawn.
    pub fn refused_triangles(&self) -> u64 {
        self.tissue.refused
    }

    /// What the last frame took by the device's own clock, once, after the device is done; `None` where it stamps nothing.
    pub fn pass_times(&mut self) -> Option<PassTimes> {
        self.timing.as_mut()?.read()
    }

    /// The picture of a tier.
    ///
    /// # Panics
    /// If `tier` is better than the plan's first.
    pub fn target(&self, tier: usize) -> &Target {
        self.targets[tier].as_ref().expect("a tier that was planned for")
    }

    /// Records the passes of a stereo frame, in order. No pose is needed yet.
    pub fn encode(&self, gpu: &Gpu, tier_index: usize) -> CommandBuffer {
        self.encode_layers(gpu, tier_index, Layers::ALL)
    }

    /// As [`Self::encode`], with some layers only, to measure what each costs.
    pub fn encode_layers(&self, gpu: &Gpu, tier_index: usize, layers: Layers) -> CommandBuffer {
        let tier = &TIERS[tier_index];
        // A pass that is left out would leave its stamps unwritten.
        let timing = self.timing.as_ref().filter(|_| layers == Layers::ALL);
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let (shadow_map, light) = self.light_for(tier);
        if layers.has(Layers::SHADOW) {
            let lamp = lamp_index(&self.tools);
            let casters = [0, 1].map(|i| self.tools[i].filter(|_| lamp != Some(i)));
            let others = (&self.bodies, &self.sheet);
            let timed = timing.map(|t| t.writes(Pass::Shadow));
            let meshes = (&self.meshes, &casters);
            self.shadow.draw(&mut encoder, shadow_map, &self.uniforms, meshes, others, timed);
        }

        let target = self.target(tier_index);
        let focus = self.tiles[tier_index].as_ref().filter(|_| layers.has(Layers::FOCUS));
        // Without the layer the samples make the picture at once.
        let resolved = target.fine.as_ref().map(|f| if focus.is_some() { &f.drawn } else { &target.colour });
        let kept = if resolved.is_some() { wgpu::StoreOp::Discard } else { wgpu::StoreOp::Store };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("picture"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: target.fine.as_ref().map_or(&target.colour, |f| &f.samples),
                depth_slice: None,
                resolve_target: resolved,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: kept },
            })],
            depth_stencil_attachment: Some(clear_depth(&target.depth, focus.is_some())),
            timestamp_writes: timing.map(|t| t.writes(Pass::Picture)),
            ..wgpu::RenderPassDescriptor::default()
        });
        for channel in 0..CHANNELS as u32 {
            self.set_channel(&mut pass, target, channel, light);
            self.draw_channel(&mut pass, &target.cells, (tier, layers));
            if target.fine.is_none() {
                self.draw_over(&mut pass, target, channel, (tier, layers));
            }
        }
        drop(pass);
        if let Some(tiles) = focus {
            self.draw_focused(&mut encoder, (target, tiles), light, (tier, layers), timing);
        }
        if let Some(timing) = timing {
            timing.resolve(&mut encoder, if focus.is_some() { Pass::Focus } else { Pass::Picture });
        }
        encoder.finish()
    }

    /// Of full tiers: the picture with what is out of focus spread, and what lies over it.
    fn draw_focused(
        &self,
        encoder: &mut CommandEncoder,
        (target, tiles): (&Target, &Tiles),
        light: &BindGroup,
        (tier, layers): (&Tier, Layers),
        timing: Option<&Timing>,
    ) {
        self.focus.find_reach(encoder, tiles);
        let timed = timing.map(|t| t.writes(Pass::Focus));
        let mut pass = focus::begin(encoder, &target.colour, "focus", timed);
        self.focus.draw(&mut pass, tiles);
        for channel in 0..CHANNELS as u32 {
            self.set_channel(&mut pass, target, channel, light);
            self.draw_over(&mut pass, target, channel, (tier, layers));
        }
    }

    /// What lies over a channel, whatever is in focus: the ring of lost bodies, text.
    fn draw_over(
        &self,
        pass: &mut RenderPass<'_>,
        target: &Target,
        channel: u32,
        (tier, layers): (&Tier, Layers),
    ) {
        if self.lost_before.contains(&true) || self.eye_lost_before {
            self.fundus.draw_lost_ring(pass, tier.shading);
        }
        if layers.has(Layers::TEXT) {
            let size = [target.width_px, target.height_px].map(|n| n as f32);
            self.text.draw(pass, channel as f32 * size[0], size, tier.shading);
        }
    }

    fn light_for(&self, tier: &Tier) -> &(ShadowMap, BindGroup) {
        let fits = |m: &&(ShadowMap, BindGroup)| m.0.serves(tier);
        self.shadow_maps.iter().find(fits).expect("a shadow map for each tier that was planned for")
    }

    /// Viewport, scissor and groups of a channel.
    fn set_channel(&self, pass: &mut RenderPass<'_>, target: &Target, channel: u32, light: &BindGroup) {
        let (width, height) = (target.width_px as f32, target.height_px as f32);
        pass.set_viewport(channel as f32 * width, 0.0, width, height, 0.0, 1.0);
        // Overlong triangles must not reach into the other channel.
        pass.set_scissor_rect(channel * target.width_px, 0, target.width_px, target.height_px);
        pass.set_bind_group(0, &self.uniforms.group, &[channel * VIEW_STRIDE]);
        pass.set_bind_group(1, light, &[]);
    }

    /// Solid instruments hide the retina; lost ones show it through.
    fn draw_channel(&self, pass: &mut RenderPass<'_>, cells: &Cells, (tier, layers): (&Tier, Layers)) {
        self.fundus.close_outside(pass, tier.shading);
        if layers.has(Layers::INSTRUMENTS) {
            self.draw_instruments(pass, false, tier.shading);
        }
        if layers.has(Layers::BODIES) {
            self.bodies.draw(pass, tier.shading);
        }
        if layers.has(Layers::RETINA) {
            self.retina.draw(pass, &self.sheet, tier.shading);
            self.fundus.draw(pass, cells, tier.shading);
            self.dose.draw(pass, (&self.fundus, cells), tier.shading);
        }
        if layers.has(Layers::BODIES) {
            self.marks.draw(pass, tier.shading);
        }
        if layers.has(Layers::INSTRUMENTS) {
            self.draw_instruments(pass, true, tier.shading);
        }
        if layers.has(Layers::MEMBRANE) {
            self.membrane.draw(pass, &self.sheet, tier.shading);
        }
        if layers.has(Layers::HAZE) {
            self.haze.draw(pass, (&self.fundus, cells), tier.shading);
        }
        if layers.has(Layers::MEMBRANE) && tier.shading == Shading::Full {
            self.membrane.draw_depth(pass, &self.sheet);
        }
    }

    fn draw_instruments(&self, pass: &mut RenderPass<'_>, lost: bool, shading: Shading) {
        for which in 0..INSTRUMENTS {
            if let (Some(tool), true) = (self.tools[which], self.lost_before[which] == lost) {
                self.instruments.draw(pass, &self.meshes, (which, tool), shading);
            }
        }
    }

    /// The last step before the device starts: uniforms and membrane from the latched poses, then
    /// submission. Returns at once. Text and the order of a body just lost follow with the next frame.
    pub fn submit(&mut self, gpu: &Gpu, tier: usize, latched: &Latched, commands: CommandBuffer) {
        let frame = self.frame_uniform(tier, latched);
        gpu.queue.write_buffer(&self.uniforms.frame, 0, bytemuck::bytes_of(&frame));
        let eye_from_world = latched.world_from_eye.inverse();
        let aspect = f64::from(TIERS[tier].width_px) / f64::from(TIERS[tier].height_px);
        let mut views = [0u8; CHANNELS * VIEW_STRIDE as usize];
        for (channel, slot) in views.chunks_exact_mut(VIEW_STRIDE as usize).enumerate() {
            let mut uniform = view(&self.microscope, channel, aspect, &eye_from_world);
            [uniform.plane_x[3], uniform.plane_y[3]] = cell_ndc(&TIERS[tier]);
            slot[..size_of::<ViewUniform>()].copy_from_slice(bytemuck::bytes_of(&uniform));
        }
        gpu.queue.write_buffer(&self.uniforms.views, 0, &views);
        self.focus.set(&gpu.queue, &focus_plane(&self.microscope), px_per_mm(&self.microscope, &TIERS[tier]));
        let eye_from_instrument = latched.eye_from_instrument().map(|m| m.as_mat4());
        self.sheet.set_vertices(&gpu.queue, self.tissue.place(&eye_from_instrument));
        self.timing.iter_mut().for_each(Timing::before_submit);
        gpu.queue.submit([commands]);
        self.timing.iter_mut().for_each(Timing::after_submit);
        self.collect_text(latched);
        self.text.set(&gpu.queue, &self.lines);
        self.lost_before = latched.tracked.map(|t| !t);
        self.eye_lost_before = !latched.eye_tracked;
    }

    /// Draws the dose of light over the retina from the next frame on, or no longer.
    pub fn show_dose(&mut self, gpu: &Gpu, shown: bool) {
        self.dose.show(&gpu.queue, shown);
    }

    /// A line in a corner of the picture from the next frame on; empty for none.
    pub fn say(&mut self, status: &str) {
        self.status.clear();
        self.status.push_str(status);
    }

    /// Lines of `protocol::scene_text` over the picture from the next frame on; `alone`: in place of the scene's.
    pub fn overlay(&mut self, lines: &str, alone: bool) {
        self.overlay.clear();
        self.overlay.push_str(lines);
        self.overlay_alone = alone;
    }

    /// Every line that the next frame shows.
    fn collect_text(&mut self, latched: &Latched) {
        self.lines.clear();
        for line in self.status.lines() {
            push_line(&mut self.lines, Place::TopLeft, line);
        }
        push_line(&mut self.lines, Place::Bottom, lost_text(latched));
        self.lines.push_str(&self.overlay);
        if !self.overlay_alone {
            self.lines.push_str(&self.scene_text);
        }
    }

    fn frame_uniform(&self, tier_index: usize, latched: &Latched) -> FrameUniform {
        let tier = &TIERS[tier_index];
        let mut uniform = FrameUniform::zeroed();
        Lamp::find(&self.tools, latched).write(&mut uniform, self.filter);
        uniform.ambient[3] = MEMBRANE_SHADE;
        let radius = self.plan.retina_radius_mm as f32;
        let px_per_mm = f64::from(tier.height_px) / optics::field_in_eye_mm(&self.microscope);
        // Where no pass blurs what is out of focus, a coarser level of the photograph does it for the retina.
        let lean = tier.shading == Shading::Lean;
        let blur = if lean { blur_at_target_px(&self.microscope, tier).max(1.0).log2().round() } else { 0.0 };
        // Map coordinates are half an equal-area radius of the unit sphere: see the shader.
        let level = self.map.level(px_per_mm as f32, radius) + blur as f32;
        uniform.retina = [radius, fundus_map::map_scale(), level, FILM];
        uniform.penumbra = [lamp::soft_edge_per_depth() as f32, SHADOW_WIDEST, radius.recip(), 0.0];
        uniform.shadow = [SHADOW_BIAS, SHADOW_SOFT, RELIEF, WRINKLES];
        let poses = latched.eye_from_instrument();
        self.haze.write(&mut uniform);
        let pipe = lamp_index(&self.tools);
        uniform.instruments = std::array::from_fn(|i| InstrumentUniform {
            eye_from_instrument: poses[i].as_mat4().to_cols_array_2d(),
            shape: [
                (0.5 * self.jaws_rad[i]) as f32,
                JAW_LENGTH_MM,
                if latched.tracked[i] { 1.0 } else { LOST_OPACITY },
                if pipe == Some(i) { 0.0 } else { 1.0 },
            ],
            shaft: [
                self.plan.shafts[i].radius_mm,
                self.plan.shafts[i].length_mm,
                f32::from(u8::from(self.tools[i].is_some())),
                0.0,
            ],
        });
        uniform
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

/// What the picture says about bodies that are not tracked.
fn lost_text(latched: &Latched) -> &'static str {
    match (latched.tracked, latched.eye_tracked) {
        ([true, true], true) => "",
        ([false, true], true) => "TRACKING LOST: INST0",
        ([true, false], true) => "TRACKING LOST: INST1",
        ([false, false], true) => "TRACKING LOST: INST0 INST1",
        ([true, true], false) => "TRACKING LOST: EYE",
        ([false, true], false) => "TRACKING LOST: INST0 EYE",
        ([true, false], false) => "TRACKING LOST: INST1 EYE",
        ([false, false], false) => "TRACKING LOST: INST0 INST1 EYE",
    }
}
