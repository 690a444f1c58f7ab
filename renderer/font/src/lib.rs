//! A small bitmap font, 5×7 in cells of 6×8, drawn for this program: capitals, digits and a few
//! signs. Small letters are shown as capitals, anything else as a blank.

/// Width of a cell, px.
pub const CELL_W: usize = 6;
/// Height of a cell, px.
pub const CELL_H: usize = 8;

/// Rows of a character, the lowest five bits from left to right.
fn glyph(character: char) -> [u8; 7] {
    match character.to_ascii_uppercase() {
        'A' => [14, 17, 17, 31, 17, 17, 17],
        'B' => [30, 17, 17, 30, 17, 17, 30],
        'C' => [14, 17, 16, 16, 16, 17, 14],
        'D' => [30, 17, 17, 17, 17, 17, 30],
        'E' => [31, 16, 16, 30, 16, 16, 31],
        'F' => [31, 16, 16, 30, 16, 16, 16],
        'G' => [14, 17, 16, 23, 17, 17, 15],
        'H' => [17, 17, 17, 31, 17, 17, 17],
        'I' => [14, 4, 4, 4, 4, 4, 14],
        'J' => [7, 2, 2, 2, 2, 18, 12],
        'K' => [17, 18, 20, 24, 20, 18, 17],
        'L' => [16, 16, 16, 16, 16, 16, 31],
        'M' => [17, 27, 21, 21, 17, 17, 17],
        'N' => [17, 25, 21, 19, 17, 17, 17],
        'O' => [14, 17, 17, 17, 17, 17, 14],
        'P' => [30, 17, 17, 30, 16, 16, 16],
        'Q' => [14, 17, 17, 17, 21, 18, 13],
        'R' => [30, 17, 17, 30, 20, 18, 17],
        'S' => [15, 16, 16, 14, 1, 1, 30],
        'T' => [31, 4, 4, 4, 4, 4, 4],
        'U' => [17, 17, 17, 17, 17, 17, 14],
        'V' => [17, 17, 17, 17, 17, 10, 4],
        'W' => [17, 17, 17, 21, 21, 27, 17],
        'X' => [17, 17, 10, 4, 10, 17, 17],
        'Y' => [17, 17, 10, 4, 4, 4, 4],
        'Z' => [31, 1, 2, 4, 8, 16, 31],
        '0' => [14, 17, 19, 21, 25, 17, 14],
        '1' => [4, 12, 4, 4, 4, 4, 14],
        '2' => [14, 17, 1, 6, 8, 16, 31],
        '3' => [30, 1, 1, 14, 1, 1, 30],
        '4' => [2, 6, 10, 18, 31, 2, 2],
        '5' => [31, 16, 30, 1, 1, 17, 14],
        '6' => [6, 8, 16, 30, 17, 17, 14],
        '7' => [31, 1, 2, 4, 8, 8, 8],
        '8' => [14, 17, 17, 14, 17, 17, 14],
        '9' => [14, 17, 17, 15, 1, 2, 12],
        '.' => [0, 0, 0, 0, 0, 12, 12],
        ',' => [0, 0, 0, 0, 12, 4, 8],
        ':' => [0, 12, 12, 0, 12, 12, 0],
        ';' => [0, 12, 12, 0, 12, 4, 8],
        '-' => [0, 0, 0, 14, 0, 0, 0],
        '+' => [0, 4, 4, 31, 4, 4, 0],
        '/' => [1, 1, 2, 4, 8, 16, 16],
        '(' => [2, 4, 8, 8, 8, 4, 2],
        ')' => [8, 4, 2, 2, 2, 4, 8],
        '%' => [24, 25, 2, 4, 8, 19, 3],
        '!' => [4, 4, 4, 4, 4, 0, 4],
        '?' => [14, 17, 1, 2, 4, 0, 4],
        '=' => [0, 0, 31, 0, 31, 0, 0],
        '<' => [2, 4, 8, 16, 8, 4, 2],
        '>' => [8, 4, 2, 1, 2, 4, 8],
        '\'' => [4, 4, 8, 0, 0, 0, 0],
        '*' => [0, 21, 14, 31, 14, 21, 0],
        '#' => [10, 10, 31, 10, 31, 10, 10],
        _ => [0; 7],
    }
}

/// True if the font shows a character as it is, or as its capital.
pub fn has(character: char) -> bool {
    character == ' ' || glyph(character) != [0; 7]
}

/// Letters of the strip: the printable characters of ASCII.
pub const LETTERS: usize = 96;
const FIRST: char = ' ';

/// Number of a character in the strip; one that the font lacks is a blank.
pub fn number(character: char) -> usize {
    (character as usize).checked_sub(FIRST as usize).filter(|&n| n < LETTERS).unwrap_or(0)
}

/// All letters beside each other, a byte a pixel (0 or 255), and the strip's width in pixels.
pub fn strip() -> (Vec<u8>, u32) {
    let width = LETTERS * CELL_W;
    let mut pixels = vec![0; width * CELL_H];
    for (n, character) in (FIRST..).take(LETTERS).enumerate() {
        for (y, bits) in glyph(character).into_iter().enumerate() {
            for x in (0..5).filter(|x| bits >> (4 - x) & 1 == 1) {
                pixels[y * width + n * CELL_W + x] = 255;
            }
        }
    }
    (pixels, width as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn capitals_and_digits_all_differ() {
        let signs: Vec<char> = ('A'..='Z').chain('0'..='9').collect();
        for (i, a) in signs.iter().enumerate() {
            assert!(signs[..i].iter().all(|b| glyph(*a) != glyph(*b)), "{a}");
            assert!(glyph(*a).iter().all(|row| *row < 32) && glyph(*a) != [0; 7]);
        }
        assert_eq!(glyph('q'), glyph('Q'));
        assert!(has('q') && has(';') && has(' ') && !has('µ'));
    }

    #[test]
    fn letters_stand_in_the_strip_by_their_number() {
        let (pixels, width) = strip();
        let ink = |character: char| {
            let left = number(character) * CELL_W;
            (0..CELL_H)
                .flat_map(|y| &pixels[y * width as usize + left..][..CELL_W])
                .filter(|p| **p > 0)
                .count()
        };
        assert_eq!((ink('I'), ink('i'), ink(' '), ink('µ')), (3 + 5 + 3, 3 + 5 + 3, 0, 0));
        assert_eq!((number('~'), number('\u{7f}'), number('\n')), (94, 95, 0));
    }
}
