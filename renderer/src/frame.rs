//! `Renderer`: takes a scene, records the passes of a stereo frame in their order, then latches the
//! poses and submits.

mod draw;
pub mod overlay;
mod uniform;

use crate::assets::{AssetError, Assets};
use crate::governor::TIERS;
use crate::gpu::Gpu;
use crate::latch::Latched;
use crate::layers::Layers;
use crate::passes::bodies::Bodies;
use crate::passes::dose::Dose;
use crate::passes::focus::{Focus, Tiles};
use crate::passes::fundus::{Fundus, FundusMap, light_groups, light_layout};
use crate::passes::haze::Haze;
use crate::passes::instruments::{Instruments, Meshes};
use crate::passes::marks::Marks;
use crate::passes::membrane::{Membrane, TissueBuffers};
use crate::passes::retina::Retina;
use crate::passes::shadow::{Shadow, ShadowMap};
use crate::passes::{PassDevice, Uniforms};
use crate::stereo::Arrangement;
use crate::target::Target;
use crate::timing::{PassTimes, Timing};
use crate::tissue::Tissue;
use crate::tools::Shaft;
use crate::view::CHANNELS;
use bytemuck::Zeroable;
use overlay::OverlayText;
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;
use protocol::message::Invalid;
use protocol::optics::Filter;
use protocol::phases::{Phase, Phases, Unmarked};
use protocol::scene::{Microscope, SceneHeader, SceneNode, SceneTriangle, section};
use scene::Side;
use std::ops::Range;
use wgpu::{BindGroup, CommandBuffer};

/// What a [`Renderer`] allocates for.
#[derive(Debug, Clone, Copy)]
pub struct RendererConfig {
    /// Left or right eye.
    pub side: Side,
    /// Inner radius of the retina, mm.
    pub retina_radius_mm: f64,
    /// Shafts of the instruments.
    pub shafts: [Shaft; INSTRUMENTS],
    /// Nodes and triangles of the tissue to allocate for.
    pub tissue: [usize; 2],
    /// Best tier that is allocated.
    pub first_tier: usize,
    /// Edge of the fundus map, px.
    pub map_px: u32,
}

/// Every resource of the device that drawing needs, and the newest scene.
pub struct Renderer {
    config: RendererConfig,
    uniforms: Uniforms,
    map: FundusMap,
    /// Each with bind group 1 for every level of the fundus map.
    shadow_maps: Vec<(ShadowMap, Vec<BindGroup>)>,
    targets: Vec<Option<Target>>,
    tiles: Vec<Option<Tiles>>,
    meshes: Meshes,
    tissue_buffers: TissueBuffers,
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
    timing: Option<Timing>,
    tools: [Option<Tool>; INSTRUMENTS],
    jaws_rad: [f64; INSTRUMENTS],
    microscope: Microscope,
    filter: Filter,
    overlay: OverlayText,
    /// Channels that are drawn.
    channels: Range<u32>,
    lost_before: [bool; INSTRUMENTS],
    eye_lost_before: bool,
}

impl Renderer {
    /// Makes every resource, with the shipped photograph and meshes. Nothing is allocated later,
    /// unless a scene is larger than `config.tissue`.
    ///
    /// # Errors
    /// If a shipped asset cannot be decoded.
    pub fn new(gpu: &Gpu, config: RendererConfig) -> Result<Self, AssetError> {
        Ok(Self::with_assets(gpu, config, &Assets::shipped()?))
    }

    /// As [`Self::new`], with other assets than the shipped ones.
    pub fn with_assets(gpu: &Gpu, config: RendererConfig, assets: &Assets) -> Self {
        let (device, queue) = (&gpu.device, &gpu.queue);
        let passes = PassDevice::new(device, config.first_tier);
        let uniforms = Uniforms::new(device);
        let layout = light_layout(device);
        let map = FundusMap::new(device, queue, assets.map(config.map_px, config.side), config.map_px);
        let mut shadow_maps: Vec<(ShadowMap, Vec<BindGroup>)> = Vec::new();
        for tier in &TIERS[config.first_tier..] {
            if !shadow_maps.iter().any(|(map, _)| map.serves(tier)) {
                let shadow = ShadowMap::new(device, queue, tier);
                let groups = light_groups(device, &layout, &map, &shadow);
                shadow_maps.push((shadow, groups));
            }
        }
        let target = |(i, tier)| (i >= config.first_tier).then(|| Target::new(device, tier));
        let targets: Vec<Option<Target>> = TIERS.iter().enumerate().map(target).collect();
        let focus = Focus::new(&passes);
        let tiles = |target: &Option<Target>| {
            let target = target.as_ref()?;
            let size_px = [2 * target.width_px, target.height_px];
            Some(focus.tiles(device, target.multisampled.as_ref()?, size_px))
        };
        Self {
            config,
            shadow_maps,
            tiles: targets.iter().map(tiles).collect(),
            targets,
            meshes: Meshes::new(device, &assets.models, &config.shafts),
            tissue_buffers: TissueBuffers::new(device, 2 * config.tissue[0], 2 * config.tissue[1]),
            tissue: Tissue::with_capacity(config.tissue[0], config.tissue[1]),
            shadow: Shadow::new(&passes, &uniforms),
            fundus: Fundus::new(&passes, &uniforms, &layout),
            instruments: Instruments::new(&passes, &uniforms, &layout),
            membrane: Membrane::new(&passes, &uniforms, &layout),
            retina: Retina::new(&passes, &uniforms, &layout),
            bodies: Bodies::new(&passes, &uniforms, &layout),
            marks: Marks::new(&passes, &uniforms, &layout),
            haze: Haze::new(&passes, &uniforms, &layout),
            dose: Dose::new(&passes, &uniforms, &layout),
            focus,
            timing: Timing::new(gpu),
            uniforms,
            map,
            tools: [None; INSTRUMENTS],
            jaws_rad: [0.0; INSTRUMENTS],
            microscope: Microscope::zeroed(),
            filter: Filter::Clear,
            overlay: OverlayText::new(),
            channels: 0..CHANNELS as u32,
            lost_before: [false; INSTRUMENTS],
            eye_lost_before: false,
        }
    }

    /// Takes a scene in; the next frame shows it.
    ///
    /// # Errors
    /// If a section does not lie in the payload. The scene before stays.
    pub fn take_scene(&mut self, gpu: &Gpu, header: &SceneHeader, payload: &[u8]) -> Result<(), Invalid> {
        let nodes: &[SceneNode] = section(payload, header.nodes)?;
        let triangles: &[SceneTriangle] = section(payload, header.triangles)?;
        let marks = section(payload, header.marks)?;
        let bodies = section(payload, header.bodies)?;
        let bricks = section(payload, header.bricks)?;
        let text = section(payload, header.text)?;
        let homes = section(payload, header.homes)?;
        let doses = section(payload, header.doses)?;
        self.marks.set(&gpu.queue, marks);
        self.bodies.set(&gpu.queue, bodies);
        self.haze.set(&gpu.device, &gpu.queue, bricks);
        self.dose.set(&gpu.queue, doses);
        if self.tissue.take(nodes, triangles, homes, header.topology) {
            let (vertices, triangles) = (self.tissue.homes().len(), self.tissue.triangles().len());
            self.tissue_buffers.reserve(&gpu.device, vertices, triangles);
            self.tissue_buffers.set_triangles(&gpu.queue, self.tissue.triangles(), self.tissue.counts());
            self.tissue_buffers.set_homes(&gpu.queue, self.tissue.homes());
        }
        self.microscope = header.microscope;
        self.filter = Filter::from_wire(header.filter);
        self.tools = header.instruments.map(|i| Tool::from_wire(i.tool));
        self.overlay.set_scene(text);
        self.jaws_rad = header.instruments.map(|i| i.jaw_rad);
        Ok(())
    }

    /// Triangles of the present scene that name nodes which do not exist and are not drawn.
    pub fn refused_triangles(&self) -> u64 {
        self.tissue.refused
    }

    /// Times of the last frame's passes by the device's own clock, once, after the device is done;
    /// `None` where the device has no timestamps.
    pub fn pass_times(&mut self) -> Option<PassTimes> {
        self.timing.as_mut()?.read()
    }

    /// The picture of a tier.
    ///
    /// # Panics
    /// If `tier` is better than `first_tier` of the configuration.
    pub fn target(&self, tier: usize) -> &Target {
        self.targets[tier].as_ref().expect("a tier that was configured")
    }

    /// Records the passes of a stereo frame. No pose is needed yet.
    pub fn encode(&self, gpu: &Gpu, tier_index: usize) -> CommandBuffer {
        self.encode_layers(gpu, tier_index, Layers::ALL)
    }

    /// As [`Self::encode`]; the end of each pass is marked on `phases`.
    pub fn encode_in_phases(&self, gpu: &Gpu, tier_index: usize, phases: &mut impl Phases) -> CommandBuffer {
        self.record_passes(gpu, tier_index, Layers::ALL, phases)
    }

    /// As [`Self::encode`], with some layers only, to measure the cost of each. The device times
    /// the passes `shadow`, `picture` and `focus`; see [`crate::timing`].
    pub fn encode_layers(&self, gpu: &Gpu, tier_index: usize, layers: Layers) -> CommandBuffer {
        self.record_passes(gpu, tier_index, layers, &mut Unmarked)
    }

    fn record_passes(
        &self,
        gpu: &Gpu,
        tier_index: usize,
        layers: Layers,
        phases: &mut impl Phases,
    ) -> CommandBuffer {
        let frame = self.frame_context(tier_index, layers);
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.draw_shadow_map(&mut encoder, &frame);
        phases.ended(Phase::EncodeShadow);
        let mut picture = frame.begin_picture(&mut encoder);
        for channel in self.channels.clone() {
            self.set_channel(&mut picture, &frame, channel);
            self.fundus.draw_field_mask(&mut picture, frame.shading);
            // Those that are tracked are opaque and hide the retina; it shines through lost ones.
            self.draw_instruments(&mut picture, &frame, false);
            self.draw_bodies(&mut picture, &frame);
            self.draw_retina(&mut picture, &frame);
            self.draw_marks(&mut picture, &frame);
            self.draw_instruments(&mut picture, &frame, true);
            self.draw_membrane(&mut picture, &frame);
            self.draw_haze(&mut picture, &frame);
            self.draw_edges(&mut picture, &frame);
            self.draw_membrane_depth(&mut picture, &frame);
            if frame.draws_overlay_with_picture() {
                self.draw_overlay(&mut picture, &frame);
            }
        }
        drop(picture);
        phases.ended(Phase::EncodePicture);
        self.draw_depth_of_field(&mut encoder, &frame);
        frame.resolve_timestamps(&mut encoder);
        let commands = encoder.finish();
        phases.ended(Phase::EncodeFocus);
        commands
    }

    /// Writes uniforms and tissue for the latched poses and submits `commands`. Returns at once,
    /// while the device draws. The fading of a body just lost follows with the next frame.
    pub fn submit(
        &mut self,
        gpu: &Gpu,
        tier: usize,
        latched: &Latched,
        commands: impl IntoIterator<Item = CommandBuffer>,
    ) {
        self.submit_timed(gpu, tier, latched, commands, &mut || 0);
    }

    /// As [`Self::submit`]. `clock` gives nanoseconds for what is returned and nothing else: the time
    /// of the calls that upload the tissue's vertices, and its triangles where their order changed.
    /// These calls copy to where the device fetches it; computing the vertices is not part of them,
    /// nor is what [`Self::take_scene`] uploads when a sheet is cut or torn.
    pub fn submit_timed(
        &mut self,
        gpu: &Gpu,
        tier: usize,
        latched: &Latched,
        commands: impl IntoIterator<Item = CommandBuffer>,
        clock: &mut dyn FnMut() -> u64,
    ) -> u64 {
        self.write_uniforms(&gpu.queue, tier, latched);
        let eye_from_instrument = latched.eye_from_instrument().map(|m| m.as_mat4());
        let radius_mm = self.config.retina_radius_mm as f32;
        let vertices = self.tissue.vertices(&eye_from_instrument, radius_mm);
        let begun = clock();
        self.tissue_buffers.set_vertices(&gpu.queue, vertices);
        if self.tissue.is_restacked() {
            self.tissue_buffers.set_triangles(&gpu.queue, self.tissue.triangles(), self.tissue.counts());
        }
        let transfer_ns = clock().saturating_sub(begun);
        self.timing.iter_mut().for_each(Timing::before_submit);
        gpu.queue.submit(commands);
        self.timing.iter_mut().for_each(Timing::after_submit);
        self.settle(latched);
        transfer_ns
    }

    /// Lets the next frame have the fading of these poses. Where no time passes between frames, to be
    /// called before [`Self::encode`], so that each frame has its own.
    pub fn settle(&mut self, latched: &Latched) {
        self.overlay.collect(latched);
        self.lost_before = latched.tracked.map(|t| !t);
        self.eye_lost_before = !latched.eye_tracked;
    }

    /// Shows or hides the dose of light on the retina from the next frame on.
    pub fn show_dose(&mut self, gpu: &Gpu, shown: bool) {
        self.dose.show(&gpu.queue, shown);
    }

    /// Lines of `protocol::scene_text` over the picture submitted last, which who shows it writes at
    /// the size of what it is shown on.
    pub fn text(&self) -> &str {
        self.overlay.lines()
    }

    /// Sets the lines in the top left corner from the next frame on; empty for none.
    pub fn set_status(&mut self, status: &str) {
        self.overlay.set_status(status);
    }

    /// Sets the mark of a picture that is held, from the next frame on; empty for none.
    pub fn set_held(&mut self, mark: &str) {
        self.overlay.set_held(mark);
    }

    /// Draws only the channels that this arrangement shows, from the next frame on.
    pub fn set_arrangement(&mut self, arrangement: Arrangement) {
        self.channels = match arrangement {
            Arrangement::Left => 0..1,
            Arrangement::Right => 1..2,
            _ => 0..CHANNELS as u32,
        };
    }

    /// The scene's text names the keys of a desk, see [`OverlayText::set_at_desk`].
    pub fn set_at_desk(&mut self, at_desk: bool) {
        self.overlay.set_at_desk(at_desk);
    }

    /// Sets what the page of an attempt that is over ends with: what a person can do next; empty for nothing.
    pub fn set_next_steps(&mut self, steps: &str) {
        self.overlay.set_next_steps(steps);
    }

    /// Sets lines of `protocol::scene_text` over the picture from the next frame on;
    /// `hides_scene_text`: in place of the scene's.
    pub fn set_overlay(&mut self, lines: &str, hides_scene_text: bool) {
        self.overlay.set_overlay(lines, hides_scene_text);
    }
}
