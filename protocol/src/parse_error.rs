//! Errors of the TOML and JSON parsers in the words of this project's own messages: the line first, then what was
//! expected and what was found, with keys named as such.

use std::fmt::Display;

/// The line, the key and the message of a TOML error, such as `line 3: size: expected a number, found "x"`.
pub fn toml(text: &str, error: &toml::de::Error) -> String {
    let message = in_words(error.message());
    let Some(at) = error.span() else { return message };
    let line = line_of(text, at.start);
    let key = text.lines().nth(line - 1).and_then(key_of).filter(|_| message.starts_with("expected "));
    let key = key.map_or(String::new(), |key| format!("{key}: "));
    format!("line {line}: {key}{message}")
}

/// The line of a byte of a text, from 1.
pub fn line_of(text: &str, at: usize) -> usize {
    1 + text.as_bytes().iter().take(at).filter(|b| **b == b'\n').count()
}

/// The key of a line `key = value`.
fn key_of(line: &str) -> Option<&str> {
    let key = line.split_once('=')?.0.trim();
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
    (!key.is_empty() && key.chars().all(is_plain)).then_some(key)
}

/// The same of an error of `serde_json`, which ends in ` at line 3 column 7`.
pub fn json(error: &impl Display) -> String {
    let (message, place) = json_parts(error);
    let line_and_column = place.split_once(" column ");
    match line_and_column {
        Some((line, column)) => format!("line {line}, column {column}: {message}"),
        None => message,
    }
}

/// The message of an error of `serde_json` without its place, for texts of one line.
pub fn json_message(error: &impl Display) -> String {
    json_parts(error).0
}

fn json_parts(error: &impl Display) -> (String, String) {
    let text = error.to_string();
    let (message, place) = text.rsplit_once(" at line ").unwrap_or((&text, ""));
    (in_words(message), place.to_owned())
}

/// A message of serde in plain words; one of another kind only loses its backticks.
fn in_words(message: &str) -> String {
    let expected_found = |rest: &str, of_found: &dyn Fn(&str) -> String| {
        let (found, expected) = rest.split_once(", expected ")?;
        Some(format!("expected {}, found {}", expected_value(expected), of_found(found)))
    };
    let strip = |prefix: &str| message.strip_prefix(prefix);
    let known = strip("unknown field ")
        .map(|rest| format!("unknown key {}", rest.replacen(", expected", "; expected", 1)))
        .or_else(|| strip("missing field ").map(|key| format!("missing key {key}")))
        .or_else(|| (message == "trailing characters").then(|| "more than was expected".to_owned()))
        .or_else(|| strip("duplicate field ").map(|key| format!("the key {key} occurs twice")))
        .or_else(|| expected_found(strip("unknown variant ")?, &|found| found.to_owned()))
        .or_else(|| expected_found(strip("invalid type: ")?, &found_value))
        .or_else(|| expected_found(strip("invalid value: ")?, &found_value))
        .or_else(|| {
            expected_found(strip("invalid length ")?, &|found| match found {
                "1" => "1 value".into(),
                _ => format!("{found} values"),
            })
        });
    known.unwrap_or_else(|| message.trim_end().to_owned()).replace('`', "")
}

/// What serde expects: names of Rust types mean nothing to the author of a file.
fn expected_value(name: &str) -> String {
    let plain = match name {
        "f32" | "f64" => "a number",
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number from 0 on",
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number",
        "a string" | "a borrowed string" => "a text in quotes",
        "a boolean" => "true or false",
        "a sequence" => "a list in brackets",
        "a map" => "keys with values",
        _ if name.starts_with("struct ") => "keys with values",
        _ => {
            let length = name.strip_prefix("an array of length ").or(name.strip_prefix("a tuple of size "));
            return length.map_or(name.to_owned(), |n| format!("a list of {n} values"));
        }
    };
    plain.to_owned()
}

fn found_value(found: &str) -> String {
    let kinds = ["string ", "integer ", "floating point ", "boolean "];
    let value = kinds.iter().find_map(|kind| found.strip_prefix(kind));
    let list = match found {
        "sequence" => "a list",
        "map" => "keys with values",
        other => other,
    };
    value.unwrap_or(list).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde::Deserialize;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "only read")]
    struct File {
        title: String,
        size: [f64; 2],
        count: Option<u32>,
        kind: Option<Kind>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(rename_all = "lowercase")]
    enum Kind {
        Red,
        Blue,
    }

    #[test]
    fn line_key_and_expected_value_are_named() {
        let cases = [
            ("title = 'a'\nsise = 3\n", "line 2: unknown key sise; expected one of title, size, count, kind"),
            ("title = 'a'\n", "line 1: missing key size"),
            ("size = [1, 2]\ntitle = 5\n", "line 2: title: expected a text in quotes, found 5"),
            ("title = 'a'\nsize = 'x'\n", "line 2: size: expected a list of 2 values, found \"x\""),
            ("title = 'a'\nsize = [1]\n", "line 2: size: expected a list of 2 values, found 1 value"),
            ("title = 'a'\nsize = [1, 'b']\n", "line 2: size: expected a number, found \"b\""),
            (
                "title = 'a'\nsize = [1, 2]\ncount = -1\n",
                "line 3: count: expected a whole number from 0 on, found -1",
            ),
            ("title = 'a'\nsize = [1, 2]\nkind = 'pink'\n", "line 3: kind: expected red or blue, found pink"),
            ("title = 'a'\ntitle = 'b'\n", "line 2: duplicate key"),
            ("title = [\n", "line 1: unclosed array, expected ]"),
        ];
        for (text, expected) in cases {
            let error = ::toml::from_str::<File>(text).unwrap_err();
            assert_eq!(toml(text, &error), expected, "{text}");
        }
    }

    #[test]
    fn places_of_json_come_first() {
        let of = |text: &str| json(&serde_json::from_str::<File>(text).unwrap_err());
        assert_eq!(
            of("{\n \"units\": 5}"),
            "line 2, column 8: unknown key units; expected one of title, size, count, kind"
        );
        assert_eq!(of("{\"title\": 5}"), "line 1, column 11: expected a text in quotes, found 5");
        assert_eq!(
            of("{\"title\": \"a\", \"size\": [1, 2, 3]}"),
            "line 1, column 31: more than was expected"
        );
        let error = serde_json::from_str::<File>("{").unwrap_err();
        assert_eq!(json_message(&error), "EOF while parsing an object");
    }

    proptest! {
        #[test]
        fn every_message_stays_one_line_that_says_something(text in "\\PC{0,60}") {
            if let Err(error) = ::toml::from_str::<File>(&text) {
                prop_assert!(!toml(&text, &error).trim().is_empty());
            }
            if let Err(error) = serde_json::from_str::<File>(&text) {
                prop_assert!(json(&error).starts_with("line "), "{}", error);
            }
            prop_assert!(!in_words(&text).contains('`'));
        }
    }
}
