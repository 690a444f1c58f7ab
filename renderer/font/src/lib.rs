//! A bitmap font drawn for this program: letters of 5×8 dots in cells of 6×8, digits and a few
//! signs. Other characters are blank. The strip, for pictures, holds small letters as capitals.

/// Width of a cell, px.
pub const CELL_W: usize = 6;
/// Height of a cell, px.
pub const CELL_H: usize = 8;

/// Letters of the strip: the printable characters of ASCII.
pub const LETTERS: usize = 96;
const FIRST: char = ' ';

/// The letters as they are seen, sixteen beside each other, in the order of their numbers.
const DRAWN: &[u8] = include_bytes!("letters.txt");
const ALONG: usize = 16;
const GLYPHS: [[u8; CELL_H]; LETTERS] = glyphs();

/// Reads the dots of every letter.
const fn glyphs() -> [[u8; CELL_H]; LETTERS] {
    let mut glyphs = [[0; CELL_H]; LETTERS];
    let mut dot = 0;
    while dot < LETTERS * CELL_H * CELL_W {
        let (n, y, x) = (dot / CELL_W / CELL_H, dot / CELL_W % CELL_H, dot % CELL_W);
        let line = n / ALONG * CELL_H + y;
        let at = line * (ALONG * CELL_W + 1) + n % ALONG * CELL_W + x;
        if DRAWN[at] == b'#' {
            glyphs[n][y] |= 1 << (4 - x);
        }
        dot += 1;
    }
    glyphs
}

/// Rows of a character from the top, in each the lowest five bits from left to right.
pub fn glyph(character: char) -> [u8; CELL_H] {
    GLYPHS[number(character)]
}

/// True if the font has a character.
pub fn has(character: char) -> bool {
    character == ' ' || glyph(character) != [0; CELL_H]
}

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
