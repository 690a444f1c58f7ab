//! Reading small files: never more than a limit, and what a file looks like that is something else.
//!
//! Whatever a person names may be a device without an end, a recording, or the wrong file.

pub use csv::StringRecord;
use csv::{ReaderBuilder, Trim};
use std::fs::File;
use std::io::{BufRead, BufReader, Error, ErrorKind, Read, Result, stdin};
use std::os::fd::AsFd;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;
use std::sync::mpsc;
use std::time::Duration;

/// Settings: rigs, modules, colours, budgets, faults, inputs of a desk, bytes.
pub const MAX_SETTINGS_BYTES: u64 = 1 << 20;
/// Lists and tables, and scenes with a mesh of their own, bytes.
pub const MAX_TABLE_BYTES: u64 = 64 << 20;

/// How long a named pipe may be without anything written to it.
const WRITER_PATIENCE: Duration = Duration::from_secs(5);

/// Name that stands for standard input.
pub const STDIN: &str = "-";

/// Opens a file to be read, or standard input by the name `-`. A named pipe is waited for until somebody writes to it, 5 s at most: opening
/// it would wait without end, and no signal would end that.
///
/// # Errors
/// Where it cannot be opened, or is a pipe without a writer.
pub fn open(path: &Path) -> Result<BufReader<File>> {
    if path.as_os_str() == STDIN {
        return stdin().as_fd().try_clone_to_owned().map(|input| BufReader::new(input.into()));
    }
    if !path.metadata()?.file_type().is_fifo() {
        return File::open(path).map(BufReader::new);
    }
    let (done, opened) = mpsc::channel();
    let pipe = path.to_path_buf();
    let first = move || {
        let mut reader = BufReader::new(File::open(pipe)?);
        reader.fill_buf()?;
        Ok(reader)
    };
    // Without a writer the thread stays blocked, and ends with the program.
    std::thread::Builder::new().name("pipe".into()).spawn(move || done.send(first()))?;
    opened.recv_timeout(WRITER_PATIENCE).unwrap_or_else(|_| {
        let patience = WRITER_PATIENCE.as_secs();
        Err(Error::other(format!("a pipe into which no program has written for {patience} s")))
    })
}

/// Rows of comma-separated values with the line on which each begins, from 1. Cells are trimmed; lines without
/// text are passed over; rows may be of any length.
pub fn rows(text: &str) -> impl Iterator<Item = (usize, StringRecord)> {
    let reader =
        ReaderBuilder::new().has_headers(false).flexible(true).trim(Trim::All).from_reader(text.as_bytes());
    // Text in memory is read without fail.
    reader.into_records().map_while(|row| row.ok()).filter(|row| row.iter().any(|cell| !cell.is_empty())).map(
        |row| {
            let line = row.position().map_or(1, |at| {
                // The reader notes its place before it passes over empty lines.
                let before =
                    text.as_bytes()[at.byte() as usize..].iter().take_while(|b| matches!(b, b'\n' | b'\r'));
                at.line() as usize + before.filter(|b| **b == b'\n').count()
            });
            (line, row)
        },
    )
}

/// A file's bytes.
///
/// # Errors
/// Where it cannot be read, or is longer than `limit` bytes; the message says so, the file's name is
/// the caller's to add.
pub fn read_bytes(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open(path)?.take(limit + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        let expected = if limit.is_multiple_of(1 << 20) {
            format!("{} MiB", limit >> 20)
        } else {
            format!("{limit} bytes")
        };
        return Err(Error::new(ErrorKind::FileTooLarge, format!("expected at most {expected}, found more")));
    }
    Ok(bytes)
}

/// A file's text.
///
/// # Errors
/// As [`read_bytes`], and for what is no text: the message says what it looks like.
pub fn read_text(path: &Path, limit: u64) -> Result<String> {
    String::from_utf8(read_bytes(path, limit)?).map_err(|e| {
        let found = looks_like(e.as_bytes());
        Error::new(ErrorKind::InvalidData, format!("expected text, found {found}"))
    })
}

/// First bytes of files that are no text, and what those are.
const SIGNATURES: &[(&[u8], &str)] = &[
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"\x89MCAP", "a recording (MCAP)"),
    (b"glTF", "a binary glTF mesh"),
    (b"SQLite format 3", "an SQLite database"),
    (b"PAR1", "a Parquet table"),
    (b"PK\x03\x04", "a ZIP archive"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"\x28\xb5\x2f\xfd", "a zstd archive"),
    (b"\x7fELF", "a program"),
    (b"YUV4MPEG2", "a Y4M clip"),
];

/// What a file looks like, for messages about one that is something else.
pub fn looks_like(bytes: &[u8]) -> &'static str {
    if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") {
        let head = &bytes[..bytes.len().min(64)];
        let binary = head.windows(13).any(|w| w == b"format binary");
        return if binary { "a binary PLY mesh" } else { "a PLY mesh" };
    }
    if let Some((_, what)) = SIGNATURES.iter().find(|(begin, _)| bytes.starts_with(begin)) {
        return what;
    }
    // Enough to decide; a letter that is cut in two at the end does not count.
    let head = &bytes[..bytes.len().min(4096)];
    let text = match std::str::from_utf8(head) {
        Ok(text) => text,
        Err(e) if e.error_len().is_none() => std::str::from_utf8(&head[..e.valid_up_to()]).unwrap_or(""),
        Err(_) => return "binary data",
    };
    if text.contains('\0') { "binary data" } else { text_looks_like(text) }
}

fn text_looks_like(text: &str) -> &'static str {
    let text = text.trim_start_matches('\u{feff}').trim();
    let first = text.lines().map(str::trim).find(|l| !l.is_empty() && !l.starts_with('#')).unwrap_or("");
    let is_section = first.starts_with('[')
        && first.ends_with(']')
        && first.chars().all(|c| c.is_alphanumeric() || "[]._-\"".contains(c));
    match first.chars().next() {
        None if !text.is_empty() => "nothing but comments (lines that begin with #)",
        None => "an empty file",
        Some('{') => "JSON",
        Some('<') => "XML",
        Some('[') if !is_section => "JSON",
        _ if is_section || first.contains(" = ") => "TOML",
        _ if first.matches([',', ';', '\t']).count() >= 2 => "a table (CSV)",
        _ => "other text",
    }
}

/// The name of a format in words for messages, where it is not `expected`; a newer version is
/// called so.
pub fn other_format(found: &str, expected: &str) -> Option<String> {
    let version = |name: &str| {
        let (stem, number) = name.rsplit_once('-')?;
        Some((stem.to_owned(), number.parse::<u32>().ok()?))
    };
    let found = found.trim();
    let newer = match (version(found), version(expected)) {
        (Some((stem, number)), Some((own, known))) => stem == own && number > known,
        _ => false,
    };
    let shown: String = found.chars().take(40).collect();
    (found != expected).then(|| match newer {
        true => format!("{shown}, the format of a newer vitreo"),
        false => format!("'{shown}'"),
    })
}

/// The value of the key `format` of a TOML or JSON text that could not be read otherwise: a later
/// format has other keys, and its name says more than the first key that is missing here.
pub fn format_key(text: &str) -> Option<&str> {
    text.lines().find_map(|line| {
        let line = line.trim_start().trim_start_matches('{').trim_start();
        let rest = line.strip_prefix("\"format\"").or_else(|| line.strip_prefix("format"))?;
        let value = rest.trim_start().strip_prefix(['=', ':'])?.trim_start();
        let quote = value.chars().next().filter(|c| matches!(c, '"' | '\''))?;
        value[1..].split(quote).next()
    })
}

/// What the key `format` of a text says, where it is there and is not `expected`; see
/// [`other_format`].
pub fn other_format_in(text: &str, expected: &str) -> Option<String> {
    other_format(format_key(text)?, expected)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_counted_as_an_editor_counts_lines() {
        for end in ["\n", "\r\n"] {
            let lines = ["a, b", "", "c,\"d", "e\"", "  ", "", "f", ",", "g,h,i"].join(end);
            let found: Vec<(usize, Vec<String>)> =
                rows(&lines).map(|(line, row)| (line, row.iter().map(str::to_owned).collect())).collect();
            let numbers: Vec<usize> = found.iter().map(|(line, _)| *line).collect();
            assert_eq!(numbers, [1, 3, 7, 9], "{end:?} {found:?}");
            assert_eq!(found[0].1, ["a", "b"]);
            assert_eq!(found[1].1, ["c".to_owned(), format!("d{end}e")]);
        }
        assert_eq!(rows("").count() + rows("\n\r\n \n").count(), 0);
    }
    use proptest::prelude::*;

    #[test]
    fn what_has_no_end_is_refused_at_the_limit() {
        let error = read_text(Path::new("/dev/zero"), MAX_SETTINGS_BYTES).unwrap_err();
        assert_eq!(error.to_string(), "expected at most 1 MiB, found more");
        let error = read_bytes(Path::new("/dev/zero"), 100).unwrap_err();
        assert_eq!(error.to_string(), "expected at most 100 bytes, found more");
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "twelve bytes").unwrap();
        assert_eq!(read_text(file.path(), 12).unwrap(), "twelve bytes");
        assert!(read_text(file.path(), 11).is_err());
    }

    #[test]
    fn a_pipe_to_which_nobody_writes_is_refused_and_one_with_a_writer_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = |name: &str| {
            let pipe = folder.path().join(name);
            assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
            pipe
        };
        let error = read_text(&pipe("idle"), MAX_SETTINGS_BYTES).unwrap_err();
        assert_eq!(error.to_string(), "a pipe into which no program has written for 5 s");
        let (path, text) = (pipe("written"), "a rig".repeat(90_000));
        let writer = std::thread::spawn({
            let (path, text) = (path.clone(), text.clone());
            move || std::fs::write(path, text).unwrap()
        });
        assert!(read_text(&path, MAX_SETTINGS_BYTES).unwrap() == text, "to its end");
        writer.join().unwrap();
    }

    #[test]
    fn files_are_told_apart() {
        let cases: [(&[u8], &str); 12] = [
            (b"ply\nformat binary_little_endian 1.0\n\xff", "a binary PLY mesh"),
            (b"ply\nformat ascii 1.0\n", "a PLY mesh"),
            (b"\x89PNG\r\n", "a PNG picture"),
            (b"\x00\x00\x00", "binary data"),
            (b"\xff\x00", "binary data"),
            (b"t_ns,body,x,y\n1,inst0,2,3\n", "a table (CSV)"),
            (b"# a\n\n[eye]\n", "TOML"),
            (b"format = \"vitreo-scene-1\"", "TOML"),
            (b" {\"cam\":1}", "JSON"),
            (b"[1, 2]", "JSON"),
            (b" \n", "an empty file"),
            (b"hello", "other text"),
        ];
        for (bytes, what) in cases {
            assert_eq!(looks_like(bytes), what, "{:?}", String::from_utf8_lossy(bytes));
        }
        let cut = [&[b'a'; 4095][..], "é".as_bytes()].concat();
        assert_eq!(looks_like(&cut), "other text");
    }

    #[test]
    fn newer_formats_are_named() {
        let own = "vitreo-scene-1";
        let newer = "vitreo-scene-12, the format of a newer vitreo";
        for text in ["# x\nformat = \"vitreo-scene-12\"\n", "{\"format\" : \"vitreo-scene-12\"}"] {
            assert_eq!(other_format_in(text, own).unwrap(), newer);
        }
        assert_eq!(other_format_in("format = 'vitreo-module-1'", own).unwrap(), "'vitreo-module-1'");
        assert_eq!(other_format_in("format = \"vitreo-scene-1\"", own), None);
        assert_eq!(other_format_in("formats = \"x\"\ntitle = 1", own), None);
    }

    proptest! {
        #[test]
        fn any_bytes_look_like_something(bytes in prop::collection::vec(any::<u8>(), 0..200), text in "\\PC{0,80}") {
            let _ = looks_like(&bytes);
            let _ = looks_like(text.as_bytes());
            let _ = other_format_in(&text, "a-1");
            let _ = other_format_in(&format!("format={text}"), "a-1");
        }
    }
}
