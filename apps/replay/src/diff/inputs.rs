//! The inputs of two recordings, paired: camera-fields by camera and field number, handle and pedal states
//! by their numbers.

use super::side::{FieldSeen, Side};
use protocol::handles::{HandleState, PedalState};
use protocol::time::Nanos;
use serde::Serialize;
use std::collections::BTreeMap;

/// Two camera-fields of one number.
#[derive(Debug, Clone, Copy)]
pub struct FieldPair {
    /// Of the first recording.
    pub a: FieldSeen,
    /// Of the second.
    pub b: FieldSeen,
}

/// Camera-fields, paired.
#[derive(Debug, Default)]
pub struct FieldPairs {
    /// In the order of cameras and numbers.
    pub pairs: Vec<FieldPair>,
    /// Field numbers of the first that the second lacks, by camera.
    pub missing_in_b: BTreeMap<u32, Vec<u64>>,
    /// Field numbers of the second that the first lacks, by camera.
    pub missing_in_a: BTreeMap<u32, Vec<u64>>,
    /// What is added to a number of the first to get that of the second: the runs were begun at other
    /// numbers.
    pub number_offset: i64,
    /// How far the clock of the second is ahead, ns.
    pub clock_offset_ns: i64,
}

/// Differences of the inputs.
#[derive(Debug, Default, Serialize)]
pub struct InputFigures {
    /// Camera-fields that were compared.
    pub fields_compared: u64,
    /// Camera-fields of one recording only.
    pub fields_missing: u64,
    /// Camera-fields whose blobs differ.
    pub blobs_differ: u64,
    /// Camera-fields whose exposures differ, once both clocks begin alike.
    pub stamps_differ: u64,
    /// Handle states that were compared.
    pub handles_compared: u64,
    /// Handle states that differ or that one recording lacks.
    pub handles_differ: u64,
    /// Pedal states that were compared.
    pub pedals_compared: u64,
    /// Pedal states that differ or that one recording lacks.
    pub pedals_differ: u64,
    /// How far the clock of the second recording is ahead, s.
    pub clock_offset_s: f64,
}

/// Pairs the camera-fields of two recordings.
pub fn pair_fields(a: &Side, b: &Side) -> FieldPairs {
    let mut pairs = FieldPairs { number_offset: number_offset(a, b), ..FieldPairs::default() };
    let mut cameras = [a.cameras(), b.cameras()].concat();
    cameras.sort_unstable();
    cameras.dedup();
    for camera in cameras {
        merge(camera, a.fields_of(camera), b.fields_of(camera), &mut pairs);
    }
    pairs.clock_offset_ns = clock_offset(&pairs.pairs);
    pairs
}

/// Walks over the fields of one camera, which are in the order of their numbers.
fn merge(camera: u32, a: &[FieldSeen], b: &[FieldSeen], pairs: &mut FieldPairs) {
    let (mut a, mut b) = (a.iter().peekable(), b.iter().peekable());
    loop {
        let numbers =
            (a.peek().map(|f| f.field.wrapping_add_signed(pairs.number_offset)), b.peek().map(|f| f.field));
        match numbers {
            (Some(n), Some(m)) if n == m => {
                let (Some(a), Some(b)) = (a.next(), b.next()) else { return };
                pairs.pairs.push(FieldPair { a: *a, b: *b });
            }
            (Some(n), m) if m.is_none_or(|m| n < m) => {
                pairs.missing_in_b.entry(camera).or_default().extend(a.next().map(|f| f.field));
            }
            (_, Some(_)) => pairs.missing_in_a.entry(camera).or_default().extend(b.next().map(|f| f.field)),
            _ => return,
        }
    }
}

/// 0 where the numbers of both overlap; else what makes them begin alike.
fn number_offset(a: &Side, b: &Side) -> i64 {
    let range = |side: &Side| {
        let numbers = side.fields.iter().map(|f| f.field).chain(side.frames.iter().map(|f| f.field));
        numbers.fold(None, |range: Option<[u64; 2]>, n| {
            Some(range.map_or([n; 2], |[low, high]| [low.min(n), high.max(n)]))
        })
    };
    match (range(a), range(b)) {
        (Some([a0, a1]), Some([b0, b1])) if a1 < b0 || b1 < a0 => b0.wrapping_sub(a0) as i64,
        _ => 0,
    }
}

/// The median over the cameras of the median of their exposures' differences: one camera whose stamps are
/// off does not count.
fn clock_offset(pairs: &[FieldPair]) -> i64 {
    median(&mut camera_offsets(pairs).into_values().collect::<Vec<_>>())
}

/// Median difference of the exposures of each camera, ns.
pub fn camera_offsets(pairs: &[FieldPair]) -> BTreeMap<u32, i64> {
    let mut by_camera: BTreeMap<u32, Vec<i64>> = BTreeMap::new();
    for pair in pairs {
        by_camera.entry(pair.a.camera).or_default().push(difference(pair.a.exposed_ns, pair.b.exposed_ns));
    }
    by_camera.into_iter().map(|(camera, mut offsets)| (camera, median(&mut offsets))).collect()
}

/// `b - a`, ns.
pub fn difference(a: Nanos, b: Nanos) -> i64 {
    b.wrapping_sub(a) as i64
}

/// The lower of the middle values; 0 of none.
fn median(values: &mut [i64]) -> i64 {
    values.sort_unstable();
    values.get(values.len().saturating_sub(1) / 2).copied().unwrap_or(0)
}

/// Where inputs first differ, in the clock of the first recording.
#[derive(Debug, Clone)]
pub struct FirstInput {
    /// Exposure or instant, ns.
    pub at_ns: Nanos,
    /// Camera-field, or number of the state.
    pub field: u64,
    /// What differs there.
    pub what: String,
}

/// Counts what differs, and finds the first of it.
pub fn compare(a: &Side, b: &Side, fields: &FieldPairs) -> (InputFigures, Option<FirstInput>) {
    let mut figures = InputFigures {
        fields_compared: fields.pairs.len() as u64,
        clock_offset_s: fields.clock_offset_ns as f64 * 1e-9,
        ..InputFigures::default()
    };
    let mut firsts = vec![missing(a, b, fields, &mut figures)];
    for pair in &fields.pairs {
        firsts.push(compare_field(a, b, pair, fields.clock_offset_ns, &mut figures));
    }
    firsts.push(compare_handles(a, b, &mut figures));
    firsts.push(compare_pedals(a, b, &mut figures));
    let first = firsts.into_iter().flatten().min_by_key(|first| first.at_ns);
    (figures, first)
}

/// Fields that one recording lacks.
fn missing(a: &Side, b: &Side, fields: &FieldPairs, figures: &mut InputFigures) -> Option<FirstInput> {
    let sides =
        [(&fields.missing_in_b, a, "second", 0), (&fields.missing_in_a, b, "first", fields.clock_offset_ns)];
    let mut first: Option<FirstInput> = None;
    for (missing, has, lacking, ahead_ns) in sides {
        for (camera, numbers) in missing {
            figures.fields_missing += numbers.len() as u64;
            let Some(field) = numbers.first() else { continue };
            let seen = has.fields_of(*camera).iter().find(|f| f.field == *field);
            let at_ns = seen.map_or(0, |f| f.exposed_ns.wrapping_add_signed(ahead_ns.wrapping_neg()));
            if first.as_ref().is_none_or(|first| at_ns < first.at_ns) {
                let what =
                    format!("presence: the {lacking} recording lacks field {field} of camera {camera}");
                first = Some(FirstInput { at_ns, field: *field, what });
            }
        }
    }
    first
}

fn compare_field(
    a: &Side,
    b: &Side,
    pair: &FieldPair,
    ahead_ns: i64,
    figures: &mut InputFigures,
) -> Option<FirstInput> {
    let FieldSeen { camera, field, exposed_ns, .. } = pair.a;
    let found = |what: String| Some(FirstInput { at_ns: exposed_ns, field, what });
    let off_ns = difference(exposed_ns, pair.b.exposed_ns).wrapping_sub(ahead_ns);
    let (seen, other) = (a.blobs_of(&pair.a), b.blobs_of(&pair.b));
    figures.stamps_differ += u64::from(off_ns != 0);
    figures.blobs_differ += u64::from(seen != other);
    if off_ns != 0 {
        let off_ms = off_ns as f64 * 1e-6;
        return found(format!("exposed_ns of field {field} of camera {camera}: {off_ms:+.3} ms"));
    }
    if seen.len() != other.len() {
        return found(format!(
            "count of field {field} of camera {camera}: {} and {}",
            seen.len(),
            other.len()
        ));
    }
    let (number, (p, q)) = seen.iter().zip(other).enumerate().find(|(_, (p, q))| p != q)?;
    let part = match (p.at_px == q.at_px, p.colour == q.colour) {
        (false, _) => format!("centre: {:.3?} and {:.3?} px", p.at_px, q.at_px),
        (true, false) => format!("colour: {} and {}", p.colour, q.colour),
        (true, true) => format!("area: {:.2} and {:.2} px", p.area_px, q.area_px),
    };
    found(format!("blobs[{number}] of field {field} of camera {camera}, {part}"))
}

/// Pairs by number, in ascending order; `same` compares two of one number.
fn compare_numbered<T>(
    sides: [&[T]; 2],
    number: impl Fn(&T) -> u64,
    same: impl Fn(&T, &T) -> bool,
) -> (u64, u64, Option<u64>) {
    let [a, b] = sides.map(|states| states.iter().map(|s| (number(s), s)).collect::<BTreeMap<u64, &T>>());
    let compared = a.keys().filter(|n| b.contains_key(n)).count() as u64;
    let of_b = b.keys().filter(|n| !a.contains_key(n)).copied();
    let of_a = a.iter().filter(|(n, state)| b.get(n).is_none_or(|other| !same(state, other)));
    let mut differ: Vec<u64> = of_a.map(|(n, _)| *n).chain(of_b).collect();
    differ.sort_unstable();
    (compared, differ.len() as u64, differ.first().copied())
}

fn compare_handles(a: &Side, b: &Side, figures: &mut InputFigures) -> Option<FirstInput> {
    let of = |h: &HandleState| (h.field, h.instrument, h.tool, h.jaw_rad.to_bits());
    let (compared, differ, first) =
        compare_numbered([&a.handles, &b.handles], |h| h.seq, |h, other| of(h) == of(other));
    (figures.handles_compared, figures.handles_differ) = (compared, differ);
    let seq = first?;
    let [one, other] = [a, b].map(|side| side.handles.iter().find(|h| h.seq == seq));
    let at_ns = one.or(other)?.instant_ns;
    Some(FirstInput { at_ns, field: one.or(other)?.field, what: pair_text("handle", seq, one, other) })
}

fn compare_pedals(a: &Side, b: &Side, figures: &mut InputFigures) -> Option<FirstInput> {
    let of = |p: &PedalState| (p.axes.map(f64::to_bits), p.buttons, p.mode);
    let (compared, differ, first) =
        compare_numbered([&a.pedals, &b.pedals], |p| p.seq, |p, other| of(p) == of(other));
    (figures.pedals_compared, figures.pedals_differ) = (compared, differ);
    let seq = first?;
    let [one, other] = [a, b].map(|side| side.pedals.iter().find(|p| p.seq == seq));
    Some(FirstInput {
        at_ns: one.or(other)?.instant_ns,
        field: seq,
        what: pair_text("pedal", seq, one, other),
    })
}

/// What differs of two states of one number.
fn pair_text<T: std::fmt::Debug>(what: &str, seq: u64, a: Option<&T>, b: Option<&T>) -> String {
    match (a, b) {
        (Some(a), Some(b)) => format!("{what} state {seq}: {a:?} and {b:?}"),
        (Some(_), None) => format!("presence: the second recording lacks {what} state {seq}"),
        _ => format!("presence: the first recording lacks {what} state {seq}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbered_states_are_paired_by_their_numbers() {
        let compare = |a: &[(u64, u8)], b: &[(u64, u8)]| compare_numbered([a, b], |s| s.0, |s, t| s.1 == t.1);
        assert_eq!(compare(&[(1, 5), (2, 6)], &[(1, 5), (2, 6)]), (2, 0, None));
        assert_eq!(compare(&[(1, 5), (2, 6), (3, 1)], &[(1, 5), (3, 2), (4, 0)]), (2, 3, Some(2)));
    }

    #[test]
    fn the_middle_of_none_is_zero() {
        assert_eq!((median(&mut []), median(&mut [3]), median(&mut [9, -1, 4])), (0, 3, 4));
    }
}
