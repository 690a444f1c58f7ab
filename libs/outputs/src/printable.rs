//! Escapes untrusted text for a terminal.

use std::borrow::Cow;

/// Escapes control and bidirectional characters of untrusted text, which could move the cursor or reorder the
/// line. Control characters become their Unicode pictures (`␛`), or `\u{fffd}` if they have none, as
/// bidirectional marks do. Line feeds and tabs are kept.
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.chars().any(is_hidden) {
        return Cow::Borrowed(text);
    }
    let shown = |c: char| match c {
        '\u{7f}' => '␡',
        '\0'..='\u{1f}' if is_hidden(c) => char::from_u32(0x2400 + u32::from(c)).unwrap_or('\u{fffd}'),
        _ if is_hidden(c) => '\u{fffd}',
        _ => c,
    };
    Cow::Owned(text.chars().map(shown).collect())
}

fn is_hidden(c: char) -> bool {
    let turns = matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    (c.is_control() && !matches!(c, '\n' | '\t')) || turns
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_cannot_command_the_terminal() {
        assert!(matches!(printable("plain\tµm\n"), Cow::Borrowed(_)));
        assert_eq!(printable("\x1b[2Jx\r\x7f\u{9b}\u{202e}"), "␛[2Jx␍␡\u{fffd}\u{fffd}");
    }
}
