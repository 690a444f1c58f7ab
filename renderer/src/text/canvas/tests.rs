//! Pixels of text: outlined, only where it changed, nothing left behind.

use super::super::layout::lay_out;
use super::*;
use protocol::scene_text::Row;

const SIZE: [u32; 2] = [400, 320];

fn shown(canvas: &mut Canvas, text: &str) -> Vec<Rect> {
    let (mut face, mut changed) = (Face::new(), Vec::new());
    let layout = lay_out(&mut face, text, SIZE);
    canvas.show(&mut face, layout, |_, rect| changed.push(rect));
    changed
}

fn fresh(text: &str) -> Canvas {
    let mut canvas = Canvas::default();
    canvas.resize(SIZE);
    shown(&mut canvas, text);
    canvas
}

#[test]
fn letters_are_bright_with_a_dark_edge_and_lie_in_their_block() {
    let canvas = fresh("_Ag\n");
    let rect = canvas.blocks()[0].rect;
    let (mut ink, mut edge) = (0, 0);
    for (i, pixel) in canvas.pixels().chunks(4).enumerate().filter(|(_, p)| p[3] > 0) {
        let (x, y) = (i as i32 % SIZE[0] as i32, i as i32 / SIZE[0] as i32);
        assert!(rect.holds(&Rect::new(x, y, 1, 1)), "{x}, {y} outside {rect:?}");
        assert!(pixel[..3].iter().all(|&c| c <= pixel[3]), "multiplied by the opacity: {pixel:?}");
        ink += usize::from(pixel[0] > 150);
        edge += usize::from(pixel[3] > 150 && pixel[0] < 60);
    }
    assert!(ink > 12 && edge > ink, "{ink} of ink, {edge} around it");
}

#[test]
fn only_what_changed_is_drawn_anew_and_nothing_is_left_behind() {
    let mut canvas = fresh("<Level 1\n>1:20\n_Next: the edge\n");
    let changed = shown(&mut canvas, "<Level 1\n>1:19\n_Next: the edge\n");
    assert_eq!(changed.len(), 1, "the time alone: {changed:?}");
    let texts = [
        "<Level 1\n_A longer line at the bottom of the field\n",
        "=#Finished\n=|0.4|Tissue|8 of 20\n",
        "",
        "^x\n",
    ];
    for text in texts {
        shown(&mut canvas, text);
        assert!(canvas.pixels() == fresh(text).pixels(), "{text:?}");
    }
    assert!(shown(&mut canvas, "^x\n").is_empty(), "nothing changed");
}

#[test]
fn a_bar_is_filled_by_its_share() {
    let filled = |share: f32| {
        let mut text = String::new();
        Row::Bar { name: "Tissue", share, value: "x" }.push(&mut text);
        let canvas = fresh(&text);
        canvas.pixels().chunks(4).filter(|p| p[..3] == FILLED && p[3] == 255).count() as f32
    };
    let whole = filled(1.0);
    assert!(whole > 300.0 && filled(0.0) == 0.0);
    assert!((filled(0.25) / whole - 0.25).abs() < 0.02);
}

#[test]
fn what_the_font_lacks_is_seen() {
    let ink = |text: &str| fresh(text).pixels().chunks(4).filter(|p| p[0] > 120).count();
    let [lacking, known] = ["_\u{4e2d}\n", "_Grasp γ Щ\n"].map(ink);
    assert!(lacking > 8 && known > 50, "{lacking} and {known}");
}
