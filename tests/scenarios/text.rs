//! The text of every shipped scene, module and level, with all that can stand beside it, at every
//! tier and in windows of many sizes: nothing overlaps, leaves the picture or is cut, and the middle
//! of the field stays free while one works.

use bytemuck::Zeroable;
use font::Face;
use protocol::bindings::{help, next_steps};
use protocol::events::{EventKind, Severity};
use protocol::scene::SceneHeader;
use protocol::scene_text::{Place, Row, lines, push_line, push_sentence};
use renderer::compose::{SMALL_PX, output_px};
use renderer::frame::overlay::OverlayText;
use renderer::governor::TIERS;
use renderer::latch::{Latched, latch_scene};
use renderer::text::layout::lay_out;
use scene::module::{Module, names};
use scene::{Goal, TaskScene};
use simcore::task_view::{MAX_TEXT, push_result, push_start, push_task};
use simcore::world::World;
use training::score::Score;
use training::score::table::{Category, INJURIES, Id, PENALTIES};

/// Sizes of a channel at which nothing may be cut: those of pictures in files, and of windows.
fn whole_sizes() -> Vec<[u32; 2]> {
    let windows = [SMALL_PX, [367, 293], [533, 427], [720, 576], [960, 768], [1500, 1200], [2048, 1638]];
    TIERS.iter().map(output_px).chain(windows).collect()
}

/// Smaller ones, of windows that are made tiny, at which text may be cut and nothing else.
const TINY: [[u32; 2]; 5] = [[240, 192], [160, 128], [100, 80], [40, 32], [5, 4]];

/// Every task that is shipped, by module and level.
fn tasks() -> Vec<TaskScene> {
    let mut all = Vec::new();
    for name in names() {
        let module = Module::load(name).unwrap_or_else(|e| panic!("{e}"));
        let level = |level| module.level_scene(level).unwrap_or_else(|e| panic!("{e}")).task;
        all.extend((1..=module.levels()).filter_map(level));
    }
    assert!(all.len() >= 16, "levels of eight modules: {}", all.len());
    all
}

/// All text of a moment: `scene` is the simulation's, `crowd` has everything else with it that can
/// stand there at once.
fn moment(scene: &str, crowd: bool) -> String {
    let mut overlay = OverlayText::new();
    let mut latched = latch_scene(&SceneHeader::zeroed());
    (latched.tracked, latched.eye_tracked) = ([true; 2], true);
    // With the keys of a desk the text is longest.
    overlay.set_at_desk(true);
    overlay.set_scene(scene.as_bytes());
    if crowd {
        latched = Latched { tracked: [false, true], eye_tracked: false, ..latched };
        overlay.set_status("tier 8: 160×128\n1 frame in 20 over 128 ms, 15 allowed");
        overlay.set_held("Picture held for 12.3 s");
        overlay.set_next_steps(&next_steps());
        let mut beside = String::new();
        push_line(&mut beside, Place::BottomLeft, "Space does nothing with the light pipe. T: next tool");
        push_sentence(&mut beside, Place::BottomRight, "the picture runs at 12 Hz instead of 42 Hz");
        push_line(&mut beside, Place::Top, "Paused");
        overlay.set_overlay(&beside, false);
    }
    overlay.collect(&latched);
    overlay.lines().to_owned()
}

/// Asserts that `text` keeps its place at every size, whole where there is room for it.
fn check(face: &mut Face, text: &str) {
    for (size_px, may_cut) in whole_sizes().into_iter().map(|s| (s, false)).chain(TINY.map(|s| (s, true))) {
        let layout = lay_out(face, text, size_px);
        layout.check(size_px).unwrap_or_else(|problem| panic!("{size_px:?}: {problem}\n{text}"));
        assert!(may_cut || !layout.cut, "{size_px:?}: cut at letters of {} px:\n{text}", layout.size_px);
    }
}

/// Every notice of the simulation.
fn warnings() -> Vec<&'static str> {
    let all = (0..1_000).filter_map(EventKind::from_wire).map(EventKind::info);
    let warnings: Vec<_> = all.filter(|i| i.severity >= Severity::Warning).map(|i| i.text).collect();
    assert!(warnings.len() > 10);
    warnings
}

#[test]
fn the_text_of_every_level_keeps_its_place_with_all_that_can_stand_beside_it() {
    let mut face = Face::new();
    let longest = warnings().into_iter().max_by_key(|text| text.len()).expect("warnings");
    for task in tasks() {
        let mut seen = Vec::new();
        let goals: Vec<Option<&Goal>> = task.goals.iter().map(Some).chain([None]).collect();
        for (elapsed_s, next) in goals.iter().flat_map(|goal| [0.0, 60.0].map(|s| (s, *goal))) {
            let mut scene = String::new();
            push_sentence(&mut scene, Place::Top, longest);
            push_task(&task, elapsed_s, task.goals.len(), next, &mut scene);
            push_line(&mut scene, Place::TopRight, "Vitreous 3.21 ml");
            if seen.contains(&scene) {
                continue;
            }
            let letters = || scene.chars().filter(|c| *c != '\n');
            assert!(letters().all(font::has), "{}: the font lacks a letter of {scene}", task.module);
            [false, true].into_iter().for_each(|crowd| check(&mut face, &moment(&scene, crowd)));
            seen.push(scene);
        }
    }
}

#[test]
fn the_page_before_every_level_names_tool_and_keys_and_keeps_its_place() {
    let mut face = Face::new();
    let mut pages = 0;
    for task in tasks() {
        let mut page = String::new();
        push_start(&task, &mut page);
        assert!(page.len() < MAX_TEXT, "{}: {} bytes", task.module, page.len());
        let shown = moment(&page, false);
        assert!(!shown.contains(['{', '}']), "a mark that is no key: {shown}");
        let keys = ["mouse", "Space", "(T)", "(V)"];
        assert!(keys.iter().any(|key| shown.contains(key)) && shown.contains("F1"), "{shown}");
        [false, true].into_iter().for_each(|crowd| check(&mut face, &moment(&page, crowd)));
        pages += 1;
    }
    assert!(pages >= 16, "{pages}");
}

#[test]
fn every_warning_keeps_its_place() {
    let mut face = Face::new();
    for warning in warnings() {
        let mut scene = String::new();
        push_sentence(&mut scene, Place::Top, warning);
        check(&mut face, &moment(&scene, true));
    }
}

#[test]
fn the_page_of_every_result_and_the_help_keep_their_place() {
    let mut face = Face::new();
    let module = Module::load("navigation").and_then(|m| m.level_scene(1)).unwrap_or_else(|e| panic!("{e}"));
    let begun = World::new(&module).expect("a world").score().expect("a score");
    for task in tasks() {
        for finished in [true, false] {
            let categories = Category::ALL.map(|c| if finished { c.points() } else { -c.points() });
            let mut page = String::new();
            let hurt = if finished { 0 } else { 12 };
            let (injuries, failed) = ([hurt; INJURIES], (hurt > 0).then_some("macular haemorrhage"));
            let score =
                Score { total: 100.0, sigma: 10.4, categories, injuries, failed, finished, ..begun.clone() };
            push_result(&task, &score, &mut page);
            let rows: Vec<Row<'_>> = lines(&page).map(|(_, line)| Row::of(line)).collect();
            let bars = rows.iter().filter(|row| matches!(row, Row::Bar { .. })).count();
            assert!(bars == Category::ALL.len() && matches!(rows[0], Row::Title(_)), "{page}");
            let named = PENALTIES.iter().filter(|p| page.contains(&format!("12 × {}", p.name))).count();
            assert_eq!(
                (named, page.contains("Failed by")),
                if finished { (0, false) } else { (INJURIES, true) }
            );
            [false, true].into_iter().for_each(|crowd| check(&mut face, &moment(&page, crowd)));
        }
    }
    // Points and what injuries took are shown apart: there are no -20 of 20 points.
    let (mut score, mut page) = (begun.clone(), String::new());
    (score.categories[Category::Tissue as usize], score.injuries) = (-20.0, [12; INJURIES]);
    score.metrics[Id::Injuries as usize].value = Some(28.0);
    push_result(&tasks()[0], &score, &mut page);
    assert!(page.contains("8 of 20") && page.contains("took 28 points") && !page.contains('-'), "{page}");
    let mut text = String::new();
    help(true).lines().for_each(|line| Row::Plain(line).push(&mut text));
    check(&mut face, &text);
    push_line(&mut text, Place::BottomLeft, "Hand 1: forceps");
    check(&mut face, &text);
}
