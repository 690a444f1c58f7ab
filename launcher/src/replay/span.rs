//! Whether the part of a recording that is asked for exists.

use super::ReplayArgs;
use anyhow::ensure;
use protocol::time::Nanos;
use recording::{Item, Recording, Source};

/// Refuses a beginning beyond the recording's end.
///
/// # Errors
/// Where there is nothing to show from `--from` on.
pub fn check(recording: &Recording, args: &ReplayArgs) -> anyhow::Result<()> {
    if args.from == 0.0 {
        return Ok(());
    }
    let length_s = length_ns(recording) as f64 * 1e-9;
    ensure!(
        args.from <= length_s,
        "--from {}: {} holds {length_s:.2} s only",
        args.from,
        args.file.display()
    );
    Ok(())
}

/// From the first exposure to the last of what is replayed, ns; damage ends it.
fn length_ns(recording: &Recording) -> Nanos {
    let topic = match recording.provenance().source {
        Source::Live => "poses",
        Source::Import => "blobs",
    };
    let items = recording.items_of(&[topic]).map_while(Result::ok);
    let mut exposures = items.filter_map(|(_, item)| match item {
        Item::Poses(frame) => Some(frame.instants.exposed),
        Item::Blobs(field) => Some(field.exposed_ns),
        _ => None,
    });
    let first = exposures.next().unwrap_or(0);
    exposures.fold(first, Nanos::max).saturating_sub(first)
}
