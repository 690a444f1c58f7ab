//! The pull at the forceps over a round of a scene's script, without cameras and tremor, and its mean and RMS while peeling:
//! `cargo run --release -p simcore --example peel_force [SCENE]`. Columns: s, mN, mm² peeled, mm of retina lifted.

use protocol::scene_file::SceneFile;
use simcore::rehearsal::Rehearsal;
use simcore::world::{World, no_clock};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scene = SceneFile::load(&std::env::args().nth(1).unwrap_or("erm".into()))?;
    let rehearsal = Rehearsal::shipped(&scene);
    let mut world = World::new(&scene)?;
    let mut pulls = Vec::new();
    for field in 0..rehearsal.fields() {
        let before = world.state().adhesion.as_ref().map_or(0.0, |a| a.freed_mm2);
        rehearsal.play(&mut world, field, &mut no_clock);
        let Some(bonds) = &world.state().adhesion else { return Err("this scene has no glue".into()) };
        let pull_mn = world.pull_un(0) * 1e-3;
        if bonds.freed_mm2 > before {
            pulls.push(pull_mn);
        }
        if field % 10 == 0 {
            let lifted = bonds.lifted_mm.iter().fold(0.0, |a: f32, &b| a.max(b));
            println!("{:6.2} {pull_mn:8.3} {:8.3} {lifted:6.3}", field as f64 * 0.02, bonds.freed_mm2);
        }
    }
    let mean = pulls.iter().sum::<f64>() / pulls.len() as f64;
    let rms = (pulls.iter().map(|p| p * p).sum::<f64>() / pulls.len() as f64).sqrt();
    let most = pulls.iter().fold(0.0, |a: f64, &b| a.max(b));
    println!("while peeling ({} fields): mean {mean:.2} mN, RMS {rms:.2} mN, most {most:.2} mN", pulls.len());
    Ok(())
}
