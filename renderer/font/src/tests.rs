//! Letters of three scripts, kerning, places, and what the font lacks.

use super::*;
use std::collections::BTreeMap;

/// The pixels of a line.
fn drawn(text: &str, size_px: f32, at: [f32; 2]) -> BTreeMap<(i32, i32), u8> {
    let mut pixels = BTreeMap::new();
    Face::new().draw(text, size_px, at, |x, y, grey| {
        let pixel: &mut u8 = pixels.entry((y, x)).or_default();
        *pixel = (*pixel).max(grey);
    });
    pixels
}

#[test]
fn letters_of_three_scripts_all_differ() {
    let latin = ('A'..='Z').chain('a'..='z').chain('0'..='9').chain("äöüßéñçøåł".chars());
    let greek = "ΓΔΘΛΞΠΣΦΨΩαβγδεζηθλμξπσςφψω".chars();
    let cyrillic = "БГДЖЗИЙЛПУФЦЧШЩЪЫЬЭЮЯбвгджзийклмнптфцчшщъыьэюя".chars();
    let mut seen = BTreeMap::new();
    for letter in latin.chain(greek).chain(cyrillic) {
        assert!(has(letter), "{letter}");
        let shape = drawn(&letter.to_string(), 24.0, [0.0, 24.0]);
        assert!(shape.len() > 20, "{letter}");
        if let Some(other) = seen.insert(shape, letter) {
            let twins = ["ГΓ", "ПΠ", "ФΦ"];
            let pair: String = [letter, other].iter().collect();
            assert!(twins.contains(&pair.as_str()), "{letter} looks like {other}");
        }
    }
}

#[test]
fn signs_of_the_simulator_are_there() {
    for sign in "µ²³·×±°–—’…≤≥→←↑↓½".chars() {
        assert!(has(sign), "{sign}");
    }
    assert!(!has('\u{4e2d}') && !has('\n'));
}

#[test]
fn pairs_are_kerned() {
    let mut face = Face::new();
    for (pair, size) in [("AV", 10.0), ("To", 10.0), ("AV", 40.0), ("Ty", 40.0)] {
        let alone: f32 = pair.chars().map(|c| face.width_px(&c.to_string(), size)).sum();
        let together = face.width_px(pair, size);
        assert!(together < alone - 0.03 * size, "{pair}: {together} and {alone}");
    }
}

#[test]
fn what_the_font_lacks_is_a_box_and_takes_its_room() {
    let (lacking, other) = (drawn("\u{4e2d}", 20.0, [0.0, 20.0]), drawn("\u{3042}", 20.0, [0.0, 20.0]));
    assert!(lacking.len() > 20 && lacking == other, "the same box");
    assert!(lacking != drawn("x", 20.0, [0.0, 20.0]));
    let mut face = Face::new();
    let (with, without) = (face.width_px("a\u{4e2d}b", 20.0), face.width_px("ab", 20.0));
    assert!(with > without + 8.0, "{with} and {without}");
}

#[test]
fn a_line_keeps_to_its_height_and_width() {
    // Hinting lifts accents of capitals by up to two rows.
    let text = "ÅÉ Ξ Й Щgjpqy(|)";
    for size in [8.0, 9.0, 11.0, 16.0, 33.0] {
        let base = baseline_px(size).round();
        let pixels = drawn(text, size, [3.0, base]);
        let width = Face::new().width_px(text, size);
        for ((y, x), grey) in pixels.iter().filter(|(_, grey)| **grey > 60) {
            assert!((-2..=line_px(size).ceil() as i32).contains(y), "{size}: row {y}, {grey}");
            assert!((2..=(width + 4.0).ceil() as i32).contains(x), "{size}: column {x} of {width}");
        }
    }
}

#[test]
fn the_same_place_gives_the_same_pixels_and_a_quarter_others() {
    let at = |x: f32| drawn("Retina", 12.0, [x, 12.0]);
    let moved: BTreeMap<_, _> = at(0.0).into_iter().map(|((y, x), grey)| ((y, x + 40), grey)).collect();
    assert_eq!(at(40.0), moved, "a whole pixel moves and changes nothing");
    assert_ne!(at(40.25), at(40.0));
    assert_eq!(at(0.01), at(0.0), "places are quarters");
}

#[test]
fn odd_texts_and_sizes_are_drawn_too() {
    for text in ["", " ", "\t\u{0}\u{200b}", "e\u{301}\u{302}\u{303}", "\u{202e}abc", "😀 שלום"] {
        for size in [0.0, 0.5, 7.3, 1e9, f32::NAN] {
            let width = Face::new().draw(text, size, [0.0, 0.0], |_, _, _| {});
            assert!(width.is_finite() && width >= 0.0 || size.is_nan(), "{text:?} at {size}");
        }
    }
}

#[test]
fn a_line_is_written_into_a_picture_and_not_beyond_it() {
    let (mut face, width, height) = (Face::new(), 40, 20);
    let paper = vec![255; 3 * 40 * 20];
    for at in [[2.0, 1.0], [-9.0, -6.0], [33.0, 12.0], [500.0, 3.0], [3.0, -90.0]] {
        let mut picture = paper.clone();
        face.write(&mut picture, width, at, "Wg", 14.0, [0, 90, 0]);
        let inked: Vec<_> = picture.chunks(3).map(|p| p != [255; 3]).collect();
        let count = inked.iter().filter(|i| **i).count();
        assert!(picture.chunks(3).all(|p| p[0] == p[2] && p[1] >= 90), "of this colour");
        let there = at[0] < f32::from(width as u16) && at[1] > -20.0;
        assert!((count > 5) == there, "{at:?}: {count}");
        // Nothing that leaves a row on the right comes back in the next one on the left.
        assert!(at[0] < 30.0 || (0..height).all(|row| !inked[row * 40]), "{at:?}");
    }
}
