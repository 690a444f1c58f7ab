//! The pull at the forceps over a round of a scene's script, without cameras and tremor, and its
//! mean and RMS while peeling: `cargo run --release -p validation --example peel_force -- --help`.
//! Columns: s, mN, mm² peeled, mm of retina lifted.

use clap::Parser;
use scene::SceneFile;
use simcore::world::{World, no_clock};
use surgeon::rehearsal::Rehearsal;

/// Pull at the forceps over a round of a script.
#[derive(Parser)]
struct Args {
    /// Scene with adhesion.
    #[arg(default_value = "erm")]
    scene: String,
    /// Adhesion energy instead of the scene's, µN/mm; patches keep their ratio.
    #[arg(long)]
    energy: Option<f64>,
    /// Reach of the jaws instead of the scene's, mm.
    #[arg(long)]
    reach: Option<f64>,
    /// Mass of a node instead of the scene's, g.
    #[arg(long)]
    mass: Option<f64>,
    /// Time stretched by this factor: 2 is half the speed.
    #[arg(long, default_value_t = 1.0)]
    slower: f64,
    /// Figures of the whole round only.
    #[arg(long)]
    brief: bool,
}

fn scene(args: &Args) -> Result<SceneFile, Box<dyn std::error::Error>> {
    let mut scene = SceneFile::load(&args.scene)?;
    let membrane = scene.membrane.as_mut().ok_or("this scene has no membrane")?;
    membrane.node_mass_g = args.mass.unwrap_or(membrane.node_mass_g);
    let adhesion = membrane.adhesion.as_mut().ok_or("this scene has no adhesion")?;
    if let Some(energy) = args.energy {
        let factor = energy / adhesion.energy_un_per_mm;
        adhesion.patches.iter_mut().for_each(|p| p.energy_un_per_mm *= factor);
        (adhesion.energy_un_per_mm, adhesion.rim_energy_un_per_mm) =
            (energy, adhesion.rim_energy_un_per_mm * factor);
    }
    scene.contact.grab_reach_mm = args.reach.unwrap_or(scene.contact.grab_reach_mm);
    scene.script.as_mut().unwrap().period_s *= args.slower;
    scene.script.as_mut().unwrap().keys.iter_mut().for_each(|k| k.at_s *= args.slower);
    Ok(scene)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args = Args::parse();
    let scene = scene(&args)?;
    let rehearsal = Rehearsal::shipped(&scene);
    let mut world = World::new(&scene)?;
    let (mut pulls, mut freed) = (Vec::new(), 0.0);
    for field in 0..rehearsal.fields() {
        world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        let Some(bonds) = &world.state().membrane.adhesion else {
            return Err("this scene has no adhesion".into());
        };
        let pull_mn = world.pull_un(0) * 1e-3;
        if bonds.freed_mm2 > freed && pull_mn > 0.0 {
            pulls.push(pull_mn);
        }
        freed = bonds.freed_mm2;
        if field % 10 == 0 && !args.brief {
            let lifted = bonds.lifted_mm.iter().fold(0.0, |a: f32, &b| a.max(b));
            println!("{:6.2} {pull_mn:8.3} {freed:8.3} {lifted:6.3}", field as f64 * 0.02);
        }
    }
    let count = pulls.len() as f64;
    let mean = pulls.iter().sum::<f64>() / count;
    let rms = (pulls.iter().map(|p| p * p).sum::<f64>() / count).sqrt();
    let most = pulls.iter().fold(0.0, |a: f64, &b| a.max(b));
    let bonded = world.adhesion().map_or(0.0, |a| a.bonded_mm2());
    println!(
        "while peeling ({count} fields): mean {mean:.2} mN, RMS {rms:.2} mN, most {most:.2} mN; {freed:.1} of {bonded:.1} mm² off"
    );
    Ok(())
}
