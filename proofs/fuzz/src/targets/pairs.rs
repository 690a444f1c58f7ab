//! Two recordings beside each other: `vitreo diff` of files that are damaged, empty or foreign, and of recordings
//! whose messages say anything, lack anything, or have nothing in common.

use super::{Kind, Target};
use crate::corpus::{self, Scratch};
use crate::fields::{Number, numbers};
use bytemuck::Zeroable;
use protocol::events::Event;
use protocol::handles::HandleState;
use protocol::message::Message;
use protocol::steps::StepRecord;
use protocol::wire::layout_of;
use recording::{Item, Provenance};
use replay::diff::comparison::Comparison;
use replay::diff::side::Side;
use replay::diff::{instant, page, text};
use rig::Rig;
use std::cell::RefCell;
use std::hint::black_box;

/// Bytes of a patch: the recording and its message, the number in it, and the number's new bytes.
const PATCH: usize = 12;
/// Messages of each of the recordings.
const MESSAGES: usize = 64;
/// What a patch's second byte says where it takes the message away.
const DROPS: u8 = 0xff;

/// Targets of comparisons.
pub fn targets() -> Vec<Target> {
    let target =
        |name, run, seeds, longest| Target { name, kind: Kind::Recording, run, seeds, layout: None, longest };
    vec![
        target("diff-files", files, file_pairs, 320 << 10),
        target("diff-items", items, item_pairs, 1 + 40 * PATCH),
    ]
}

thread_local! {
    static FILES: [Scratch; 2] = [Scratch::new(), Scratch::new()];
    static ITEMS: RefCell<(Provenance, Vec<Item>)> = RefCell::new(recorded());
}

/// Whatever two recordings hold, a comparison of them comes to an end and can be shown.
fn compare(a: &Side, b: &Side, tolerance_um: f64) {
    let compared = Comparison::of(a, b, tolerance_um);
    black_box(text::text(&compared).len());
    black_box(page::html(&compared, None).map_or(0, |page| page.len()));
    black_box(instant::of(&compared, a, b).is_some());
    let json = serde_json::to_string(&compared).expect("a comparison is JSON");
    black_box(json.len());
}

/// Both files, the first with its length before it (`u32`, little-endian).
fn file_pairs() -> Vec<Vec<u8>> {
    let pair = |a: &[u8], b: &[u8]| [&(a.len() as u32).to_le_bytes()[..], a, b].concat();
    let recordings = corpus::recordings();
    let [a, b] = [&recordings[0][..], &recordings[1][..]];
    vec![pair(a, a), pair(a, b), pair(&a[..a.len() / 2], a), pair(a, b""), pair(b"no recording", a)]
}

fn files(bytes: &[u8]) {
    let Some((length, rest)) = bytes.split_first_chunk::<4>() else { return };
    let (a, b) = rest.split_at((u32::from_le_bytes(*length) as usize).min(rest.len()));
    FILES.with(|[one, other]| {
        let read = |path| Side::read(path, true, |_| ());
        if let (Ok(a), Ok(b)) = (read(one.with(a)), read(other.with(b))) {
            compare(&a, &b, 0.0);
        }
    });
}

/// The beginning of a real recording.
fn recorded() -> (Provenance, Vec<Item>) {
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    let provenance = Provenance { rig_json: rig.to_json(), ..Provenance::default() };
    let mut items: Vec<Item> =
        corpus::camera_fields(36).into_iter().map(|field| Item::Blobs(Box::new(field))).collect();
    for (number, frame) in (1..).zip(corpus::tracker_frames(8)) {
        let (field, instants) = (frame.field, frame.instants);
        items.push(Item::Poses(Box::new(frame)));
        items.push(Item::Step(StepRecord { step: number, field, instants, ..Zeroable::zeroed() }));
        items.push(Item::Handle(HandleState { seq: number, field, tool: 1, ..Zeroable::zeroed() }));
    }
    items.push(Item::Event(Event { kind: 1, field: items.len() as u64, ..Zeroable::zeroed() }));
    items.truncate(MESSAGES);
    (provenance, items)
}

/// Nothing changed; a number of each message; messages taken away; everything of one recording taken away.
fn item_pairs() -> Vec<Vec<u8>> {
    let patch =
        |message: u8, number: u8, value: f64| [&[message, number, 0, 0][..], &value.to_le_bytes()].concat();
    let many = |of: std::ops::Range<u8>, number: u8| {
        [vec![0], of.flat_map(|message| patch(message, number, 1e300)).collect()].concat()
    };
    vec![
        vec![0],
        [vec![1], patch(3, 2, f64::NAN)].concat(),
        many(64..90, DROPS),
        many(64..100, 5),
        vec![0x80],
    ]
}

/// The first byte: bit 7 takes all of the second recording away, bit 6 its rig, bit 5 renumbers it, the others are
/// the tolerance, µm.
fn items(bytes: &[u8]) {
    let Some((how, patches)) = bytes.split_first() else { return };
    ITEMS.with_borrow(|(provenance, items)| {
        let a = Side::of_items(provenance.clone(), patched(items, 0, patches));
        let mut other = provenance.clone();
        if how & 0x40 != 0 {
            other.rig_json = String::from_utf8_lossy(patches).into_owned();
        }
        let mut second = if how & 0x80 != 0 { Vec::new() } else { patched(items, 1, patches) };
        if how & 0x20 != 0 {
            second.iter_mut().for_each(renumber);
        }
        let b = Side::of_items(other, second);
        compare(&a, &b, f64::from(how & 0x1f));
    });
}

/// Numbers that the other recording has not.
fn renumber(item: &mut Item) {
    match item {
        Item::Blobs(field) => field.field = field.field.wrapping_add(1 << 40),
        Item::Poses(frame) => frame.field = frame.field.wrapping_add(1 << 40),
        Item::Step(step) => step.field = step.field.wrapping_add(1 << 40),
        Item::Event(event) => event.field = event.field.wrapping_add(1 << 40),
        _ => {}
    }
}

/// The messages of one of the recordings with the patches that are meant for them; one that is no valid message
/// then is left out, as a reader does.
fn patched(items: &[Item], side: u8, patches: &[u8]) -> Vec<Item> {
    let own = |at: usize| {
        patches.as_chunks::<PATCH>().0.iter().filter(move |patch| {
            let to = usize::from(patch[0]);
            to / MESSAGES % 2 == usize::from(side) && to % MESSAGES == at
        })
    };
    let changed = |(at, item): (usize, &Item)| {
        if own(at).any(|patch| patch[1] == DROPS) {
            return None;
        }
        match item {
            Item::Blobs(field) => set(&**field, own(at)).map(|field| Item::Blobs(Box::new(field))),
            Item::Poses(frame) => set(&**frame, own(at)).map(|frame| Item::Poses(Box::new(frame))),
            Item::Step(step) => set(step, own(at)).map(Item::Step),
            Item::Handle(handle) => set(handle, own(at)).map(Item::Handle),
            Item::Event(event) => set(event, own(at)).map(Item::Event),
            other => Some(other.clone()),
        }
    };
    items.iter().enumerate().filter_map(changed).collect()
}

fn set<'a, M: Message>(message: &M, patches: impl Iterator<Item = &'a [u8; PATCH]>) -> Option<M> {
    let mut message = *message;
    let mut known: Option<Vec<Number>> = None;
    for patch in patches {
        let of = known.get_or_insert_with(|| numbers(layout_of::<M>()));
        let [_, number, high, _, value @ ..] = patch;
        let at = usize::from(u16::from_le_bytes([*number, *high])) % of.len();
        of[at].set(bytemuck::bytes_of_mut(&mut message), value);
    }
    message.validate().is_ok().then_some(message)
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::blobs::BlobField;
    use protocol::poses::TrackerFrame;

    #[test]
    fn patches_change_one_recording_and_drop_messages() {
        let (provenance, all) = recorded();
        let count = |bytes: &[u8], side| patched(&all, side, bytes).len();
        let drop = [MESSAGES as u8, DROPS, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!((count(&drop, 0), count(&drop, 1)), (all.len(), all.len() - 1));
        let side = |bytes: &[u8], which| Side::of_items(provenance.clone(), patched(&all, which, bytes));
        let same = Comparison::of(&side(&[], 0), &side(&[], 1), 0.0);
        assert!(same.same && same.inputs.fields_compared == 36 && same.poses.frames_compared == 8);
        let other = Comparison::of(&side(&drop, 0), &side(&drop, 1), 0.0);
        assert!(!other.same && other.inputs.fields_missing == 1, "{:?}", other.stages);
    }

    #[test]
    fn each_kind_of_message_can_be_patched() {
        let (_, all) = recorded();
        let topics: std::collections::BTreeSet<_> = all.iter().map(Item::topic).collect();
        for topic in [BlobField::CHANNEL, TrackerFrame::CHANNEL, "steps", "handles", "events"] {
            assert!(topics.contains(topic), "{topic}: {topics:?}");
        }
    }
}
