//! Point lists: where a camera saw a known point.
//!
//! | form | a line or entry |
//! |---|---|
//! | CSV | header `x,y,X,Y,Z` (px, px, mm, mm, mm) in any order, optionally `view`; then a row a point |
//! | JSON | `[{"x":…,"y":…,"X":…,"Y":…,"Z":…,"view":…}, …]` |
//! | columns | `x y X Y Z`, separated by blanks, no header (as MyPTV writes its `cal_points`) |
//!
//! Points of one view (any text; the same for all where it is not given) lie on one target in one
//! place.

use crate::target_problem::Correspondence;
use anyhow::{Context, Result, anyhow, bail, ensure};
use nalgebra::{Point3, Vector2};
use protocol::file::{MAX_TABLE_BYTES, StringRecord, read_bytes, rows};
use protocol::parse_error;
use serde::Deserialize;
use std::path::Path;

/// Points of one view.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Its name; empty where the list has none.
    pub name: String,
    /// In the order of the list.
    pub samples: Vec<Correspondence>,
    /// Line of each sample in the file, from 1; in JSON, the number of its entry.
    pub lines: Vec<usize>,
    /// What `lines` counts: `line` or `entry`.
    pub counted: &'static str,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    x: f64,
    y: f64,
    #[serde(rename = "X")]
    big_x: f64,
    #[serde(rename = "Y")]
    big_y: f64,
    #[serde(rename = "Z")]
    big_z: f64,
    #[serde(default)]
    view: serde_json::Value,
}

/// The numbers of a row, in this order.
const KEYS: [&str; 5] = ["x", "y", "X", "Y", "Z"];
/// Larger numbers are a mistake: no sensor and no rig is that large.
const LARGEST: f64 = 1e6;

fn read(path: &Path) -> Result<String> {
    let text =
        read_bytes(path, MAX_TABLE_BYTES).map_err(|e| anyhow!("point list {}: {e}", path.display()))?;
    Ok(String::from_utf8_lossy(&text).into_owned())
}

/// Reads a point list.
///
/// # Errors
/// A file that cannot be read; otherwise as [`parse`].
pub fn load(path: &Path) -> Result<Vec<View>> {
    parse(&read(path)?, &path.display().to_string())
}

/// Reads the dots of a target: three columns `X Y Z`, mm, separated by blanks or commas.
///
/// # Errors
/// A file that cannot be read; otherwise as [`parse_target`].
pub fn load_target(path: &Path) -> Result<Vec<Point3<f64>>> {
    parse_target(&read(path)?, &path.display().to_string())
}

/// Parses the text of a target; `file` is for messages.
///
/// # Errors
/// A line that does not hold three numbers within range, or a text without dots.
pub fn parse_target(text: &str, file: &str) -> Result<Vec<Point3<f64>>> {
    let dot = |(line, text): (usize, &str)| {
        let place = format!("{file}, line {line}");
        let fields = text.split([',', ' ', '\t']).filter(|f| !f.is_empty());
        Ok(Point3::from(columns(fields, [KEYS[2], KEYS[3], KEYS[4]], &place)?))
    };
    let dots = lines(text).map(dot).collect::<Result<Vec<_>>>()?;
    ensure!(!dots.is_empty(), "point list {file}: expected points, found none");
    Ok(dots)
}

/// Parses the text of a point list; `file` is for messages.
///
/// # Errors
/// A line or entry that does not hold a point, or a text without points.
pub fn parse(text: &str, file: &str) -> Result<Vec<View>> {
    let text = text.trim_start_matches('\u{feff}');
    let (rows, counted) = match text.trim_start().chars().next() {
        Some('[' | '{') => (json(text, file)?, "entry"),
        Some(c) if c.is_alphabetic() => (csv(text, file)?, "line"),
        _ => (table(text, file)?, "line"),
    };
    let mut views: Vec<View> = Vec::new();
    for Row { view: name, numbers: [x, y, a, b, c], line } in rows {
        let sample = Correspondence { pixel: Vector2::new(x, y), point: Point3::new(a, b, c) };
        match views.iter_mut().find(|v| v.name == name) {
            Some(view) => {
                view.samples.push(sample);
                view.lines.push(line);
            }
            None => views.push(View { name, samples: vec![sample], lines: vec![line], counted }),
        }
    }
    ensure!(!views.is_empty(), "point list {file}: expected points, found none");
    Ok(views)
}

/// A point of a list, and its view.
struct Row {
    view: String,
    /// In the order of [`KEYS`].
    numbers: [f64; 5],
    /// Its line, or its entry in JSON.
    line: usize,
}

/// Refuses numbers out of range; `place` is the file with the line or entry.
fn checked<const N: usize>(numbers: [f64; N], keys: [&str; N], place: &str) -> Result<[f64; N]> {
    for (key, v) in keys.iter().zip(numbers) {
        let sane = v.is_finite() && v.abs() <= LARGEST;
        ensure!(sane, "point list {place}: {key}: expected a number within ±1e6, found {v}");
    }
    Ok(numbers)
}

/// The numbers in the fields of a line.
fn numbers<const N: usize>(fields: [&str; N], keys: [&str; N], place: &str) -> Result<[f64; N]> {
    let mut numbers = [0.0; N];
    for ((slot, field), key) in numbers.iter_mut().zip(fields).zip(keys) {
        *slot = field.trim().parse().map_err(|_| {
            let shown: String = field.trim().chars().take(40).collect();
            anyhow!("point list {place}: {key}: expected a number, found “{shown}”")
        })?;
    }
    checked(numbers, keys, place)
}

/// The numbers of a line that has nothing but them.
fn columns<'a, const N: usize>(
    fields: impl Iterator<Item = &'a str>,
    keys: [&str; N],
    place: &str,
) -> Result<[f64; N]> {
    let fields: [&str; N] = fields.collect::<Vec<_>>().try_into().map_err(|found: Vec<&str>| {
        let (names, found) = (keys.join(" "), found.len());
        anyhow!("point list {place}: expected {N} numbers {names}, found {found}")
    })?;
    numbers(fields, keys, place)
}

fn json(text: &str, file: &str) -> Result<Vec<Row>> {
    let entries: Vec<Entry> =
        serde_json::from_str(text).map_err(|e| anyhow!("point list {file}, {}", parse_error::json(&e)))?;
    let row = |(i, e): (usize, Entry)| {
        let place = format!("{file}, entry {}", i + 1);
        let view = match e.view {
            serde_json::Value::Null => String::new(),
            serde_json::Value::String(name) => name,
            serde_json::Value::Number(n) => n.to_string(),
            other => bail!("point list {place}: view: expected a text or a number, found {other}"),
        };
        let numbers = checked([e.x, e.y, e.big_x, e.big_y, e.big_z], KEYS, &place)?;
        Ok(Row { view, numbers, line: i + 1 })
    };
    entries.into_iter().enumerate().map(row).collect()
}

/// Lines with their number from 1, without blank ones and comments.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let trimmed = text.lines().enumerate().map(|(i, l)| (i + 1, l.trim()));
    trimmed.filter(|(_, l)| !l.is_empty() && !l.starts_with('#'))
}

fn csv(text: &str, file: &str) -> Result<Vec<Row>> {
    let mut rest = rows(text).filter(|(_, row)| !row[0].starts_with('#'));
    let header = rest.next();
    let (at, names) = header.with_context(|| format!("point list {file}: expected points, found none"))?;
    let column = |key: &str| names.iter().position(|n| n == key);
    let mut order = [0; 5];
    for (slot, key) in order.iter_mut().zip(KEYS) {
        *slot = column(key).with_context(|| {
            format!(
                "point list {file}, line {at}: expected a column {key} (x,y in px; X,Y,Z in mm; optionally view)"
            )
        })?;
    }
    let view = column("view");
    let row = |(line, cells): (usize, StringRecord)| {
        let place = format!("{file}, line {line}");
        let (expected, found) = (names.len(), cells.len());
        ensure!(found == expected, "point list {place}: expected {expected} fields, found {found}");
        let numbers = numbers(order.map(|at| &cells[at]), KEYS, &place)?;
        Ok(Row { view: view.map_or("", |v| &cells[v]).into(), numbers, line })
    };
    rest.map(row).collect()
}

/// Rows of numbers separated by blanks.
fn table(text: &str, file: &str) -> Result<Vec<Row>> {
    let row = |(line, text): (usize, &str)| {
        let numbers = columns(text.split_whitespace(), KEYS, &format!("{file}, line {line}"))?;
        Ok(Row { view: String::new(), numbers, line })
    };
    lines(text).map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn three_forms_say_the_same() {
        let by_columns = parse("1.5 2.5 3 4 -5\n\n6 7 8 9 10\n", "f").unwrap();
        let by_csv = parse("\u{feff}X,Y,Z,x,y\n3,4,-5,1.5,2.5\n8,9,10,6,7\n", "f").unwrap();
        let by_json =
            parse(r#"[{"x":1.5,"y":2.5,"X":3,"Y":4,"Z":-5},{"x":6,"y":7,"X":8,"Y":9,"Z":10}]"#, "f").unwrap();
        assert_eq!(by_columns[0].samples, by_csv[0].samples);
        assert_eq!(by_columns[0].samples, by_json[0].samples);
        // Blank lines and the header count as lines, and entries from 1.
        let places = |views: &[View]| (views[0].counted, views[0].lines.clone());
        assert_eq!(places(&by_columns), ("line", vec![1, 3]));
        assert_eq!(places(&by_csv), ("line", vec![2, 3]));
        assert_eq!(places(&by_json), ("entry", vec![1, 2]));
        assert_eq!(by_columns[0].samples[1].point, Point3::new(8.0, 9.0, 10.0));
    }

    #[test]
    fn views_are_kept_apart() {
        let views = parse("view,x,y,X,Y,Z\na,1,1,0,0,0\nb,2,2,0,0,0\na,3,3,1,0,0\n", "f").unwrap();
        let told: Vec<_> = views.iter().map(|v| (v.name.as_str(), v.samples.len())).collect();
        assert_eq!(told, [("a", 2), ("b", 1)]);
        let views = parse(r#"[{"x":1,"y":1,"X":0,"Y":0,"Z":0,"view":7}]"#, "f").unwrap();
        assert_eq!(views[0].name, "7");
    }

    #[test]
    fn defects_are_named_with_their_place() {
        let cases = [
            ("", "found none"),
            ("x,y,X,Y\n1,2,3,4\n", "expected a column Z"),
            ("x,y,X,Y,Z\n1,2,3,4,5\n1,2,3,4\n", "line 3: expected 5 fields, found 4"),
            ("x,y,X,Y,Z\n1,2,three,4,5\n", "line 2: X: expected a number, found “three”"),
            ("1 2 3 4\n", "line 1: expected 5 numbers x y X Y Z, found 4"),
            ("1 2 3 4 NaN\n", "line 1: Z: expected a number within"),
            ("1 2 3 4 1e99\n", "Z: expected a number within"),
            ("[{\"x\":1}]", "line 1"),
            ("[{\"x\":1,\"y\":1,\"X\":0,\"Y\":0,\"Z\":0,\"view\":[]}]", "entry 1: view"),
            ("{\"points\":[]}", "line 1"),
        ];
        for (text, named) in cases {
            let error = parse(text, "p.txt").unwrap_err().to_string();
            assert!(error.contains("p.txt") && error.contains(named), "{text:?}: {error}");
        }
    }

    #[test]
    fn targets_are_three_columns() {
        assert_eq!(parse_target("0 3.0\t-6\n# x\n1,2,3\n", "t").unwrap()[1], Point3::new(1.0, 2.0, 3.0));
        for (text, named) in
            [("1 2\n", "line 1: expected 3 numbers"), ("1 2 c\n", "Z: expected"), ("", "found none")]
        {
            let error = parse_target(text, "t.txt").unwrap_err().to_string();
            assert!(error.contains("t.txt") && error.contains(named), "{error}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_parsed_or_refused(text in "([-xyXYZ0-9.,e \\[{}\":\n]|\\PC){0,120}") {
            let _ = parse_target(&text, "f");
            if let Ok(views) = parse(&text, "f") {
                prop_assert!(views.iter().flat_map(|v| &v.samples).all(|s| s.pixel.norm().is_finite()));
            }
        }

        #[test]
        fn numbers_survive(rows in prop::collection::vec(prop::array::uniform5(-1e5..1e5f64), 1..20)) {
            let text: String = rows.iter().map(|[a, b, c, d, e]| format!("{a} {b}\t{c} {d} {e}\n")).collect();
            let views = parse(&text, "f").unwrap();
            for (sample, row) in views[0].samples.iter().zip(&rows) {
                prop_assert_eq!([sample.pixel.x, sample.pixel.y, sample.point.x, sample.point.y, sample.point.z], *row);
            }
        }
    }
}
