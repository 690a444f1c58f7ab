//! Lines that are too long for their place.

use font::Face;

/// `text` in lines of at most `width_px`, broken between words, and within a word that is wider.
/// Nothing comes of a width in which not even a letter fits.
pub fn wrapped(face: &mut Face, text: &str, size_px: f32, width_px: f32) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        let joined = lines.last().map(|line| format!("{line} {word}"));
        match (joined, lines.last_mut()) {
            (Some(joined), Some(line)) if face.width_px(&joined, size_px) <= width_px => *line = joined,
            _ => lines.push(word.to_owned()),
        }
        while let Some(rest) = lines.last_mut().and_then(|line| split(face, line, size_px, width_px)) {
            if lines.last().is_some_and(String::is_empty) {
                return Vec::new();
            }
            lines.push(rest);
        }
    }
    lines
}

/// Cuts `line` after the last letter that fits and returns the rest; `None` if all of it fits.
fn split(face: &mut Face, line: &mut String, size_px: f32, width_px: f32) -> Option<String> {
    if face.width_px(line, size_px) <= width_px {
        return None;
    }
    let ends = line.char_indices().map(|(at, _)| at);
    let end = ends.take_while(|&at| face.width_px(&line[..at], size_px) <= width_px).last().unwrap_or(0);
    Some(line.split_off(end))
}

/// `line` cut so that it fits with an ellipsis; as it is where it fits.
pub fn shortened(face: &mut Face, line: &str, size_px: f32, width_px: f32) -> String {
    let mut kept = line.to_owned();
    if face.width_px(line, size_px) <= width_px {
        return kept;
    }
    while kept.pop().is_some() {
        let short = format!("{}…", kept.trim_end());
        if face.width_px(&short, size_px) <= width_px {
            return short;
        }
    }
    String::new()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn lines_break_between_words() {
        let mut face = Face::new();
        let width = face.width_px("Stain the membrane.", 10.0);
        let lines = wrapped(&mut face, "Stain the membrane. Lift it", 10.0, width);
        assert_eq!(lines, ["Stain the membrane.", "Lift it"]);
        assert!(
            wrapped(&mut face, "a", 10.0, 1.0).is_empty() && wrapped(&mut face, " ", 10.0, 9.0).is_empty()
        );
    }

    #[test]
    fn what_is_cut_says_so() {
        let mut face = Face::new();
        assert_eq!(shortened(&mut face, "short", 10.0, 100.0), "short");
        let cut = shortened(&mut face, "a longer line of text", 10.0, 60.0);
        assert!(cut.ends_with('…') && face.width_px(&cut, 10.0) <= 60.0, "{cut}");
        assert_eq!(shortened(&mut face, "long", 10.0, 2.0), "");
    }

    proptest! {
        #[test]
        fn every_line_fits_and_no_letter_is_lost(text in "[a-zA-Zα-ω \u{4e2d}]{0,60}", width in 12.0f32..200.0) {
            let mut face = Face::new();
            let lines = wrapped(&mut face, &text, 10.0, width);
            for line in &lines {
                prop_assert!(face.width_px(line, 10.0) <= width, "{line}");
            }
            let letters = |t: &str| t.chars().filter(|c| !c.is_whitespace()).collect::<String>();
            prop_assert_eq!(letters(&lines.concat()), letters(&text));
        }
    }
}
