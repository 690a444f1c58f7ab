//! A bitmap font drawn for this program: letters of 5×8 dots in cells of 6×8, digits and a few
//! signs. Other characters are blank. The strip, for pictures, holds small letters as capitals.

/// Width of a cell, px.
pub const CELL_W: usize = 6;
/// Height of a cell, px.
pub const CELL_H: usize = 8;

/// Rows of a character from the top, in each the lowest five bits from left to right.
pub fn glyph(character: char) -> [u8; CELL_H] {
    match character {
        'A' => [14, 17, 17, 31, 17, 17, 17, 0],
        'B' => [30, 17, 17, 30, 17, 17, 30, 0],
        'C' => [14, 17, 16, 16, 16, 17, 14, 0],
        'D' => [30, 17, 17, 17, 17, 17, 30, 0],
        'E' => [31, 16, 16, 30, 16, 16, 31, 0],
        'F' => [31, 16, 16, 30, 16, 16, 16, 0],
        'G' => [14, 17, 16, 23, 17, 17, 15, 0],
        'H' => [17, 17, 17, 31, 17, 17, 17, 0],
        'I' => [14, 4, 4, 4, 4, 4, 14, 0],
        'J' => [7, 2, 2, 2, 2, 18, 12, 0],
        'K' => [17, 18, 20, 24, 20, 18, 17, 0],
        'L' => [16, 16, 16, 16, 16, 16, 31, 0],
        'M' => [17, 27, 21, 21, 17, 17, 17, 0],
        'N' => [17, 25, 21, 19, 17, 17, 17, 0],
        'O' => [14, 17, 17, 17, 17, 17, 14, 0],
        'P' => [30, 17, 17, 30, 16, 16, 16, 0],
        'Q' => [14, 17, 17, 17, 21, 18, 13, 0],
        'R' => [30, 17, 17, 30, 20, 18, 17, 0],
        'S' => [15, 16, 16, 14, 1, 1, 30, 0],
        'T' => [31, 4, 4, 4, 4, 4, 4, 0],
        'U' => [17, 17, 17, 17, 17, 17, 14, 0],
        'V' => [17, 17, 17, 17, 17, 10, 4, 0],
        'W' => [17, 17, 17, 21, 21, 27, 17, 0],
        'X' => [17, 17, 10, 4, 10, 17, 17, 0],
        'Y' => [17, 17, 10, 4, 4, 4, 4, 0],
        'Z' => [31, 1, 2, 4, 8, 16, 31, 0],
        'a' => [0, 0, 14, 1, 15, 17, 15, 0],
        'b' => [16, 16, 30, 17, 17, 17, 30, 0],
        'c' => [0, 0, 14, 16, 16, 17, 14, 0],
        'd' => [1, 1, 15, 17, 17, 17, 15, 0],
        'e' => [0, 0, 14, 17, 31, 16, 14, 0],
        'f' => [6, 9, 8, 28, 8, 8, 8, 0],
        'g' => [0, 0, 15, 17, 17, 15, 1, 14],
        'h' => [16, 16, 30, 17, 17, 17, 17, 0],
        'i' => [4, 0, 12, 4, 4, 4, 14, 0],
        'j' => [2, 0, 6, 2, 2, 2, 18, 12],
        'k' => [16, 16, 18, 20, 24, 20, 18, 0],
        'l' => [12, 4, 4, 4, 4, 4, 14, 0],
        'm' => [0, 0, 26, 21, 21, 21, 21, 0],
        'n' => [0, 0, 30, 17, 17, 17, 17, 0],
        'o' => [0, 0, 14, 17, 17, 17, 14, 0],
        'p' => [0, 0, 30, 17, 17, 30, 16, 16],
        'q' => [0, 0, 15, 17, 17, 15, 1, 1],
        'r' => [0, 0, 22, 25, 16, 16, 16, 0],
        's' => [0, 0, 15, 16, 14, 1, 30, 0],
        't' => [8, 8, 28, 8, 8, 9, 6, 0],
        'u' => [0, 0, 17, 17, 17, 17, 15, 0],
        'v' => [0, 0, 17, 17, 17, 10, 4, 0],
        'w' => [0, 0, 17, 17, 21, 21, 10, 0],
        'x' => [0, 0, 17, 10, 4, 10, 17, 0],
        'y' => [0, 0, 17, 17, 17, 15, 1, 14],
        'z' => [0, 0, 31, 2, 4, 8, 31, 0],
        '0' => [14, 17, 19, 21, 25, 17, 14, 0],
        '1' => [4, 12, 4, 4, 4, 4, 14, 0],
        '2' => [14, 17, 1, 6, 8, 16, 31, 0],
        '3' => [30, 1, 1, 14, 1, 1, 30, 0],
        '4' => [2, 6, 10, 18, 31, 2, 2, 0],
        '5' => [31, 16, 30, 1, 1, 17, 14, 0],
        '6' => [6, 8, 16, 30, 17, 17, 14, 0],
        '7' => [31, 1, 2, 4, 8, 8, 8, 0],
        '8' => [14, 17, 17, 14, 17, 17, 14, 0],
        '9' => [14, 17, 17, 15, 1, 2, 12, 0],
        '.' => [0, 0, 0, 0, 0, 12, 12, 0],
        ',' => [0, 0, 0, 0, 12, 4, 8, 0],
        ':' => [0, 12, 12, 0, 12, 12, 0, 0],
        ';' => [0, 12, 12, 0, 12, 4, 8, 0],
        '-' => [0, 0, 0, 14, 0, 0, 0, 0],
        '+' => [0, 4, 4, 31, 4, 4, 0, 0],
        '/' => [1, 1, 2, 4, 8, 16, 16, 0],
        '(' => [2, 4, 8, 8, 8, 4, 2, 0],
        ')' => [8, 4, 2, 2, 2, 4, 8, 0],
        '%' => [24, 25, 2, 4, 8, 19, 3, 0],
        '!' => [4, 4, 4, 4, 4, 0, 4, 0],
        '?' => [14, 17, 1, 2, 4, 0, 4, 0],
        '^' => [4, 10, 17, 0, 0, 0, 0, 0],
        '=' => [0, 0, 31, 0, 31, 0, 0, 0],
        '<' => [2, 4, 8, 16, 8, 4, 2, 0],
        '>' => [8, 4, 2, 1, 2, 4, 8, 0],
        '\'' => [4, 4, 8, 0, 0, 0, 0, 0],
        '*' => [0, 21, 14, 31, 14, 21, 0, 0],
        '#' => [10, 10, 31, 10, 31, 10, 10, 0],
        _ => [0; CELL_H],
    }
}

/// True if the font has a character.
pub fn has(character: char) -> bool {
    character == ' ' || glyph(character) != [0; CELL_H]
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
        for (y, bits) in glyph(character.to_ascii_uppercase()).into_iter().enumerate() {
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
    fn letters_and_digits_all_differ() {
        let signs: Vec<char> = ('A'..='Z').chain('a'..='z').chain('0'..='9').collect();
        for (i, a) in signs.iter().enumerate() {
            assert!(signs[..i].iter().all(|b| glyph(*a) != glyph(*b)), "{a}");
            assert!(glyph(*a).iter().all(|row| *row < 32) && glyph(*a) != [0; CELL_H]);
        }
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
