//! What each packing costs: size of a recording, and the processor's time to write and to read it.
//!
//! `cargo run --release -p recording --example packing FILE.mcap`

use recording::{Item, Packing, Recording, Writer};
use std::error::Error;
use std::path::Path;
use std::time::Duration;

/// Times that each is done; the shortest counts.
const RUNS: usize = 15;

fn main() -> Result<(), Box<dyn Error>> {
    let file = std::env::args().nth(1).ok_or("expected the recording to be packed")?;
    let recording = Recording::open(Path::new(&file))?;
    let items: Vec<(u64, Item)> = recording.items().collect::<Result<_, _>>()?;
    let recorded_s = recording.exposed_s().max(1e-9);
    println!("{file}: {} items, {recorded_s:.1} s", items.len());
    println!("| packing | kB | kB/s | write, ms per s | read, ms per s |\n|---|---|---|---|---|");
    for packing in Packing::ALL {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("a.mcap");
        let (mut write, mut read) = (Duration::MAX, Duration::MAX);
        for _ in 0..RUNS {
            write = write.min(written(&path, &recording, packing, &items)?);
            let begun = on_processor()?;
            if Recording::open(&path)?.items().filter(Result::is_ok).count() != items.len() {
                return Err("not all came back".into());
            }
            read = read.min(on_processor()? - begun);
        }
        let kb = std::fs::metadata(&path)?.len() as f64 / 1e3;
        let per_s = |time: Duration| time.as_secs_f64() * 1e3 / recorded_s;
        let (name, rate) = (packing.name(), kb / recorded_s);
        println!("| {name} | {kb:.0} | {rate:.0} | {:.2} | {:.2} |", per_s(write), per_s(read));
    }
    Ok(())
}

/// What this thread has had of a processor: other programs change it little.
fn on_processor() -> Result<Duration, Box<dyn Error>> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat")?;
    let ns = text.split_whitespace().next().ok_or("no time in schedstat")?;
    Ok(Duration::from_nanos(ns.parse()?))
}

/// Writes all items, without waiting for the disk; what that took.
fn written(
    path: &Path,
    recording: &Recording,
    packing: Packing,
    items: &[(u64, Item)],
) -> Result<Duration, Box<dyn Error>> {
    let file = std::fs::File::create(path)?;
    let begun = on_processor()?;
    let mut writer = Writer::packed(file, path, recording.provenance(), packing)?;
    let mut newest = 0;
    for (at, item) in items {
        newest = newest.max(*at);
        writer.write(*at, item)?;
        // Chunks are closed at the same ages as live.
        writer.flush_aged(newest)?;
    }
    let took = on_processor()? - begun;
    writer.finish()?;
    Ok(took)
}
