//! The choice between processor and adapter changes no result.

use collision::backend::Backend;
use scene::SceneFile;
use simcore::world::{World, no_clock};

/// The clock decides what is measured, never what is found: a clock by which the processor takes
/// for ever, one by which it takes no time, and all wishes, lead to the same look.
#[test]
fn the_choice_changes_no_result() {
    let scene = SceneFile::load("peel").unwrap();
    // The clock goes by `step` a call, and from the thirtieth on by `later`: by then the
    // processor's looks are measured.
    let look_by = |backend, step: u64, later: u64| {
        let mut world = World::new(&scene).unwrap();
        let (mut now, mut calls) = (0, 0);
        let choice = world.choose_collision(backend, &mut || {
            calls += 1;
            now += if calls < 30 { step } else { later };
            now
        });
        let rehearsal = surgeon::rehearsal::Rehearsal::shipped(&scene);
        for field in 0..60 {
            world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        }
        (choice.unwrap(), world.state_hash())
    };
    let look = |backend, step| look_by(backend, step, step);
    let (cpu, expected) = look(Backend::Cpu, 0);
    assert!(!cpu.on_gpu && cpu.gpu_us.is_none());
    let (quick, hash) = look(Backend::Auto, 1_000);
    assert!(!quick.on_gpu && quick.cpu_us == Some(1.0) && quick.gpu_us.is_none(), "{quick}");
    assert_eq!(hash, expected);
    let (slow, hash) = look(Backend::Auto, 100_000);
    // Equally slow: the processor stays.
    assert!(!slow.on_gpu && slow.cpu_us == Some(100.0), "{slow}");
    assert_eq!(hash, expected);
    let (won, hash) = look_by(Backend::Auto, 100_000, 1_000);
    assert_eq!(won.on_gpu, won.gpu_us.is_some(), "an adapter that is there has won: {won}");
    assert_eq!(hash, expected);
    let (gpu, hash) = look(Backend::Gpu, 100_000);
    assert_eq!(gpu.on_gpu, gpu.gpu_us.is_some(), "{gpu}");
    assert_eq!(hash, expected);
}
