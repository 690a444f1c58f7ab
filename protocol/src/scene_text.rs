//! Text on the picture: lines in one UTF-8 section of a scene block, each with its place.
//!
//! A line ends with a line feed. Its first character may be a [`Place::mark`]; without one it
//! stands at the top. [`push_line`] writes a line, [`lines`] reads them; lines of one place stand
//! under each other in their order. Lines of [`Place::Page`] are rows of a page: a title, a bar or
//! plain text ([`Row`]).

/// Where a line stands on the picture of a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Place {
    /// Centred at the upper rim of the round field: warnings, what is lost or held.
    Top,
    /// Centred at its lower rim: what is to be done.
    Bottom,
    /// A page in the middle while no work is done: an end screen, help.
    Page,
    TopLeft,
    TopRight,
    BottomLeft,
    BottomRight,
}

impl Place {
    /// All of them.
    pub const ALL: [Place; 7] = {
        use Place::*;
        [Top, Bottom, Page, TopLeft, TopRight, BottomLeft, BottomRight]
    };

    /// The character that a line begins with to stand here.
    pub fn mark(self) -> char {
        match self {
            Place::Top => '^',
            Place::Bottom => '_',
            Place::Page => '=',
            Place::TopLeft => '<',
            Place::TopRight => '>',
            Place::BottomLeft => '[',
            Place::BottomRight => ']',
        }
    }
}

/// A row of a page.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Row<'a> {
    /// Larger than the others.
    Title(&'a str),
    /// A name, a bar of which a share is filled (0 to 1), and what it stands for.
    Bar {
        /// What is measured.
        name: &'a str,
        /// Filled share, 0 to 1.
        share: f32,
        /// The figure in words.
        value: &'a str,
    },
    /// Text.
    Plain(&'a str),
}

/// Begins a title, and a bar; separates the parts of a bar.
const TITLE: char = '#';
const BAR: char = '|';

impl<'a> Row<'a> {
    /// Reads a line of [`Place::Page`]. What is no valid bar is text as it stands.
    pub fn of(line: &'a str) -> Self {
        if let Some(title) = line.strip_prefix(TITLE) {
            return Row::Title(title);
        }
        let bar = || {
            let (share, rest) = line.strip_prefix(BAR)?.split_once(BAR)?;
            let (name, value) = rest.split_once(BAR)?;
            let share: f32 = share.parse().ok().filter(|s| (0.0..=1.0).contains(s))?;
            Some(Row::Bar { name, share, value })
        };
        bar().unwrap_or(Row::Plain(line))
    }

    /// Writes the row into `text` as a line of [`Place::Page`]; a share outside 0 to 1 becomes the
    /// nearer of both, one that is no number 0. Plain text that begins with a mark of a title or a
    /// bar gets a blank before it.
    pub fn push(self, text: &mut String) {
        match self {
            Row::Title(title) => push_line(text, Place::Page, &format!("{TITLE}{title}")),
            Row::Bar { name, share, value } => {
                let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
                let name = name.replace(BAR, "/");
                push_line(text, Place::Page, &format!("{BAR}{share:.3}{BAR}{name}{BAR}{value}"));
            }
            Row::Plain(line) if line.starts_with([TITLE, BAR]) => {
                push_line(text, Place::Page, &format!(" {line}"));
            }
            Row::Plain(line) => push_line(text, Place::Page, line),
        }
    }
}

/// Adds a line to `text`; a line feed within `line` becomes a blank.
pub fn push_line(text: &mut String, place: Place, line: &str) {
    text.push(place.mark());
    text.extend(line.chars().map(on_one_line));
    text.push('\n');
}

fn on_one_line(character: char) -> char {
    if character == '\n' { ' ' } else { character }
}

/// As [`push_line`], with a capital at the begin, as a notice of a program becomes a sentence.
pub fn push_sentence(text: &mut String, place: Place, line: &str) {
    text.push(place.mark());
    text.extend(capitalised(line).map(on_one_line));
    text.push('\n');
}

/// The letters of `text` with a capital at the begin.
pub fn capitalised(text: &str) -> impl Iterator<Item = char> {
    let mut letters = text.chars();
    letters.next().into_iter().flat_map(char::to_uppercase).chain(letters)
}

/// The lines of `text` with their places; empty ones are left out.
pub fn lines(text: &str) -> impl Iterator<Item = (Place, &str)> {
    let placed = |line| {
        let by_mark = Place::ALL.into_iter().find_map(|p| Some((p, str::strip_prefix(line, p.mark())?)));
        by_mark.unwrap_or((Place::Top, line))
    };
    text.lines().map(placed).filter(|(_, line)| !line.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_line_without_a_mark_stands_at_the_top() {
        let mut text = String::from("retina touched\n");
        push_line(&mut text, Place::TopLeft, "tier 6");
        assert_eq!(
            lines(&text).collect::<Vec<_>>(),
            [(Place::Top, "retina touched"), (Place::TopLeft, "tier 6")]
        );
    }

    #[test]
    fn what_is_no_valid_bar_is_text_as_it_stands() {
        let bar = Row::Bar { name: "tissue", share: 0.25, value: "5 of 20" };
        assert_eq!(Row::of("|0.25|tissue|5 of 20"), bar);
        for odd in ["|1.5|a|b", "|nan|a|b", "|0.5|a", "|", "||", "|-0.1|a|b", "plain", ""] {
            assert_eq!(Row::of(odd), Row::Plain(odd));
        }
        assert_eq!(Row::of("#"), Row::Title(""));
    }

    #[test]
    fn rows_come_back_whatever_they_hold() {
        let rows = [
            (Row::Title("|a"), Row::Title("|a")),
            (Row::Plain("#b"), Row::Plain(" #b")),
            (
                Row::Bar { name: "c|d", share: 7.0, value: "e|f" },
                Row::Bar { name: "c/d", share: 1.0, value: "e|f" },
            ),
            (Row::Bar { name: "", share: f32::NAN, value: "" }, Row::Bar { name: "", share: 0.0, value: "" }),
        ];
        let mut text = String::new();
        rows.iter().for_each(|(row, _)| row.push(&mut text));
        let back: Vec<_> = lines(&text).map(|(place, line)| (place, Row::of(line))).collect();
        assert_eq!(back, rows.map(|(_, row)| (Place::Page, row)));
    }

    #[test]
    fn a_sentence_begins_with_a_capital() {
        let mut text = String::new();
        ["grip slipped", "émoussé", "", "Éa"].iter().for_each(|l| push_sentence(&mut text, Place::Top, l));
        assert_eq!(text, "^Grip slipped\n^Émoussé\n^\n^Éa\n");
    }

    proptest! {
        #[test]
        fn lines_come_back(written in prop::collection::vec((0usize..7, "[^\n\r]{1,20}"), 0..8)) {
            let mut text = String::new();
            for (place, line) in &written {
                push_line(&mut text, Place::ALL[*place], line);
            }
            let back: Vec<_> = lines(&text).collect();
            let expected: Vec<_> = written.iter().map(|(p, l)| (Place::ALL[*p], l.as_str())).collect();
            prop_assert_eq!(back, expected);
        }
    }
}
