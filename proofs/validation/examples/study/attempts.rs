//! Many attempts at once, on every processor.

use anyhow::Result;
use scene::module::Module;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use surgeon::motion::MotionUse;
use surgeon::skill::Skill;
use training::score::Score;
use validation::pipeline::Pipeline;
use virtual_rig::cameras::Path;

/// One attempt at a level of a module.
pub struct Job {
    /// Place of the module in the list.
    pub module: usize,
    /// Level.
    pub level: u32,
    /// Who does it.
    pub surgeon: Skill,
    /// A recorded hand in the place of the tremor.
    pub hand: Option<MotionUse>,
    /// Everything random comes from it.
    pub seed: u64,
}

/// Does every job, in any order; the scores are in theirs.
///
/// # Errors
/// If a level cannot be composed.
pub fn scores(modules: &[Module], jobs: &[Job], threads: usize) -> Result<Vec<Score>> {
    let next = AtomicUsize::new(0);
    let done: Vec<Mutex<Option<Result<Score>>>> = jobs.iter().map(|_| Mutex::new(None)).collect();
    let progress = indicatif::ProgressBar::new(jobs.len() as u64);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let i = next.fetch_add(1, Ordering::Relaxed);
                    let Some(job) = jobs.get(i) else { break };
                    if let Ok(mut place) = done[i].lock() {
                        *place = Some(attempt(&modules[job.module], job));
                    }
                    progress.inc(1);
                }
            });
        }
    });
    progress.finish_and_clear();
    done.into_iter()
        .map(|d| d.into_inner().ok().flatten().unwrap_or_else(|| anyhow::bail!("an attempt was not made")))
        .collect()
}

fn attempt(module: &Module, job: &Job) -> Result<Score> {
    let scene = surgeon::compose(module, job.level, &job.surgeon, job.seed)?;
    Ok(Pipeline::new(&scene, Path::Direct, job.hand.clone(), job.seed).attempt(&mut |_, _, _| {}))
}

/// Prints an attempt event by event, with the bodies of the scene where jaws or goals are
/// concerned: to tune a module by.
///
/// # Errors
/// If the level cannot be composed.
pub fn print_events(module: &Module, level: u32, surgeon: &Skill, seed: u64) -> Result<()> {
    let scene = surgeon::compose(module, level, surgeon, seed)?;
    let mut begin = None;
    let score = Pipeline::new(&scene, Path::Direct, None, seed).attempt(&mut |frame, world, _| {
        let exposed = frame.instants.exposed;
        let at_s = (exposed - *begin.get_or_insert(exposed)) as f64 * 1e-9;
        for body in world.state().bodies.iter().flat_map(|b| &b.body).filter(|_| frame.field % 10 == 0) {
            let (at, tip) =
                (body.eye_from_body.translation.vector, world.state().instruments[0].tip_in_eye_mm);
            let jaw = world.state().instruments[0].jaw_rad;
            let [a, b] = [at, tip].map(|p| format!("({:.2}, {:.2}, {:.2})", p.x, p.y, p.z));
            println!("{at_s:7.2} s  body {a} tip {b} jaws {jaw:.2}");
        }
        for event in world.events() {
            let (text, unit) = event.info().map_or(("", ""), |e| (e.text, e.unit));
            let ([x, y, z], hand, about) = (event.position_in_eye_mm, event.instrument as i32, event.subject);
            println!(
                "{at_s:7.2} s  {hand:2} {about:4}  {text}: {:.3} {unit} at ({x:.2}, {y:.2}, {z:.2})",
                event.value
            );
        }
    });
    println!("{:.2} points, finished: {}", score.total, score.finished);
    Ok(())
}
