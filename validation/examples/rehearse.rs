//! Plays a scene's script without cameras and prints every event, to tune a scene by:
//! `cargo run --release -p simcore --example rehearse [SCENE] [ROUNDS]`.

use scene::{DEFAULT_SCENE, SceneFile};
use simcore::world::{World, no_clock};
use surgeon::rehearsal::Rehearsal;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let scene = SceneFile::load(&args.next().unwrap_or(DEFAULT_SCENE.into()))?;
    let rounds: u64 = args.next().and_then(|a| a.parse().ok()).unwrap_or(1);
    let rehearsal = Rehearsal::shipped(&scene);
    let mut world = World::new(&scene)?;
    for field in 0..rehearsal.fields() * rounds {
        world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        for event in world.events() {
            let (text, unit) = event.info().map_or(("", ""), |e| (e.text, e.unit));
            let at = event.position_in_eye_mm;
            println!(
                "{:7.2} s  instrument {}  {text}: {:.3} {unit} at ({:.2}, {:.2}, {:.2})",
                field as f64 * 0.02,
                event.instrument as i32,
                event.value,
                at[0],
                at[1],
                at[2]
            );
        }
    }
    let alive = world.state().membrane.triangle_alive.iter().filter(|a| **a != 0).count();
    println!("{alive} triangles left, state {:016x}", world.state_hash());
    Ok(())
}
