//! Blocks at their places, at every size; odd texts.

use super::*;
use crate::compose::output_px;
use crate::governor::TIERS;
use proptest::prelude::*;
use protocol::scene_text::{Row, push_line};

/// Sizes of a channel: of every tier, in files, and of windows of other shapes.
fn sizes() -> Vec<[u32; 2]> {
    let tiers = TIERS.iter().flat_map(|t| [[t.width_px, t.height_px], output_px(t)]);
    tiers.chain([[367, 293], [960, 768], [2048, 1638], [200, 160]]).collect()
}

/// Asserts what a layout promises.
fn check(layout: &Layout, size_px: [u32; 2], text: &str) {
    layout.check(size_px).unwrap_or_else(|problem| panic!("{size_px:?}: {problem} of {text:?}"));
}

#[test]
fn broken_promises_are_seen() {
    let row = |rect| PlacedRow { rect, size_px: 10.0, content: Content::Text("x".into()) };
    let block = |place, rect| Block { place, rect, rows: vec![row(rect)] };
    let layout = |blocks| Layout { blocks, ..Layout::default() };
    let told = |blocks| layout(blocks).check([400, 320]).err().unwrap_or_default();
    let [corner, wide] = [Rect::new(4, 4, 60, 13), Rect::new(50, 10, 100, 13)];
    assert_eq!(told(vec![block(Place::TopLeft, corner)]), "");
    assert!(told(vec![block(Place::TopLeft, corner), block(Place::Top, wide)]).starts_with("overlap"));
    assert!(told(vec![block(Place::TopLeft, Rect::new(-1, 4, 60, 13))]).starts_with("leaves"));
    let middle = Rect::new(150, 90, 100, 13);
    assert!(told(vec![block(Place::Bottom, middle)]).contains("out of its place"));
    assert_eq!(told(vec![block(Place::Page, middle)]), "");
    let strays = Block { place: Place::TopLeft, rect: corner, rows: vec![row(wide)] };
    assert!(told(vec![strays]).contains("out of its place"));
}

fn written(lines: &[(Place, &str)]) -> String {
    let mut text = String::new();
    lines.iter().for_each(|(place, line)| push_line(&mut text, *place, line));
    text
}

#[test]
fn lines_stand_at_their_places() {
    let text = written(&Place::ALL.map(|place| (place, "Line")));
    for size_px in sizes() {
        let layout = lay_out(&mut Face::new(), &text, size_px);
        check(&layout, size_px, &text);
        assert_eq!((layout.blocks.len(), layout.cut), (7, false), "{size_px:?}");
        let [w, h] = size_px.map(|n| n as i32);
        for block in &layout.blocks {
            let (x, y) = (block.rect.left + block.rect.right, block.rect.top + block.rect.bottom);
            let [across, down] = [(x - w).signum() * i32::from((x - w).abs() > 2), (y - h).signum()];
            let expected = match block.place {
                Place::Top => [0, -1],
                Place::Bottom => [0, 1],
                Place::Page => [0, down],
                Place::TopLeft => [-1, -1],
                Place::TopRight => [1, -1],
                Place::BottomLeft => [-1, 1],
                Place::BottomRight => [1, 1],
            };
            assert_eq!([across, down], expected, "{size_px:?}: {block:?}");
        }
    }
}

#[test]
fn letters_follow_the_channel_and_stay_legible() {
    let of = |size_px: [u32; 2]| lay_out(&mut Face::new(), "_Grasp the edge\n", size_px).size_px;
    assert_eq!([of([1280, 1024]), of([400, 320]), of([320, 256]), of([160, 128])], [32.0, 10.0, 9.0, 9.0]);
}

#[test]
fn long_lines_wrap_and_crowds_are_reduced_before_anything_is_cut() {
    let line = "Bring the tip into each ball and keep it there until it turns green all over.";
    let text = written(&[(Place::Bottom, line), (Place::TopLeft, line)]);
    let layout = lay_out(&mut Face::new(), &text, [400, 320]);
    check(&layout, [400, 320], &text);
    assert!(!layout.cut && layout.blocks[1].rows.len() >= 2, "{layout:?}");
    let crowd = written(&[(Place::TopLeft, line); 4]);
    let reduced = lay_out(&mut Face::new(), &crowd, [400, 320]);
    check(&reduced, [400, 320], &crowd);
    assert!(!reduced.cut && reduced.size_px < layout.size_px, "{}", reduced.size_px);
    let flood = written(&[(Place::Bottom, line); 30]);
    let cut = lay_out(&mut Face::new(), &flood, [400, 320]);
    check(&cut, [400, 320], &flood);
    let last = cut.blocks[0].rows.last().map(|row| row.content.clone());
    assert!(cut.cut && matches!(&last, Some(Content::Text(t)) if t.ends_with('…')), "{last:?}");
}

#[test]
fn lower_corners_step_above_a_wide_line() {
    let wide = "The second takes it from there to its own side and keeps it there.";
    let text = written(&[(Place::Bottom, wide), (Place::BottomLeft, "Hand 1: pick")]);
    let layout = lay_out(&mut Face::new(), &text, [400, 320]);
    check(&layout, [400, 320], &text);
    let [bottom, left] = [Place::Bottom, Place::BottomLeft]
        .map(|place| layout.blocks.iter().find(|b| b.place == place).expect("a block").rect);
    assert!(left.bottom < bottom.top, "{left:?} {bottom:?}");
}

#[test]
fn bars_stand_under_each_other() {
    let mut text = String::new();
    Row::Title("Membrane peeling, level 2").push(&mut text);
    for (name, share) in [("Tissue treatment", 0.0), ("Efficiency", 0.5), ("Target", 1.0)] {
        Row::Bar { name, share, value: "10 of 20" }.push(&mut text);
    }
    for size_px in sizes().into_iter().filter(|s| s[0] >= 320) {
        let layout = lay_out(&mut Face::new(), &text, size_px);
        check(&layout, size_px, &text);
        let page = &layout.blocks[0];
        let bars: Vec<_> = page.rows.iter().filter(|r| matches!(r.content, Content::Bar { .. })).collect();
        assert!(page.place == Place::Page && bars.len() == 3 && !layout.cut, "{size_px:?}");
        for row in &bars {
            let Content::Bar { bar, .. } = row.content else { unreachable!("bars only") };
            let Content::Bar { bar: first, .. } = bars[0].content else { unreachable!("bars only") };
            assert_eq!((row.rect.left, bar), (bars[0].rect.left, first));
            assert!(bar[1] - bar[0] >= 3 * row.size_px as i32, "{bar:?}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn whatever_comes_overlaps_nothing_and_leaves_nothing(
        lines in prop::collection::vec((0usize..7, "[ -~]{0,90}|[α-ωА-я\u{4e2d} ]{0,40}|\\|0\\.5\\|.{0,30}\\|.{0,30}"), 0..24),
        width in 1u32..700,
    ) {
        let size_px = [width, (width * 4 / 5).max(1)];
        let mut text = String::new();
        lines.iter().for_each(|(place, line)| push_line(&mut text, Place::ALL[*place], line));
        check(&lay_out(&mut Face::new(), &text, size_px), size_px, &text);
    }
}
