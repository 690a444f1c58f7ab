//! `vitreo trace`: the way of one field through all instants.

mod matches;

use anyhow::bail;
use ipc::logging::warn;
use outputs::exit::WrongUse;
use outputs::println;
use protocol::blobs::BlobField;
use protocol::frames::FrameRecord;
use protocol::matches::MatchFrame;
use protocol::poses::TrackerFrame;
use protocol::steps::StepRecord;
use protocol::time::Nanos;
use recording::{Item, Recording};
use serde::Serialize;
use settings::commands::TraceArgs;
use std::process::ExitCode;

/// Width of the picture, characters.
const BAR: usize = 60;

/// What the recording holds about one field.
#[derive(Debug, Default)]
struct Found {
    fields: Vec<BlobField>,
    pose: Option<Box<TrackerFrame>>,
    step: Option<StepRecord>,
    frame: Option<FrameRecord>,
    matches: Option<Box<MatchFrame>>,
    events: u64,
}

impl Found {
    /// Takes what belongs to the field; the first of each kind counts.
    fn take(&mut self, field: u64, item: &Item) {
        match item {
            Item::Blobs(b) if b.field == field => self.fields.push(**b),
            Item::Poses(p) if p.field == field => self.pose = self.pose.take().or(Some(p.clone())),
            Item::Step(s) if s.field == field => self.step = self.step.or(Some(*s)),
            Item::Frame(f) if f.field == field => self.frame = self.frame.or(Some(*f)),
            Item::Matches(m) if m.field == field => self.matches = self.matches.take().or(Some(m.clone())),
            Item::Event(e) if e.field == field => self.events += 1,
            _ => {}
        }
    }

    /// Instants in the order of the path; 0 where not reached.
    fn instants(&self) -> [(&'static str, Nanos); 10] {
        let pose = self.pose.as_ref().map(|p| p.instants);
        let step = self.step.map(|s| s.instants);
        let frame = self.frame;
        let of_pose = |get: fn(&protocol::time::Instants) -> Nanos| {
            let shown = frame.map(|f| f.instants);
            pose.or(step).or(shown).as_ref().map_or(0, get)
        };
        let first = self.fields.first();
        let from_field =
            |at: Nanos, get: fn(&BlobField) -> Nanos| if at > 0 { at } else { first.map_or(0, get) };
        [
            ("exposed", from_field(of_pose(|i| i.exposed), |b| b.exposed_ns)),
            ("read_out", from_field(of_pose(|i| i.read_out), |b| b.read_out_ns)),
            ("blobs_out", from_field(of_pose(|i| i.blobs_out), |b| b.blobs_out_ns)),
            ("taken", of_pose(|i| i.taken)),
            ("tracked", of_pose(|i| i.tracked)),
            ("stepped", step.map_or(0, |i| i.stepped)),
            ("frame_start", frame.map_or(0, |f| f.frame_start)),
            ("latched", frame.map_or(0, |f| f.latched)),
            ("drawn", frame.map_or(0, |f| f.drawn)),
            ("displayed", frame.map_or(0, |f| f.displayed)),
        ]
    }
}

/// One line of the timeline.
#[derive(Debug, Serialize, PartialEq)]
struct Stop {
    instant: &'static str,
    at_ns: Nanos,
    since_exposed_ms: f64,
    since_previous_ms: f64,
}

fn stops(instants: &[(&'static str, Nanos)]) -> Vec<Stop> {
    let mut reached: Vec<_> = instants.iter().filter(|(_, at)| *at > 0).collect();
    // Blobs may leave before the last line of their field has.
    reached.sort_by_key(|(_, at)| *at);
    let Some((_, start)) = reached.first() else { return Vec::new() };
    let ms = |from: Nanos, to: Nanos| to.wrapping_sub(from) as i64 as f64 * 1e-6;
    let mut previous = *start;
    reached
        .iter()
        .map(|&&(instant, at_ns)| {
            let stop = Stop {
                instant,
                at_ns,
                since_exposed_ms: ms(*start, at_ns),
                since_previous_ms: ms(previous, at_ns),
            };
            previous = at_ns;
            stop
        })
        .collect()
}

/// A bar from the previous stop to this one, on the scale of the whole way.
fn bar(stop: &Stop, end_ms: f64) -> String {
    let column = |ms: f64| ((ms / end_ms.max(1e-9)).clamp(0.0, 1.0) * BAR as f64).round() as usize;
    let to = column(stop.since_exposed_ms);
    let from = column(stop.since_exposed_ms - stop.since_previous_ms).min(to);
    format!("{}{}|", " ".repeat(from), "=".repeat(to - from))
}

/// Runs it.
///
/// # Errors
/// Where the recording cannot be read, or does not hold the field.
pub fn run(args: &TraceArgs) -> anyhow::Result<ExitCode> {
    let recording = Recording::open(&args.file)?;
    let mut found = Found::default();
    let mut seen: Option<[u64; 2]> = None;
    for item in recording.items() {
        let Ok((_, item)) = item.inspect_err(|e| warn(&format!("{e}"))) else { continue };
        if let Item::Blobs(b) = &item {
            let [low, high] = seen.unwrap_or([b.field; 2]);
            seen = Some([low.min(b.field), high.max(b.field)]);
        }
        found.take(args.field, &item);
    }
    let stops = stops(&found.instants());
    if stops.is_empty() {
        let range = seen.map_or("no fields".into(), |[low, high]| format!("fields {low} to {high}"));
        let file = args.file.display();
        bail!(WrongUse(format!("{file}: no field {}; it contains {range}", args.field)));
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&as_json(args.field, &found, &stops))?);
    } else {
        print(args.field, &found, &stops);
    }
    Ok(ExitCode::SUCCESS)
}

fn as_json(field: u64, found: &Found, stops: &[Stop]) -> serde_json::Value {
    let cameras: Vec<_> = found
        .fields
        .iter()
        .map(|b| serde_json::json!({"camera": b.camera, "exposed_ns": b.exposed_ns, "blobs_out_ns": b.blobs_out_ns, "blobs": b.count}))
        .collect();
    serde_json::json!({
        "field": field,
        "stops": stops,
        "cameras": cameras,
        "frame": found.pose.as_ref().map(|p| p.frame),
        "step": found.step.map(|s| s.step),
        "waited_ns": found.pose.as_ref().map(|p| p.waited_ns),
        "events": found.events,
        "matches": found.matches.as_ref().map(|m| matches::as_json(m)),
    })
}

fn print(field: u64, found: &Found, stops: &[Stop]) {
    println!("field {field}");
    for b in &found.fields {
        let out_ms = b.blobs_out_ns.wrapping_sub(b.exposed_ns) as i64 as f64 * 1e-6;
        println!("  camera {}: {} blobs, out {out_ms:.3} ms after its exposure", b.camera, b.count);
    }
    if let Some(pose) = &found.pose {
        let waited_ms = pose.waited_ns as f64 * 1e-6;
        println!(
            "  tracker frame {}: {} camera-fields, waited {waited_ms:.3} ms",
            pose.frame, pose.used_count
        );
    }
    if let Some(step) = &found.step {
        println!("  step {}: state {:016x}, {} events", step.step, step.state_hash, found.events);
    }
    if let Some(frame) = &found.frame {
        println!("  shown first in frame {} at tier {}", frame.frame, frame.tier);
    }
    if let Some(found) = &found.matches {
        matches::lines(found).iter().for_each(|line| println!("  {line}"));
    }
    let end_ms = stops.iter().map(|s| s.since_exposed_ms).fold(0.0, f64::max);
    println!("  {:<12} {:>10} {:>10}", "instant", "ms", "+ ms");
    for stop in stops {
        let (name, at, more) = (stop.instant, stop.since_exposed_ms, stop.since_previous_ms);
        println!("  {name:<12} {at:>10.3} {more:>10.3}  {}", bar(stop, end_ms));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    #[test]
    fn stops_leave_out_what_was_not_reached() {
        let stops = stops(&[("exposed", 1_000_000), ("read_out", 0), ("tracked", 3_500_000)]);
        assert_eq!(stops.len(), 2);
        assert_eq!(
            (stops[1].instant, stops[1].since_exposed_ms, stops[1].since_previous_ms),
            ("tracked", 2.5, 2.5)
        );
        assert_eq!(bar(&stops[1], 5.0), format!("{}|", "=".repeat(BAR / 2)));
    }

    #[test]
    fn only_the_field_asked_for_is_taken() {
        let mut found = Found::default();
        for field in [4, 5, 5] {
            let step = StepRecord { field, step: field, ..StepRecord::zeroed() };
            found.take(5, &Item::Step(step));
            found.take(5, &Item::Blobs(Box::new(BlobField { field, exposed_ns: 9, ..BlobField::zeroed() })));
        }
        assert_eq!((found.step.unwrap().step, found.fields.len()), (5, 2));
        assert_eq!(found.instants()[0], ("exposed", 9));
    }
}
