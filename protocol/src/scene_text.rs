//! Text on the picture: lines in one UTF-8 section of a scene block, each with its place.
//!
//! A line ends with a line feed. Its first character may be a [`Place::mark`]; without one it
//! stands at the bottom. [`push_line`] writes a line, [`lines`] reads them; lines of one place
//! stand under each other in their order.

/// Where a line stands on the picture of a channel. The corners lie outside the round field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Place {
    /// In the round field, centred at its lower end: notices.
    Bottom,
    /// In the middle of the field: instructions, an end screen.
    Middle,
    TopLeft,
    TopRight,
    BottomLeft,
    BottomRight,
}

impl Place {
    /// All of them.
    pub const ALL: [Place; 6] = {
        use Place::*;
        [Bottom, Middle, TopLeft, TopRight, BottomLeft, BottomRight]
    };

    /// The character that a line begins with to stand here.
    pub fn mark(self) -> char {
        match self {
            Place::Bottom => '_',
            Place::Middle => '=',
            Place::TopLeft => '<',
            Place::TopRight => '>',
            Place::BottomLeft => '[',
            Place::BottomRight => ']',
        }
    }
}

/// Adds a line to `text`; a line feed within `line` becomes a blank.
pub fn push_line(text: &mut String, place: Place, line: &str) {
    text.push(place.mark());
    text.extend(line.chars().map(|c| if c == '\n' { ' ' } else { c }));
    text.push('\n');
}

/// The lines of `text` with their places; empty ones are left out.
pub fn lines(text: &str) -> impl Iterator<Item = (Place, &str)> {
    let placed = |line| {
        let by_mark = Place::ALL.into_iter().find_map(|p| Some((p, str::strip_prefix(line, p.mark())?)));
        by_mark.unwrap_or((Place::Bottom, line))
    };
    text.lines().map(placed).filter(|(_, line)| !line.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_line_without_a_mark_stands_at_the_bottom() {
        let mut text = String::from("retina touched\n");
        push_line(&mut text, Place::TopLeft, "tier 6");
        assert_eq!(
            lines(&text).collect::<Vec<_>>(),
            [(Place::Bottom, "retina touched"), (Place::TopLeft, "tier 6")]
        );
    }

    proptest! {
        #[test]
        fn lines_come_back(written in prop::collection::vec((0usize..6, "[^\n\r]{1,20}"), 0..8)) {
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
