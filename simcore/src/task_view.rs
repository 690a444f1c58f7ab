//! The picture of a task: balls where goals are, and its lines of text. Text is made when something
//! changes, and at most once a second.

use crate::world::World;
use nalgebra::Vector3;
use protocol::scene::SceneBody;
use protocol::scene_text::{Place, Row, capitalised, push_line, push_sentence};
use scene::{Goal, MAX_GOALS, TaskScene};
use training::score::Score;
use training::score::table::{Category, Id, PENALTIES};
use training::task::{Phase, Task, TaskState};

/// Balls that a task may show: goals, and beads along a path.
pub const MAX_BALLS: usize = 2 * MAX_GOALS + MAX_BEADS;
/// Bytes of text that a task may show.
pub const MAX_TEXT: usize = 1024;
/// Beads along a path.
const MAX_BEADS: usize = 40;
/// Radius of a bead, as a share of the tube's; the tube itself would hide the tip.
const BEAD_SHARE: f64 = 0.25;
/// Time that the instructions stay in the picture, s.
const INSTRUCTIONS_S: f64 = 6.0;
/// Opacity of a ball that a tip must come into.
const CLEAR: f32 = 0.45;
/// The rim of a mark on the retina: pale, so that the mark's own colour stands out whatever lies about it.
const RIM: [f32; 3] = [0.9, 0.9, 0.85];
/// Of a mark and of its rim, spheres that lie in the retina: radius, and depth of the centre, as shares of
/// the goal's radius. The rim is seen from 0.34 to 0.49 of it.
const MARK: [f64; 2] = [0.5, 0.3];
const MARK_RIM: [f64; 2] = [1.0, 0.87];
/// Removed vitreous after which its line of text is updated, µm³ (0.01 ml).
const GEL_STEP_UM3: u64 = 10_000_000_000;
/// Linear RGB of goals: open, later, done.
const OPEN: [f32; 3] = [0.9, 0.6, 0.05];
const LATER: [f32; 3] = [0.25, 0.3, 0.35];
const DONE: [f32; 3] = [0.05, 0.5, 0.12];

/// Hands out the balls of the world's task, [`MAX_BALLS`] at most.
pub fn balls(world: &World, mut take: impl FnMut(SceneBody)) {
    let Some((task, state)) = world.task() else { return };
    let radius_mm = world.scene().eye.retina_radius_mm;
    let mut room = MAX_BALLS;
    for (i, goal) in task.scene().goals.iter().enumerate() {
        let rgb = if state.goals[i].reached {
            DONE
        } else if task.is_open(state, i) {
            OPEN
        } else {
            LATER
        };
        let mut ball = |at: Vector3<f64>, radius: f64, rgb: [f32; 3], clear: f32| {
            if room > 0 {
                room -= 1;
                take(sphere(at, radius, rgb, clear));
            }
        };
        match goal {
            Goal::Hold { at_in_eye_mm, radius_mm, .. } => {
                ball(Vector3::from(*at_in_eye_mm), *radius_mm, rgb, CLEAR)
            }
            Goal::Near { towards_in_eye, .. } => {
                let out = Vector3::from(*towards_in_eye).try_normalize(1e-6).unwrap_or(-Vector3::z());
                ball(out * (radius_mm + 0.05), 0.25, rgb, 1.0);
            }
            Goal::Align { at_in_eye_mm, radius_mm, .. } => {
                at_in_eye_mm.iter().for_each(|p| ball(Vector3::from(*p), *radius_mm, rgb, CLEAR));
            }
            Goal::Place { body, at_in_eye_mm, radius_mm: near, .. } if task.is_open(state, i) => {
                // A mark under the place, of the body's colour, so that the body itself stays in sight.
                let bodies = world.scene().bodies.as_ref();
                let own = bodies.and_then(|b| b.body.get(*body as usize)).map(|b| b.rgba);
                let own = own.map_or(rgb, |[r, g, b, _]| [r, g, b]);
                let at = Vector3::from(*at_in_eye_mm);
                for ([radius, depth], rgb) in [(MARK, own), (MARK_RIM, RIM)] {
                    let low = at.try_normalize(1e-6).map_or(at, |out| out * (radius_mm + depth * near));
                    ball(low, radius * near, rgb, 1.0);
                }
            }
            Goal::Follow { path_in_eye_mm, radius_mm, .. } => {
                let done_mm = state.goals[i].along_mm();
                beads(path_in_eye_mm, &mut |at, along| {
                    let passed = state.goals[i].reached || along < done_mm;
                    ball(at, radius_mm * BEAD_SHARE, if passed { DONE } else { rgb }, 0.8);
                });
            }
            Goal::Place { .. } | Goal::Grip { .. } => {}
            Goal::Event { .. } | Goal::Gel { .. } | Goal::Retina { .. } => {}
        }
    }
}

/// Beads evenly along a path, with their way along it, mm.
fn beads(path: &[[f64; 3]], bead: &mut dyn FnMut(Vector3<f64>, f64)) {
    let length: f64 = path.windows(2).map(|w| (Vector3::from(w[1]) - Vector3::from(w[0])).norm()).sum();
    let gap = length / (MAX_BEADS as f64 - 1.0);
    let (mut begin, mut next) = (0.0, 0.0);
    for ends in path.windows(2) {
        let (a, b) = (Vector3::from(ends[0]), Vector3::from(ends[1]));
        let part = (b - a).norm();
        while part > 0.0 && next <= begin + part + 1e-9 {
            bead(a + (b - a) * ((next - begin) / part), next);
            next += gap;
        }
        begin += part;
    }
}

fn sphere(at: Vector3<f64>, radius_mm: f64, rgb: [f32; 3], opacity: f32) -> SceneBody {
    SceneBody {
        position_mm: at.map(|c| c as f32).into(),
        shape: 0,
        rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
        half_extents_mm: [radius_mm as f32; 3],
        reserved: 0,
        rgba: [rgb[0], rgb[1], rgb[2], opacity],
    }
}

/// The lines of a task, kept until they change.
#[derive(Debug, Default)]
pub struct TaskText {
    text: String,
    /// Phase, goals reached, second, warning and 0.01 ml of vitreous removed for which it was made.
    made_for: Option<(Option<Phase>, usize, u64, u32, u64)>,
}

impl TaskText {
    /// The lines for the world as it is, the newest warning first; `notice` is that warning. Once
    /// vitreous was removed, one says what is left.
    pub fn lines(&mut self, world: &World, notice: &str, notice_kind: u32) -> &str {
        let removed = world.removed();
        let (gone, task) = (removed.vitreous_um3 / GEL_STEP_UM3, world.task());
        let key = task.map_or((None, 0, 0, notice_kind, gone), |(_, state)| {
            (Some(state.phase), state.reached(), state.elapsed_s() as u64, notice_kind, gone)
        });
        if self.made_for != Some(key) {
            self.made_for = Some(key);
            self.text.clear();
            if !notice.is_empty() {
                push_sentence(&mut self.text, Place::Top, notice);
            }
            if let Some((task, state)) = task {
                match state.phase {
                    Phase::Waiting => push_start(task.scene(), &mut self.text),
                    Phase::Running => running(world, task, state, &mut self.text),
                    Phase::Finished | Phase::TimedOut => end_screen(world, &mut self.text),
                }
            }
            if gone > 0 {
                let left_ml = removed.vitreous_left_um3 as f64 * 1e-12;
                push_line(&mut self.text, Place::TopRight, &format!("Vitreous {left_ml:.2} ml"));
            }
            self.text.truncate(self.text.floor_char_boundary(MAX_TEXT));
        }
        &self.text
    }
}

fn running(world: &World, task: &Task, state: &TaskState, out: &mut String) {
    if let Some(injury) = world.score().and_then(|score| score.failed) {
        push_line(out, Place::Top, &format!("Failed by {injury}"));
    }
    let scene = task.scene();
    let next = scene.goals.iter().enumerate().find(|(i, _)| task.is_open(state, *i)).map(|(_, g)| g);
    push_task(scene, state.elapsed_s(), state.reached(), next, out);
}

/// The page before an attempt: what is practised, what is to be done, by which tool and key, and
/// when the clock starts. Marks stand for keys, see `protocol::bindings`.
pub fn push_start(scene: &TaskScene, out: &mut String) {
    Row::Title(&heading(scene)).push(out);
    scene.instructions.iter().for_each(|line| Row::Plain(line).push(out));
    let (count, limit_s) = (scene.goals.len(), scene.limit_s as u64);
    let goals = if count == 1 { "1 goal".into() } else { format!("{count} goals") };
    Row::Plain(&format!("{goals}, {}:{:02} minutes", limit_s / 60, limit_s % 60)).push(out);
    if let Some(first) = scene.goals.first() {
        Row::Plain(&format!("First: {}", asked(first))).push(out);
    }
    Row::Plain("The clock starts when you move and stops during help {help}").push(out);
}

/// Lines of a task `elapsed_s` after its beginning, with so many of its goals reached: level, time
/// that is left, what is to be done next, and at the beginning the instructions.
pub fn push_task(scene: &TaskScene, elapsed_s: f64, reached: usize, next: Option<&Goal>, out: &mut String) {
    let left_s = (scene.limit_s - elapsed_s).max(0.0) as u64;
    push_line(out, Place::TopLeft, &format!("Level {}", scene.level));
    push_line(out, Place::TopLeft, &format!("{reached} of {}", scene.goals.len()));
    push_line(out, Place::TopRight, &format!("{}:{:02}", left_s / 60, left_s % 60));
    if elapsed_s < INSTRUCTIONS_S {
        push_line(out, Place::Bottom, &scene.title);
        scene.instructions.iter().for_each(|line| push_line(out, Place::Bottom, line));
    }
    if let Some(goal) = next {
        push_line(out, Place::Bottom, &format!("Next: {}", asked(goal)));
    }
}

/// What a goal asks for: the deed, the tool or hand, and marks for the keys.
fn asked(goal: &Goal) -> String {
    match goal {
        Goal::Hold { .. } => "keep the tip in a yellow ball {move}".into(),
        Goal::Near { .. } => "bring the tip down over a mark {move}, without touching".into(),
        Goal::Follow { .. } => "lead the tip along the beads {move}".into(),
        Goal::Align { .. } => "each tip into its ball {move}; the other hand {hand}".into(),
        Goal::Grip { instrument, .. } => {
            format!("pick it up with the forceps of the {} hand {{use}}", hand(*instrument))
        }
        Goal::Place { .. } => "place it on the mark and open the jaws {use}".into(),
        Goal::Event { what, .. } | Goal::Gel { what, .. } | Goal::Retina { what, .. } => what.clone(),
    }
}

fn hand(instrument: u32) -> &'static str {
    if instrument == 0 { "first" } else { "second" }
}

fn end_screen(world: &World, out: &mut String) {
    if let (Some((task, _)), Some(score)) = (world.task(), world.score()) {
        push_result(task.scene(), &score, out);
    }
}

/// The page of an attempt that is over: what was practised, how it ended, the points of all and of
/// each category, and what was hurt. Tissue treatment shows what it had before the injuries took
/// their points, which have a line of their own.
pub fn push_result(scene: &TaskScene, score: &Score, out: &mut String) {
    Row::Title(&heading(scene)).push(out);
    let end = match (score.failed, score.finished) {
        (Some(injury), _) => format!("Failed by {injury}"),
        (None, true) => "Finished".into(),
        (None, false) => "Time is up".into(),
    };
    Row::Plain(&format!("{end}: {:.0} of 100 points (± {:.1})", score.total, score.sigma)).push(out);
    let lost = score.metrics[Id::Injuries as usize].value.unwrap_or(0.0);
    for category in Category::ALL {
        let taken = if category == Category::Tissue { lost } else { 0.0 };
        let (points, most) = (score.categories[category as usize] + taken, category.points());
        let name: String = capitalised(category.name()).collect();
        let share = (points / most.max(1e-9)) as f32;
        Row::Bar { name: &name, share, value: &format!("{points:.0} of {most:.0}") }.push(out);
    }
    let injuries: Vec<String> = PENALTIES
        .iter()
        .zip(score.injuries)
        .filter(|(_, count)| *count > 0)
        .map(|(penalty, count)| format!("{count} × {}", penalty.name))
        .collect();
    if !injuries.is_empty() {
        Row::Plain(&format!("Injuries took {lost:.0} points: {}", injuries.join(", "))).push(out);
    }
}

/// Module and level, for a page. What stands before the title's colon names the module, what comes
/// after it its steps.
fn heading(scene: &TaskScene) -> String {
    let name = scene.title.split(':').next().unwrap_or_default();
    let name = if name.is_empty() { &scene.module } else { name };
    format!("{name}, level {}", scene.level)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beads_lie_on_the_path_from_its_first_point_to_its_last() {
        let path = [[0.0; 3], [3.0, 0.0, 0.0], [3.0, 1.0, 0.0]];
        let mut seen = Vec::new();
        beads(&path, &mut |at, along| seen.push((at, along)));
        assert!((MAX_BEADS - 1..=MAX_BEADS).contains(&seen.len()));
        assert_eq!(seen[0].0, Vector3::zeros());
        let last = seen[seen.len() - 1];
        assert!((last.1 - 4.0).abs() < 4.0 / 38.0 && last.0.x == 3.0);
    }

    #[test]
    fn what_is_left_of_the_vitreous_stands_in_the_picture_once_some_is_gone() {
        let scene = scene::SceneFile::load("vitrectomy").unwrap();
        let rehearsal = surgeon::rehearsal::Rehearsal::shipped(&scene);
        let (mut world, mut text) = (World::new(&scene).unwrap(), TaskText::default());
        assert_eq!(text.lines(&world, "", 0), "");
        for field in 0..300 {
            world.step(&rehearsal.inputs(field).input(), &mut crate::world::no_clock);
        }
        let left_ml = world.removed().vitreous_left_um3 as f64 * 1e-12;
        let shown = text.lines(&world, "warned", 7).to_owned();
        let lines: Vec<_> = protocol::scene_text::lines(&shown).collect();
        let left = format!("Vitreous {left_ml:.2} ml");
        assert_eq!(lines, [(Place::Top, "Warned"), (Place::TopRight, left.as_str())]);
    }
}
