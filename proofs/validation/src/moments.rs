//! Moments of the shipped scenes and training modules as pictures: the script is played without
//! cameras, and the renderer draws what the simulation sends. For reference pictures and those of
//! the documentation.

use protocol::bindings::next_steps;
use renderer::frame::Renderer;
use renderer::gpu::Gpu;
use renderer::latch::latch_scene;
use renderer::offscreen::Offscreen;
use renderer::readback::Picture;
use renderer::reference_scene::SceneBlock;
use renderer::start::renderer_config;
use renderer::stereo::{Arrangement, arrange};
use replay::film::scripted::{FIELDS_PER_S, ScriptedFilm};
use rig::Rig;
use scene::SceneFile;
use surgeon::skill::EXPERT;

/// A scene that is played by its script.
pub struct ScenePlayer {
    /// Its file.
    pub scene: SceneFile,
    film: ScriptedFilm,
    /// The first scene: the renderer takes places in the fundus map from it.
    first: SceneBlock,
}

impl ScenePlayer {
    /// At the beginning of `scene`.
    ///
    /// # Panics
    /// If the simulation refuses it.
    pub fn begin(scene: SceneFile) -> Self {
        let mut film = ScriptedFilm::begin(&scene, None).expect("a scene that can be simulated");
        let first = block(&mut film);
        Self { scene, film, first }
    }

    /// Plays until `at_s` seconds after the beginning; returns what the simulation then sends.
    pub fn play_to(&mut self, at_s: f64) -> SceneBlock {
        self.film.play_to((at_s * FIELDS_PER_S).round() as u64);
        block(&mut self.film)
    }

    /// The picture of `block` at `tier` with a fundus map of `map_px`, drawn by a fresh renderer
    /// that took the first scene before.
    ///
    /// # Panics
    /// If the shipped meshes or the graphics driver fail.
    pub fn draw(&self, gpu: &Gpu, block: &SceneBlock, tier: usize, map_px: u32) -> Picture {
        self.draw_with(gpu, block, tier, map_px, |_| {})
    }

    /// As [`Self::draw`], with a renderer that `set_up` has prepared.
    ///
    /// # Panics
    /// If the shipped meshes or the graphics driver fail.
    pub fn draw_with(
        &self,
        gpu: &Gpu,
        block: &SceneBlock,
        tier: usize,
        map_px: u32,
        set_up: impl FnOnce(&mut Renderer),
    ) -> Picture {
        let mut picture = Picture::default();
        self.drawn(gpu, block, tier, map_px, set_up).read(tier, &mut picture).expect("the picture");
        picture
    }

    /// One eye of `block` with its text, as a person at a desk sees it; `overlay`: lines in place of that
    /// text, empty for none.
    ///
    /// # Panics
    /// If the shipped meshes or the graphics driver fail.
    pub fn draw_at_desk(
        &self,
        gpu: &Gpu,
        block: &SceneBlock,
        tier: usize,
        map_px: u32,
        overlay: &str,
    ) -> Picture {
        let mut offscreen = self.drawn(gpu, block, tier, map_px, |renderer| {
            renderer.set_at_desk(true);
            renderer.set_next_steps(&next_steps());
            renderer.set_overlay(overlay, !overlay.is_empty());
        });
        let (mut picture, one_eye) = (Picture::default(), Arrangement::Left);
        offscreen.compose(tier, one_eye, &mut picture).expect("the picture");
        arrange(&mut picture, one_eye);
        picture
    }

    /// A fresh renderer that has drawn `block`.
    fn drawn(
        &self,
        gpu: &Gpu,
        block: &SceneBlock,
        tier: usize,
        map_px: u32,
        set_up: impl FnOnce(&mut Renderer),
    ) -> Offscreen {
        let rig = Rig::load_or_shipped(None).expect("the shipped rig");
        let config = renderer_config(&self.scene, &rig, tier, map_px);
        let mut offscreen = Offscreen::new(gpu.clone(), config).expect("shipped meshes and photograph");
        set_up(&mut offscreen.renderer);
        for block in [&self.first, block] {
            let renderer = &mut offscreen.renderer;
            renderer.take_scene(gpu, &block.header, block.payload()).expect("a scene of the simulation");
        }
        offscreen.draw(tier, &latch_scene(&block.header));
        offscreen
    }
}

fn block(film: &mut ScriptedFilm) -> SceneBlock {
    let (header, payload) = film.scene();
    SceneBlock::new(header, payload)
}

/// A moment that is typical of a scene or a training module.
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
    pub fn begin(&self) -> ScenePlayer {
        let scene = if self.is_module {
            module(self.name)
        } else {
            SceneFile::load(self.name).map_err(|e| e.to_string())
        };
        ScenePlayer::begin(scene.unwrap_or_else(|e| panic!("{e}")))
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

/// Edge of the fundus map of reference pictures, px, on every device.
pub const REFERENCE_MAP_PX: u32 = 512;
