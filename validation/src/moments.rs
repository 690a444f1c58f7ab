//! Moments of the shipped scenes and training modules: the script played without cameras, and the picture that the renderer draws of it. For reference
//! pictures and for those that the documentation shows.

use offline::film::{FIELDS_PER_S, Film};
use protocol::rig::Rig;
use protocol::scene::SceneHeader;
use renderer::frame::Renderer;
use renderer::governor::{Shading, TIERS};
use renderer::gpu::Gpu;
use renderer::latch::latch_scene;
use renderer::readback::{Picture, ReadBack};
use scene::SceneFile;
use surgeon::skill::EXPERT;

/// A scene block as the simulation sends it.
pub struct Block {
    /// Header.
    pub header: SceneHeader,
    /// Payload, in units of 16 bytes.
    pub payload: Vec<u128>,
}

/// A scene that is being played.
pub struct Surgery {
    /// Its file.
    pub scene: SceneFile,
    film: Film,
    /// What the renderer needs to have seen: how everything lay at first.
    first: Block,
}

impl Surgery {
    /// The beginning of `scene`.
    ///
    /// # Panics
    /// If the simulation refuses it.
    pub fn begin(scene: SceneFile) -> Self {
        let mut film = Film::begin(&scene, None).expect("a scene that can be simulated");
        let first = block(&mut film);
        Self { scene, film, first }
    }

    /// Plays on until `at_s` seconds after the beginning; gives what the simulation then sends.
    pub fn play_to(&mut self, at_s: f64) -> Block {
        self.film.play_to((at_s * FIELDS_PER_S).round() as u64);
        block(&mut self.film)
    }

    /// The picture of `block` at `tier`, drawn by a fresh renderer that saw the beginning, with a fundus map of `map_px`.
    ///
    /// # Panics
    /// If the shipped meshes or the graphics driver fail.
    pub fn draw(&self, gpu: &Gpu, block: &Block, tier: usize, map_px: u32) -> Picture {
        self.draw_with(gpu, block, tier, map_px, |_| {})
    }

    /// As [`Self::draw`], after `ask` has asked the renderer for something.
    ///
    /// # Panics
    /// If the shipped meshes or the graphics driver fail.
    pub fn draw_with(
        &self,
        gpu: &Gpu,
        block: &Block,
        tier: usize,
        map_px: u32,
        ask: impl FnOnce(&mut Renderer),
    ) -> Picture {
        let rig = Rig::load_or_shipped(None).expect("the shipped rig");
        let plan = renderer::start::plan(&self.scene, &rig, tier, map_px);
        let mut renderer = Renderer::new(gpu, plan).expect("shipped meshes and photograph");
        ask(&mut renderer);
        for block in [&self.first, block] {
            let payload = bytemuck::cast_slice(&block.payload);
            renderer.take_scene(gpu, &block.header, payload).expect("a block of the simulation");
        }
        let commands = renderer.encode(gpu, tier);
        renderer.submit(gpu, tier, &latch_scene(&block.header), commands);
        let mut picture = Picture::default();
        let read_back = ReadBack::new(gpu, tier).read(gpu, renderer.target(tier), &mut picture);
        read_back.expect("the picture");
        picture
    }
}

fn block(film: &mut Film) -> Block {
    let (header, payload) = film.scene();
    let mut units = vec![0u128; payload.len().div_ceil(16)];
    bytemuck::cast_slice_mut(&mut units)[..payload.len()].copy_from_slice(payload);
    Block { header, payload: units }
}

/// A moment that shows what a scene or a training module is about.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// Name of the shipped scene or module.
    pub name: &'static str,
    /// True for a module: its first level, done by the expert.
    pub is_module: bool,
    /// s after the beginning.
    pub at_s: f64,
}

impl Moment {
    /// Name of its files, without shading and ending.
    pub fn file(&self) -> String {
        let kind = if self.is_module { "module-" } else { "" };
        format!("{kind}{}", self.name)
    }

    /// Its beginning.
    ///
    /// # Panics
    /// If there is no such scene or module.
    pub fn begin(&self) -> Surgery {
        let scene = if self.is_module {
            module(self.name)
        } else {
            SceneFile::load(self.name).map_err(|e| e.to_string())
        };
        Surgery::begin(scene.unwrap_or_else(|e| panic!("{e}")))
    }
}

/// The first level of a module with the script of its expert.
fn module(name: &str) -> Result<SceneFile, String> {
    let module = surgeon::load(name).map_err(|e| e.to_string())?;
    surgeon::compose(&module, 1, &EXPERT, 1).map_err(|e| e.to_string())
}

const fn scene(name: &'static str, at_s: f64) -> Moment {
    Moment { name, is_module: false, at_s }
}

const fn training(name: &'static str, at_s: f64) -> Moment {
    Moment { name, is_module: true, at_s }
}

/// A moment of every shipped scene and module.
pub const MOMENTS: [Moment; 16] = [
    scene("peel", 6.0),
    scene("erm", 6.0),
    scene("lift", 4.5),
    scene("trim", 5.0),
    scene("vitrectomy", 3.0),
    scene("relocation", 7.0),
    scene("translocation", 9.0),
    scene("bodies", 4.0),
    training("navigation", 4.0),
    training("shadow", 4.0),
    training("bimanual", 4.0),
    training("forceps", 4.0),
    training("steady-path", 4.0),
    training("peeling", 9.0),
    training("relocation", 8.0),
    training("vitrectomy", 6.0),
];

/// Width of a reference picture, both channels, px.
pub const REFERENCE_PX: u32 = 320;
/// Edge of the fundus map of reference pictures, whatever the device.
pub const REFERENCE_MAP_PX: u32 = 512;

/// The smallest tier of each shading that is no smaller than a reference picture, with the shading's name.
///
/// # Panics
/// If a shading has no tier.
pub fn reference_tiers() -> [(&'static str, usize); 2] {
    Shading::ALL.map(|shading| {
        let tier = TIERS.iter().rposition(|t| t.shading == shading && t.width_px >= REFERENCE_PX);
        (shading.name(), tier.expect("a tier of each shading"))
    })
}
