//! `cargo run --release -p recording --example share FILE.mcap…`: how much of a recording each of its
//! larger topics is: checkpoints and matches.
//!
//! The recording is written again, with chunks closed at the same ages as live, once whole and once without
//! the topic; the difference is its share, compressed as it stands in the file.

use recording::{Item, Recording, Writer};
use std::path::{Path, PathBuf};

const TOPICS: [&str; 3] = ["checkpoints", "tracker-checkpoints", "matches"];

/// Bytes of a copy without a topic.
fn bytes_without(recording: &Recording, topic: &str, copy: &Path) -> Result<u64, Box<dyn std::error::Error>> {
    let mut writer = Writer::create(copy, recording.provenance())?;
    let mut newest = 0;
    for item in recording.items() {
        let (at, item) = item?;
        newest = newest.max(at);
        if item.topic() != topic {
            writer.write(at, &item)?;
        }
        writer.flush_aged(newest)?;
    }
    writer.finish()?;
    Ok(std::fs::metadata(copy)?.len())
}

/// Messages of a topic and the bytes of their states, or of the whole message.
fn states(recording: &Recording, topic: &'static str) -> (u64, u64) {
    let bytes = recording.items_of(&[topic]).flatten().map(|(_, item)| match item {
        Item::Checkpoint(_, state) | Item::TrackerCheckpoint(_, state) => state.len() as u64,
        item => item.encoded().len() as u64,
    });
    bytes.fold((0, 0), |(count, sum), bytes| (count + 1, sum + bytes))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = tempfile::tempdir()?;
    let copy = folder.path().join("copy.mcap");
    println!(
        "{:<24} {:>10} {:<20} {:>5} {:>10} {:>10} {:>7}",
        "file", "bytes", "topic", "n", "plain", "packed", "share"
    );
    for file in std::env::args().skip(1).map(PathBuf::from) {
        let recording = Recording::open(&file)?;
        let whole = bytes_without(&recording, "", &copy)?;
        for topic in TOPICS {
            let (count, plain) = states(&recording, topic);
            let packed = whole.saturating_sub(bytes_without(&recording, topic, &copy)?);
            let share = packed as f64 / whole as f64 * 100.0;
            let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
            println!("{name:<24} {whole:>10} {topic:<20} {count:>5} {plain:>10} {packed:>10} {share:>6.1}%");
        }
    }
    Ok(())
}
