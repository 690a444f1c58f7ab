//! Draws one still without any other process:
//! `cargo run --release -p renderer --example still -- OUT.png [TIER [peel|bleb|vitreous|bodies
//! [none|flat|wide-angle [FIELD_MM [FOCUS_MM]]]]]`; the inverter goes with the wide-angle lens.

use anyhow::Result;
use protocol::optics::Lens;
use renderer::gpu::Gpu;
use renderer::latch::latch_scene;
use renderer::offscreen::Offscreen;
use renderer::output::save_png;
use renderer::readback::Picture;
use renderer::reference_scene::subject;
use renderer::start::{map_px, renderer_config};
use renderer::stereo::Arrangement;
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};

fn main() -> Result<()> {
    ipc::logging::init("still", &ipc::logging::LogArgs::default());
    let mut args = std::env::args().skip(1);
    let out = args.next().unwrap_or_else(|| "still.png".into());
    let tier: usize = args.next().map_or(Ok(2), |t| t.parse())?;
    let name = args.next().unwrap_or_else(|| "peel".into());
    let lens = match args.next().as_deref() {
        None | Some("none") => Lens::None,
        Some("flat") => Lens::Flat,
        Some("wide-angle") => Lens::WideAngle,
        Some(other) => anyhow::bail!("lens {other}: expected none, flat or wide-angle"),
    };
    let field_mm: Option<f64> = args.next().map(|f| f.parse()).transpose()?;
    let focus_mm: f64 = args.next().map_or(Ok(0.0), |f| f.parse())?;
    let (file, rig) = (SceneFile::load(DEFAULT_SCENE)?, Rig::load_or_shipped(None)?);
    let gpu = Gpu::headless()?;
    let config = renderer_config(&file, &rig, 0, map_px(&gpu));
    let mut offscreen = Offscreen::new(gpu, config)?;
    let mut latched = None;
    for mut scene in subject(&file, &rig, &name) {
        let microscope = &mut scene.header.microscope;
        (microscope.lens, microscope.inverter) = (lens as u32, u32::from(lens == Lens::WideAngle));
        microscope.field_mm = field_mm.unwrap_or(microscope.field_mm);
        microscope.focus_mm = focus_mm;
        offscreen.renderer.take_scene(&offscreen.gpu, &scene.header, scene.payload())?;
        latched = Some(latch_scene(&scene.header));
    }
    let latched = latched.expect("a scene");
    let mut picture = Picture::default();
    offscreen.draw(tier, &latched);
    offscreen.compose(tier, Arrangement::SideBySide, &mut picture)?;
    save_png(out.as_ref(), &picture)?;
    Ok(())
}
