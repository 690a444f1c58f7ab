//! Blob streams (`blobs.jsonl`), for exchange with other tools: one camera-field a line,
//! `{"cam","seq","t_ns","t_rx_ns","parity","blobs":[{"x","y","area","colour","w","h"}…]}`.
//!
//! `t_ns` is mid-exposure and becomes `exposed_ns`; `t_rx_ns` is when the field was received and
//! becomes `blobs_out_ns`; `x y` are px of the frame's columns and lines of the field. A blob may
//! carry `var_x`, `var_y`, `cov_xy` (px² of the frame) and `flags`. Unknown keys are refused. A
//! file may hold more blobs a field than a [`BlobField`] ([`write_blobs`]), and lines without any,
//! which give number and exposure of a field only ([`HeadReader`]).

pub mod live;
pub mod poses_csv;

use bytemuck::Zeroable;
use protocol::blobs::{Blob, BlobField, Colour, DEFAULT_VARIANCE_PX2, WHOLE_FRAME};
use protocol::file::looks_like;
use protocol::file::open;
use protocol::limits::MAX_CAMERAS;
use protocol::parse_error;
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

/// Longest line read, bytes; 10,000 blobs with every key take about 2 MiB.
const MAX_LINE_BYTES: u64 = 16 << 20;

/// Why a blob stream was refused.
#[derive(Debug, thiserror::Error)]
pub enum BlobStreamError {
    /// The file cannot be read.
    #[error("blob stream {file}: {}", in_words(source))]
    Read {
        /// The file.
        file: String,
        /// Why.
        source: std::io::Error,
    },
    /// A line makes no sense.
    #[error("blob stream {file}, line {line}: {problem}")]
    Line {
        /// The file.
        file: String,
        /// Counted from 1.
        line: u64,
        /// What was expected and what was found.
        problem: String,
    },
}

fn in_words(source: &std::io::Error) -> String {
    match source.kind() {
        std::io::ErrorKind::InvalidData => "expected lines of JSON, found a binary file".into(),
        _ => source.to_string(),
    }
}

/// Number and instants of a camera-field: a line without its blobs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FieldHead {
    /// Camera id.
    pub cam: u32,
    /// Field number of this camera.
    pub seq: u64,
    /// Middle of the exposure.
    pub t_ns: u64,
    /// When it was received.
    pub t_rx_ns: u64,
    /// 0: even lines of the frame, 1: odd lines.
    pub parity: u32,
}

/// A line with its blobs; with `B` as `Option<IgnoredAny>` they are skipped and may be absent.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FieldLine<B> {
    cam: u32,
    seq: u64,
    t_ns: u64,
    t_rx_ns: u64,
    parity: u32,
    blobs: B,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct BlobLine {
    x: f64,
    y: f64,
    area: f64,
    colour: Colour,
    w: f64,
    h: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    var_x: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    var_y: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cov_xy: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    flags: Option<u32>,
}

impl BlobLine {
    fn defect(&self) -> Option<(&'static str, &'static str, f64)> {
        let var_x = self.var_x.unwrap_or(DEFAULT_VARIANCE_PX2);
        let var_y = self.var_y.unwrap_or(DEFAULT_VARIANCE_PX2);
        let cov = self.cov_xy.unwrap_or(0.0);
        let positive = |v: f64| v.is_finite() && v > 0.0;
        let not_negative = |v: f64| v.is_finite() && v >= 0.0;
        [
            ("x", "a finite number", self.x, self.x.is_finite()),
            ("y", "a finite number", self.y, self.y.is_finite()),
            ("area", "0 or more", self.area, not_negative(self.area)),
            ("w", "0 or more", self.w, not_negative(self.w)),
            ("h", "0 or more", self.h, not_negative(self.h)),
            ("var_x", "more than 0", var_x, positive(var_x)),
            ("var_y", "more than 0", var_y, positive(var_y)),
            ("cov_xy", "cov_xy² at most var_x·var_y", cov, cov * cov <= var_x * var_y),
        ]
        .into_iter()
        .find_map(|(key, expected, found, holds)| (!holds).then_some((key, expected, found)))
    }

    fn blob(&self) -> Blob {
        Blob {
            x_px: self.x,
            y_field_px: self.y,
            area_px: self.area,
            width_px: self.w,
            height_px: self.h,
            var_x_px2: self.var_x.unwrap_or(DEFAULT_VARIANCE_PX2),
            var_y_px2: self.var_y.unwrap_or(DEFAULT_VARIANCE_PX2),
            cov_xy_px2: self.cov_xy.unwrap_or(0.0),
            colour: self.colour as u32,
            flags: self.flags.unwrap_or(0),
        }
    }

    fn from_blob(blob: &Blob) -> Option<Self> {
        let unless = |value: f64, usual: f64| (value != usual).then_some(value);
        Some(BlobLine {
            x: blob.x_px,
            y: blob.y_field_px,
            area: blob.area_px,
            colour: Colour::from_wire(blob.colour)?,
            w: blob.width_px,
            h: blob.height_px,
            var_x: unless(blob.var_x_px2, DEFAULT_VARIANCE_PX2),
            var_y: unless(blob.var_y_px2, DEFAULT_VARIANCE_PX2),
            cov_xy: unless(blob.cov_xy_px2, 0.0),
            flags: (blob.flags != 0).then_some(blob.flags),
        })
    }
}

/// Parses one line. Blobs beyond the capacity are counted in `blobs_left_out`; `read_out_ns` is 0,
/// because a stream does not hold it. `file` and `line_no` (from 1) are for error messages.
///
/// # Errors
/// Where the line is no camera-field, has an unknown key, or a number that makes no sense.
pub fn parse_line(text: &str, file: &str, line_no: u64) -> Result<BlobField, BlobStreamError> {
    let (head, blobs): (_, Vec<BlobLine>) = parse(text, file, line_no)?;
    let mut field = BlobField::zeroed();
    (field.camera, field.field, field.parity) = (head.cam, head.seq, head.parity);
    (field.exposed_ns, field.blobs_out_ns) = (head.t_ns, head.t_rx_ns);
    for (i, blob) in blobs.iter().enumerate() {
        if let Some((key, expected, found)) = blob.defect() {
            let problem = format!("blobs[{i}].{key}: expected {expected}, found {found}");
            return Err(BlobStreamError::Line { file: file.into(), line: line_no, problem });
        }
        field.push(blob.blob());
    }
    Ok(field)
}

/// Head and blobs of a line.
fn parse<B: DeserializeOwned>(text: &str, file: &str, line: u64) -> Result<(FieldHead, B), BlobStreamError> {
    let refuse = |problem: String| BlobStreamError::Line { file: file.into(), line, problem };
    let parsed = serde_json::from_str(text).map_err(|e| refuse(mismatch(text, &e)))?;
    let FieldLine { cam, seq, t_ns, t_rx_ns, parity, blobs } = parsed;
    let head = FieldHead { cam, seq, t_ns, t_rx_ns, parity };
    check_head(&head).map_err(refuse)?;
    Ok((head, blobs))
}

/// What is wrong with a line's own numbers.
fn check_head(head: &FieldHead) -> Result<(), String> {
    let defect = [
        (head.cam as usize >= MAX_CAMERAS, "cam", "0 to 7", u64::from(head.cam)),
        (head.parity > WHOLE_FRAME, "parity", "0, 1 or 2 (whole frames)", u64::from(head.parity)),
        (head.t_ns == 0, "t_ns", "an instant above 0", 0),
    ];
    match defect.into_iter().find(|d| d.0) {
        Some((_, key, expected, found)) => Err(format!("{key}: expected {expected}, found {found}")),
        None => Ok(()),
    }
}

/// Parses the head of a line; its blobs, if it has any, are skipped.
///
/// # Errors
/// Where the line is no camera-field, or a number of its head makes no sense.
pub fn parse_head(text: &str, file: &str, line_no: u64) -> Result<FieldHead, BlobStreamError> {
    parse::<Option<IgnoredAny>>(text, file, line_no).map(|(head, _)| head)
}

/// Why a text is no line of a stream: what it looks like, or the parser's own words.
fn mismatch(text: &str, error: &serde_json::Error) -> String {
    if text.starts_with('{') {
        return in_columns(error);
    }
    let found = looks_like(text.as_bytes());
    format!("expected one camera-field in JSON, which begins with {{, found {found}")
}

/// The parser counts lines of its own text, which is always the first; only the column helps.
fn in_columns(error: &serde_json::Error) -> String {
    format!("column {}: {}", error.column(), parse_error::json_message(error))
}

/// A camera-field as one line, without the line's end; [`parse_line`] gives back the same field but
/// for `read_out_ns` and the count of blobs left out. Blobs of no known colour or with numbers that
/// are not finite (neither passes validation) are left out.
pub fn write_line(field: &BlobField) -> String {
    let head = FieldHead {
        cam: field.camera,
        seq: field.field,
        t_ns: field.exposed_ns,
        t_rx_ns: field.blobs_out_ns,
        parity: field.parity,
    };
    write_blobs(&head, field.blobs())
}

/// As [`write_line`], for any number of blobs: the capacity of a [`BlobField`] does not bind files.
pub fn write_blobs(head: &FieldHead, blobs: &[Blob]) -> String {
    let finite = |b: &&Blob| {
        let numbers = [b.x_px, b.y_field_px, b.area_px, b.width_px, b.height_px];
        let variances = [b.var_x_px2, b.var_y_px2, b.cov_xy_px2];
        protocol::message::all_finite(&numbers) && protocol::message::all_finite(&variances)
    };
    let FieldHead { cam, seq, t_ns, t_rx_ns, parity } = *head;
    let blobs: Vec<_> = blobs.iter().filter(finite).filter_map(BlobLine::from_blob).collect();
    let line = FieldLine { cam, seq, t_ns, t_rx_ns, parity, blobs };
    serde_json::to_string(&line).expect("numbers and names only")
}

/// Reads a file line by line, parsed as `T`; blank lines are skipped.
pub struct LineReader<T> {
    file: String,
    lines: BufReader<File>,
    text: String,
    line_no: u64,
    ended: bool,
    parse: fn(&str, &str, u64) -> Result<T, BlobStreamError>,
}

/// Reads a blob stream field by field.
pub type BlobReader = LineReader<BlobField>;

/// Reads the heads of a list of fields (`fields.jsonl`, or a blob stream).
pub type HeadReader = LineReader<FieldHead>;

impl BlobReader {
    /// Opens a stream.
    ///
    /// # Errors
    /// Where the file cannot be opened.
    pub fn open(path: &Path) -> Result<Self, BlobStreamError> {
        Self::new(path, parse_line)
    }
}

impl HeadReader {
    /// Opens a list of fields.
    ///
    /// # Errors
    /// Where the file cannot be opened.
    pub fn open(path: &Path) -> Result<Self, BlobStreamError> {
        Self::new(path, parse_head)
    }
}

impl<T> LineReader<T> {
    fn new(
        path: &Path,
        parse: fn(&str, &str, u64) -> Result<T, BlobStreamError>,
    ) -> Result<Self, BlobStreamError> {
        let file = path.display().to_string();
        let opened = open(path).map_err(|source| BlobStreamError::Read { file: file.clone(), source })?;
        let lines = opened;
        Ok(LineReader { file, lines, text: String::new(), line_no: 0, ended: false, parse })
    }

    /// Number of the line that was read last, from 1.
    pub fn line_no(&self) -> u64 {
        self.line_no
    }

    /// Fills `text` with the next line; false at the end of the file.
    fn read(&mut self) -> Result<bool, BlobStreamError> {
        self.text.clear();
        self.line_no += 1;
        let read = self.lines.by_ref().take(MAX_LINE_BYTES).read_line(&mut self.text);
        let bytes = read.map_err(|source| BlobStreamError::Read { file: self.file.clone(), source })? as u64;
        if bytes == MAX_LINE_BYTES && !self.text.ends_with('\n') {
            let problem = format!("expected at most {MAX_LINE_BYTES} bytes in a line, found more");
            return Err(BlobStreamError::Line { file: self.file.clone(), line: self.line_no, problem });
        }
        Ok(bytes > 0)
    }
}

impl<T> Iterator for LineReader<T> {
    type Item = Result<T, BlobStreamError>;

    /// The next line, parsed; `None` at the end and after the file could not be read.
    fn next(&mut self) -> Option<Self::Item> {
        while !self.ended {
            match self.read() {
                Err(error) => {
                    self.ended = true;
                    return Some(Err(error));
                }
                Ok(false) => self.ended = true,
                Ok(true) if self.text.trim().is_empty() => {}
                Ok(true) => return Some((self.parse)(self.text.trim(), &self.file, self.line_no)),
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use protocol::limits::MAX_BLOBS;
    use protocol::message::Message;

    const LINE: &str = r#"{"cam":1,"seq":7,"t_ns":48051108,"t_rx_ns":72069517,"parity":1,"blobs":[{"x":334.0381,"y":31.5307,"area":185.8,"colour":"red","w":20.5,"h":11.2},{"x":2.5,"y":1.0,"area":9.0,"colour":"white","w":3.0,"h":3.0,"var_x":0.01,"var_y":0.02,"cov_xy":-0.001,"flags":2}]}"#;

    #[test]
    fn the_page_lists_every_key_and_its_example_is_a_line() {
        let page = include_str!("../../../../docs/blob-stream.md");
        let whole = Blob {
            var_x_px2: 0.01,
            var_y_px2: 0.02,
            cov_xy_px2: 0.001,
            flags: 1,
            ..parse_line(LINE, "b.jsonl", 1).unwrap().blobs()[0]
        };
        let line = serde_json::to_value(FieldLine {
            cam: 0,
            seq: 1,
            t_ns: 2,
            t_rx_ns: 3,
            parity: 0,
            blobs: vec![BlobLine::from_blob(&whole).unwrap()],
        });
        let line = line.unwrap();
        let keys = |value: &serde_json::Value| value.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
        let all = [keys(&line), keys(&line["blobs"][0])].concat();
        assert_eq!(all.len(), 16);
        for key in all {
            assert!(page.contains(&format!("| `{key}` |")), "docs/blob-stream.md lacks {key}");
        }
        let example = page.lines().map(str::trim).find(|line| line.starts_with('{')).unwrap();
        let field = parse_line(example, "docs/blob-stream.md", 1).unwrap();
        assert_eq!((field.count, field.blobs()[0].colour), (1, Colour::Red as u32));
    }

    #[test]
    fn line_is_read_and_written_back_the_same() {
        let field = parse_line(LINE, "b.jsonl", 1).unwrap();
        assert_eq!((field.camera, field.field, field.parity, field.count), (1, 7, 1, 2));
        assert_eq!((field.exposed_ns, field.blobs_out_ns), (48_051_108, 72_069_517));
        assert_eq!(field.blobs()[0].var_y_px2, DEFAULT_VARIANCE_PX2);
        assert_eq!(field.blobs()[1].cov_xy_px2, -0.001);
        assert_eq!(write_line(&field), LINE);
    }

    #[test]
    fn defects_are_named_with_file_and_line() {
        let cases = [
            ("\"parity\":1", "\"parity\":3", "parity: expected 0, 1 or 2 (whole frames), found 3"),
            ("\"cam\":1", "\"cam\":8", "cam: expected 0 to 7, found 8"),
            ("\"t_ns\":48051108", "\"t_ns\":-4", "expected a whole number from 0 on, found -4"),
            ("\"t_ns\":48051108", "\"t_ns\":0", "t_ns"),
            ("\"seq\"", "\"sequence\"", "unknown key sequence"),
            ("\"red\"", "\"pink\"", "found pink"),
            ("\"x\":2.5", "\"x\":1e999", "number out of range"),
            ("\"x\":2.5", "\"x\":NaN", "column"),
            ("\"var_x\":0.01", "\"var_x\":-0.01", "blobs[1].var_x"),
            ("\"cov_xy\":-0.001", "\"cov_xy\":0.1", "blobs[1].cov_xy"),
            ("\"area\":185.8,", "", "missing key area"),
            ("}]}", "}", "column"),
        ];
        for (from, to, named) in cases {
            let broken = LINE.replacen(from, to, 1);
            assert_ne!(broken, LINE, "{from} is not in the line");
            let error = parse_line(&broken, "b.jsonl", 12).unwrap_err().to_string();
            assert!(error.starts_with("blob stream b.jsonl, line 12: ") && error.contains(named), "{error}");
        }
    }

    #[test]
    fn other_files_are_named_for_what_they_look_like() {
        let cases = [("t_ns,cam,x,y", "a table (CSV)"), ("[a]", "TOML"), ("<svg/>", "XML")];
        for (text, what) in cases {
            let error = parse_line(text, "b.csv", 1).unwrap_err().to_string();
            let expected = format!("expected one camera-field in JSON, which begins with {{, found {what}");
            assert!(error.contains("b.csv, line 1: ") && error.contains(&expected), "{error}");
        }
    }

    #[test]
    fn ten_thousand_blobs_are_counted() {
        let blob = r#"{"x":1,"y":2,"area":3,"colour":"blue","w":4,"h":5}"#;
        let blobs = vec![blob; 10_000].join(",");
        let text = format!(r#"{{"cam":0,"seq":0,"t_ns":1,"t_rx_ns":2,"parity":0,"blobs":[{blobs}]}}"#);
        let field = parse_line(&text, "b.jsonl", 1).unwrap();
        assert_eq!((field.count as usize, field.blobs_left_out as usize), (MAX_BLOBS, 10_000 - MAX_BLOBS));
    }

    #[test]
    fn a_file_holds_more_blobs_than_a_block_and_lines_without_any() {
        let blob = parse_line(LINE, "b.jsonl", 1).unwrap().blobs()[0];
        let head = parse_head(LINE, "b.jsonl", 1).unwrap();
        assert_eq!((head.cam, head.seq, head.t_ns, head.parity), (1, 7, 48_051_108, 1));
        let line = write_blobs(&head, &[blob; 100]);
        assert_eq!(parse_line(&line, "b.jsonl", 1).unwrap().blobs_left_out, 100 - MAX_BLOBS as u32);
        let bare = r#"{"cam":1,"seq":7,"t_ns":48051108,"t_rx_ns":72069517,"parity":1}"#;
        assert_eq!(parse_head(bare, "f.jsonl", 1).unwrap(), head);
        for (from, to, named) in [
            ("1}", "3}", "parity"),
            ("1}", "1,\"x\":2}", "unknown key x"),
            ("\"seq\":7,", "", "missing key seq"),
        ] {
            let error = parse_head(&bare.replace(from, to), "f.jsonl", 9).unwrap_err().to_string();
            assert!(error.contains("f.jsonl, line 9") && error.contains(named), "{error}");
        }
    }

    #[test]
    fn reader_counts_lines_and_goes_on_after_a_bad_one() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("b.jsonl");
        std::fs::write(&path, format!("{LINE}\n\n{{}}\n{LINE}")).unwrap();
        let all: Vec<_> = BlobReader::open(&path).unwrap().collect();
        assert_eq!(all.len(), 3);
        assert!(all[0].is_ok() && all[2].is_ok());
        let error = all[1].as_ref().unwrap_err().to_string();
        assert!(error.contains("line 3") && error.contains("missing key"), "{error}");
        assert!(BlobReader::open(&directory.path().join("none")).is_err());
        std::fs::write(&path, [0xff, 0xfe, b'\n']).unwrap();
        assert_eq!(BlobReader::open(&path).unwrap().filter(Result::is_err).count(), 1);
    }

    proptest! {
        #[test]
        fn any_text_is_parsed_or_refused(text in ".{0,200}", cut in 0..LINE.len(), with in any::<char>()) {
            let _ = parse_line(&text, "f", 1);
            let mut damaged: String = LINE.chars().take(cut).collect();
            damaged.push(with);
            damaged.extend(LINE.chars().skip(cut + 1));
            if let Ok(field) = parse_line(&damaged, "f", 1) {
                prop_assert!(field.validate().is_ok());
            }
        }

        #[test]
        fn fields_round_trip(
            numbers in prop::collection::vec((-1e4..1e4f64, -1e4..1e4f64, 0.0..1e4f64, 1e-9..1.0f64, 1u32..8), 0..64),
            seq in any::<u64>(), camera in 0u32..8, parity in 0u32..3,
        ) {
            let mut field = BlobField::zeroed();
            (field.field, field.camera, field.parity, field.exposed_ns) = (seq, camera, parity, seq | 1);
            for (x, y, a, v, colour) in numbers {
                field.push(Blob {
                    x_px: x, y_field_px: y, area_px: a, width_px: a / 2.0, height_px: a / 3.0,
                    var_x_px2: v, var_y_px2: 2.0 * v, cov_xy_px2: v / 3.0, colour, flags: colour & 3,
                });
            }
            let back = parse_line(&write_line(&field), "f", 1).unwrap();
            prop_assert_eq!(bytemuck::bytes_of(&back), bytemuck::bytes_of(&field));
        }
    }
}
