//! Plays a scene's script without cameras and prints every event, to tune a scene by:
//! `cargo run --release -p simcore --example rehearse [SCENE] [ROUNDS]`.

use protocol::events::EventKind;
use protocol::scene_file::{DEFAULT_SCENE, SceneFile};
use simcore::rehearsal::Rehearsal;
use simcore::world::{World, no_clock};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let scene = SceneFile::load(&args.next().unwrap_or(DEFAULT_SCENE.into()))?;
    let rounds: u64 = args.next().and_then(|a| a.parse().ok()).unwrap_or(1);
    let rehearsal = Rehearsal::shipped(&scene);
    let mut world = World::new(&scene)?;
    for field in 0..rehearsal.fields() * rounds {
        rehearsal.play(&mut world, field, &mut no_clock);
        if field % 100 == 0 {
            let st = world.state();
            let m = &st.membrane;
            let bonds = st.adhesion.as_ref();
            let ad = world.adhesion();
            let free: Vec<usize> = (0..m.nodes())
                .filter(|&n| {
                    m.flag[n] != protocol::scene::NODE_DEAD
                        && ad.zip(bonds).is_none_or(|(a, b)| !a.holds(b, n))
                })
                .collect();
            let mut lo = [1e9f32; 3];
            let mut hi = [-1e9f32; 3];
            let mut mean = [0.0f32; 3];
            for &n in &free {
                let p = m.position(n);
                for k in 0..3 {
                    lo[k] = lo[k].min(p[k]);
                    hi[k] = hi[k].max(p[k]);
                    mean[k] += p[k] / free.len() as f32;
                }
            }
            let tip = st.instruments[0].tip_in_eye_mm;
            println!(
                "{:7.2} tip {:.2?} free {} mean {:.2?} lo {:.2?} hi {:.2?}",
                field as f64 * 0.02,
                tip,
                free.len(),
                mean,
                lo,
                hi
            );
        }
        for event in world.events() {
            let (text, unit) = EventKind::from_wire(event.kind).map_or(("", ""), EventKind::text);
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
