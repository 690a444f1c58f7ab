//! Words of suggested commands, as a shell reads them.

use std::fmt::Display;

/// Punctuation that no shell interprets within a word.
const PLAIN: &str = "_-+.,:/@%=";

/// A path or another argument for a command that a message suggests: in single quotes if a shell would split or interpret it
/// otherwise, so that the command can be copied.
pub fn shell_word(word: impl Display) -> String {
    let word = word.to_string();
    let is_plain = |c: char| c.is_alphanumeric() || PLAIN.contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        return word;
    }
    // Nothing can be escaped within single quotes, so a quote is written between two quoted parts.
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use std::process::Command;

    #[test]
    fn only_what_a_shell_would_interpret_is_quoted() {
        for plain in ["rig.json", "/a/b-2_c.mcap", "igtl:host:18944,map.toml", "serial:/dev/ttyUSB0", "Größe"]
        {
            assert_eq!(shell_word(plain), plain);
        }
        assert_eq!(shell_word(Path::new("bad rig.json").display()), "'bad rig.json'");
        assert_eq!(shell_word("it's"), r"'it'\''s'");
        assert_eq!(shell_word(""), "''");
    }

    #[test]
    fn a_shell_reads_back_the_same_word() {
        for word in
            ["bad rig.json", "it's", "a&b;c", "$HOME", "`id`", "~", "a\\b", "*?[x]", "#1", "\"q\"", ""]
        {
            let command = format!("printf %s {}", shell_word(word));
            let said = Command::new("sh").args(["-c", &command]).output().unwrap().stdout;
            assert_eq!(String::from_utf8(said).unwrap(), word);
        }
    }
}
