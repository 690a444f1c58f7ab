//! Reads a settings file as a list of entries with line numbers.

use crate::Problem;
use protocol::parse_error::line_of;
use std::collections::BTreeMap;
use toml::Spanned;
use toml::de::{DeInteger, DeTable, DeValue};

/// A key with its value and position.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// Names of the enclosing tables, outermost first; empty at the top of the file.
    pub table: Vec<String>,
    /// The key, an option's long name.
    pub key: String,
    /// Its value.
    pub value: Value,
    /// Path of the file, for errors.
    pub file: String,
    /// Index of the file in the search path; the entry with the greater rank takes precedence.
    pub rank: usize,
    /// Line of the key, from 1.
    pub line: usize,
}

/// Value of a key. Numbers stay text, which the option's own parser reads.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Value {
    /// true or false.
    Truth(bool),
    /// A text or a number.
    Text(String),
    /// An array of texts or numbers.
    List(Vec<String>),
}

impl Entry {
    /// An error about this entry.
    pub fn problem(&self, text: impl std::fmt::Display) -> Problem {
        let place =
            if self.table.is_empty() { String::new() } else { format!("[{}] ", self.table.join(".")) };
        Problem {
            file: self.file.clone(),
            line: Some(self.line),
            text: format!("{place}{}: {text}", self.key),
        }
    }
}

impl std::fmt::Display for Value {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Value::Truth(truth) => write!(f, "{truth}"),
            Value::Text(text) => write!(f, "{}", quoted(text)),
            Value::List(texts) => {
                write!(f, "[{}]", texts.iter().map(|t| quoted(t)).collect::<Vec<_>>().join(", "))
            }
        }
    }
}

/// Formats a text as a TOML value; numbers are written without quotes.
pub fn quoted(text: &str) -> String {
    let digits = text.strip_prefix('-').unwrap_or(text);
    let whole = digits.parse::<u32>().is_ok_and(|n| n.to_string() == digits);
    let broken = digits.split_once('.').is_some_and(|(a, b)| {
        let all = |t: &str| !t.is_empty() && t.bytes().all(|c| c.is_ascii_digit());
        all(b) && all(a) && (a == "0" || !a.starts_with('0'))
    });
    if whole || broken { text.to_owned() } else { toml::Value::from(text).to_string() }
}

/// Parses the text of a file. `file` is its name in errors, `rank` its index in the search path.
///
/// # Errors
/// If the text is not valid TOML, or contains values that no option can take, such as dates or nested arrays.
pub fn read(text: &str, file: &str, rank: usize) -> Result<Vec<Entry>, Problem> {
    let root = DeTable::parse(text).map_err(|error| Problem {
        file: file.to_owned(),
        line: error.span().map(|at| line_of(text, at.start)),
        text: error.message().to_owned(),
    })?;
    let reader = Reader { text, file, rank };
    let mut entries = Vec::new();
    reader.table(root.get_ref(), &[], &mut entries)?;
    // The parser returns the keys of a table sorted; restore the order of the file.
    entries.sort_by_key(|e| e.line);
    Ok(entries)
}

struct Reader<'a> {
    text: &'a str,
    file: &'a str,
    rank: usize,
}

impl Reader<'_> {
    /// Adds a table's entries. The parser bounds its depth.
    fn table(&self, table: &DeTable<'_>, above: &[String], to: &mut Vec<Entry>) -> Result<(), Problem> {
        for (key, value) in table {
            let name = key.get_ref().to_string();
            if let DeValue::Table(inner) = value.get_ref() {
                let path = [above, &[name]].concat();
                self.table(inner, &path, to)?;
                continue;
            }
            let mut entry = Entry {
                table: above.to_vec(),
                key: name,
                value: Value::Truth(false),
                file: self.file.to_owned(),
                rank: self.rank,
                line: line_of(self.text, key.span().start),
            };
            entry.value = value_of(value).map_err(|expected| entry.problem(expected))?;
            to.push(entry);
        }
        Ok(())
    }
}

fn value_of(value: &Spanned<DeValue<'_>>) -> Result<Value, String> {
    match value.get_ref() {
        DeValue::Boolean(truth) => Ok(Value::Truth(*truth)),
        DeValue::Array(values) => {
            let each = |v: &Spanned<DeValue<'_>>| text_of(v.get_ref());
            Ok(Value::List(values.iter().map(each).collect::<Result<_, _>>()?))
        }
        other => text_of(other).map(Value::Text),
    }
}

fn text_of(value: &DeValue<'_>) -> Result<String, String> {
    match value {
        DeValue::String(text) => Ok(text.to_string()),
        DeValue::Integer(number) => integer(number),
        DeValue::Float(number) => Ok(number.as_str().to_owned()),
        other => Err(format!("expected a text, a number or true or false, found {}", other.type_str())),
    }
}

/// Converts a TOML integer of any radix to decimal digits.
fn integer(number: &DeInteger<'_>) -> Result<String, String> {
    let value = i128::from_str_radix(number.as_str(), number.radix());
    value.map(|v| v.to_string()).map_err(|_| format!("expected a smaller number, found {number}"))
}

/// For each table and key, the entry of the last file.
pub fn winners(entries: Vec<Entry>) -> Vec<Entry> {
    let mut last = BTreeMap::new();
    for entry in entries {
        last.insert((entry.table.clone(), entry.key.clone()), entry);
    }
    last.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn texts(text: &str) -> Vec<(String, String, String, usize)> {
        let entries = read(text, "f", 0).unwrap();
        entries.into_iter().map(|e| (e.table.join("."), e.key, e.value.to_string(), e.line)).collect()
    }

    #[test]
    fn every_key_has_its_table_and_line() {
        let text = "log = \"info\"\n\n[run]\nz = 1_000\na = 0x10\n[results.delete]\nk = [\"a\", 2]\nf = 1e3\nt = true\n";
        let expected = [
            ("", "log", "\"info\"", 1),
            ("run", "z", "1000", 4),
            ("run", "a", "16", 5),
            ("results.delete", "k", "[\"a\", 2]", 7),
            ("results.delete", "f", "\"1e3\"", 8),
            ("results.delete", "t", "true", 9),
        ];
        let expected = expected.map(|(t, k, v, l)| (t.to_owned(), k.to_owned(), v.to_owned(), l));
        assert_eq!(texts(text), expected);
    }

    #[test]
    fn what_is_no_setting_is_refused_with_its_line() {
        let told = |text: &str| read(text, "f.toml", 0).unwrap_err().to_string();
        assert!(
            told("[run]\n\nlevel = = 2\n").starts_with("f.toml: line 3: "),
            "{}",
            told("[run]\n\nlevel = = 2\n")
        );
        assert!(told("[run]\nlevel = 1\nlevel = 2\n").starts_with("f.toml: line 3: "));
        let date = told("[run]\nscene = 2026-01-01\n");
        assert!(date.contains("line 2: [run] scene: expected a text") && date.contains("datetime"), "{date}");
        assert!(told("[[run]]\nlevel = 1\n").contains("run: expected a text"));
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused_within_its_lines(text in "(\\PC|\n|=|\\[|\\]|\"|#){0,80}") {
            let lines = text.lines().count().max(1);
            match read(&text, "f", 0) {
                Ok(entries) => prop_assert!(entries.iter().all(|e| (1..=lines).contains(&e.line))),
                Err(problem) => prop_assert!(problem.line.is_none_or(|l| (1..=lines + 1).contains(&l))),
            }
        }

        #[test]
        fn what_is_written_is_read_again(key in "[a-z][a-z-]{0,9}", text in "\\PC{0,20}", n in any::<i64>(), t in any::<bool>()) {
            let file = format!("[run]\n{key} = {}\nN = {n}\nT = {t}\n", quoted(&text));
            let entries = read(&file, "f", 0).unwrap();
            let values: Vec<Value> = entries.into_iter().map(|e| e.value).collect();
            prop_assert_eq!(values, vec![Value::Text(text), Value::Text(n.to_string()), Value::Truth(t)]);
        }

        #[test]
        fn bytes_as_a_file_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            if let Ok(text) = String::from_utf8(bytes) {
                let _ = read(&text, "f", 0);
            }
        }
    }
}
