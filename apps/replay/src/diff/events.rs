//! Events of two recordings, paired by kind, instrument and field.

use super::side::Side;
use protocol::events::Event;
use serde::Serialize;
use std::collections::BTreeMap;

/// Time by which paired events may be apart, ns: a step that slipped by a few frames is still the same event.
const NEAR_NS: u64 = 100_000_000;
/// Unpaired events that are listed.
const LISTED: usize = 100;

/// An event that only one of the recordings has.
#[derive(Debug, Clone, Serialize)]
pub struct Unpaired {
    /// `A` or `B`.
    pub only_in: char,
    /// Name of its kind.
    pub kind: &'static str,
    /// Field of its step.
    pub field: u64,
    /// When, s from the start of its recording.
    pub at_s: f64,
    /// In words.
    pub text: String,
}

/// What became of the events.
#[derive(Debug, Default, Serialize)]
pub struct EventFigures {
    /// Events that are the same to the bit.
    pub identical: u64,
    /// Events of the same kind and instrument within 100 ms, with another figure, place or field.
    pub shifted: u64,
    /// Events that only one recording has.
    pub unpaired: u64,
    /// Of them, the first hundred.
    pub unpaired_list: Vec<Unpaired>,
    /// Events of a kind in the first and in the second recording, where the numbers differ.
    pub counts_differ: BTreeMap<&'static str, [u64; 2]>,
    /// The first difference.
    #[serde(skip)]
    pub first: Option<FirstEvent>,
}

/// The first event that differs.
#[derive(Debug, Clone)]
pub struct FirstEvent {
    /// Exposure of its step, in its own recording, ns.
    pub exposed_ns: u64,
    /// Field of its step.
    pub field: u64,
    /// The recording that alone has it, `A` or `B`; none where both have one, and it is that of the first.
    pub only_in: Option<char>,
    /// What it is, and how it differs.
    pub what: String,
}

/// Name of an event's kind.
fn kind(event: &Event) -> &'static str {
    event.info().map_or("unknown", |info| info.name)
}

/// Pairs the events of two recordings.
pub fn compare(a: &Side, b: &Side, number_offset: i64) -> EventFigures {
    let mut figures = EventFigures::default();
    for (place, side) in [a, b].into_iter().enumerate() {
        side.events.iter().for_each(|e| figures.counts_differ.entry(kind(e)).or_insert([0; 2])[place] += 1);
    }
    figures.counts_differ.retain(|_, [a, b]| a != b);
    // By kind and instrument, in the order in which they came.
    let mut open: BTreeMap<(u32, u32), Vec<&Event>> = BTreeMap::new();
    b.events.iter().for_each(|e| open.entry((e.kind, e.instrument)).or_default().push(e));
    let near_fields = near_fields(a.period_ns());
    let mut alone = Vec::new();
    for event in &a.events {
        let field = event.field.wrapping_add_signed(number_offset);
        let candidates = open.entry((event.kind, event.instrument)).or_default();
        let nearest = candidates.iter().enumerate().min_by_key(|(_, e)| e.field.abs_diff(field));
        match nearest.filter(|(_, e)| e.field.abs_diff(field) <= near_fields).map(|(at, _)| at) {
            Some(at) => pair(event, candidates.remove(at), field, &mut figures),
            None => alone.push(('A', event, a.start_ns())),
        }
    }
    alone.extend(open.into_values().flatten().map(|event| ('B', event, b.start_ns())));
    alone.sort_by_key(|(_, event, _)| event.field);
    figures.unpaired = alone.len() as u64;
    for (only_in, event, _) in &alone {
        figures.note_first(event, Some(*only_in), || {
            format!("{}: only in {only_in}: {}", kind(event), event.describe())
        });
    }
    figures.unpaired_list =
        alone.iter().take(LISTED).map(|(side, event, start)| unpaired(*side, event, *start)).collect();
    figures
}

/// Fields of cameras of this period within [`NEAR_NS`].
fn near_fields(period_ns: u64) -> u64 {
    (NEAR_NS / period_ns.max(1)).max(1)
}

fn pair(a: &Event, b: &Event, field: u64, figures: &mut EventFigures) {
    let of = |e: &Event, field: u64| {
        let numbers = [e.value, e.limit].into_iter().chain(e.position_in_eye_mm).map(f64::to_bits);
        (field, e.severity, e.subject, numbers.collect::<Vec<_>>())
    };
    if of(a, field) == of(b, b.field) {
        figures.identical += 1;
        return;
    }
    figures.shifted += 1;
    figures.note_first(a, None, || {
        let what = if field == b.field { "figures" } else { "field" };
        format!(
            "{}, {what}: {} (field {}) and {} (field {})",
            kind(a),
            a.describe(),
            a.field,
            b.describe(),
            b.field
        )
    });
}

impl EventFigures {
    fn note_first(&mut self, event: &Event, only_in: Option<char>, what: impl FnOnce() -> String) {
        let Event { exposed_ns, field, .. } = *event;
        if self.first.as_ref().is_none_or(|first| exposed_ns < first.exposed_ns) {
            self.first = Some(FirstEvent { exposed_ns, field, only_in, what: what() });
        }
    }
}

fn unpaired(only_in: char, event: &Event, start_ns: u64) -> Unpaired {
    let at_s = event.exposed_ns.saturating_sub(start_ns) as f64 * 1e-9;
    Unpaired { only_in, kind: kind(event), field: event.field, at_s, text: event.describe() }
}

#[cfg(test)]
mod tests {
    use super::near_fields;

    #[test]
    fn paired_events_are_near_in_time_whatever_the_rate() {
        assert_eq!([40_000_000, 20_000_000, 5_000_000, 2_000_000].map(near_fields), [2, 5, 20, 50]);
        assert_eq!([0, u64::MAX].map(near_fields), [100_000_000, 1]);
    }
}
