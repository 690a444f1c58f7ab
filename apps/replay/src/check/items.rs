//! What the items of a recording must be to each other: in order, without gaps, their instants in the order
//! of cause. Pure; takes items, not files.

use protocol::time::{Instants, Nanos};
use recording::{Item, NoteKind};
use serde::Serialize;
use std::collections::BTreeMap;

/// How far an item may stand behind a later one, ns: the recorder writes what comes from several processes.
const BEHIND_NS: Nanos = 500_000_000;
/// Problems of a kind that are kept in words.
const KEPT: usize = 3;

/// One of the things that are checked.
#[derive(Debug, Default, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// How much was compared.
    pub compared: u64,
    /// How much of it is not as it should be.
    pub problems: u64,
    /// The first of these.
    pub first: Vec<String>,
}

impl Finding {
    /// Compares something.
    pub fn check(&mut self, holds: bool, problem: impl FnOnce() -> String) {
        self.compared += 1;
        if !holds {
            self.add(1, problem);
        }
    }

    /// Adds what is known to be wrong.
    pub fn add(&mut self, count: u64, problem: impl FnOnce() -> String) {
        self.problems += count;
        if count > 0 && self.first.len() < KEPT {
            self.first.push(problem());
        }
    }
}

/// Looks at the items of a recording, in the order of the file.
#[derive(Debug, Default)]
pub struct Checker {
    /// Log times of each topic.
    pub order: Finding,
    /// Instants within items.
    pub clocks: Finding,
    /// Numbers that should count up by one.
    pub gaps: Finding,
    /// Newest log time by topic.
    newest: BTreeMap<&'static str, Nanos>,
    /// Last number by what is counted.
    last: BTreeMap<(&'static str, u32), u64>,
}

impl Checker {
    /// Looks at the next item.
    pub fn take(&mut self, at: Nanos, item: &Item) {
        let newest = self.newest.entry(item.topic()).or_default();
        let (topic, behind) = (item.topic(), newest.saturating_sub(at));
        self.order.check(behind <= BEHIND_NS, || {
            format!("{topic}: a message of {at} ns comes {} ms after a later one", behind / 1_000_000)
        });
        *newest = (*newest).max(at);
        match item {
            Item::Blobs(field) => {
                let camera = field.camera;
                self.follows(("camera", camera), field.field, 1);
                // Blobs leave once the lines that can show a marker are read out, before the others are.
                let what = format!("camera {camera}, field {}", field.field);
                self.instants(&what, &[field.exposed_ns, field.read_out_ns]);
                self.instants(&what, &[field.exposed_ns, field.blobs_out_ns]);
            }
            Item::Handle(handle) => self.follows(("handle", handle.instrument), handle.seq, 2),
            Item::Pedal(pedal) => self.follows(("pedal", 0), pedal.seq, 1),
            Item::Poses(frame) => {
                self.follows(("tracker frame", 0), frame.frame, 1);
                self.path(&format!("poses, field {}", frame.field), &frame.instants);
            }
            Item::Step(step) => {
                self.follows(("step", 0), step.step, 1);
                self.path(&format!("step {}", step.step), &step.instants);
            }
            Item::Event(event) => self.follows(("event", 0), event.seq, 1),
            Item::Frame(frame) => {
                self.follows(("frame", 0), frame.frame, 1);
                let instants = [frame.frame_start, frame.latched, frame.drawn, frame.displayed];
                self.instants(&format!("frame {}", frame.frame), &instants);
            }
            Item::Note(note) if note.kind == NoteKind::Loss => {
                self.gaps.add(note.count.max(1), || format!("note: {}", note.text));
            }
            _ => {}
        }
    }

    /// The numbers of `what` count up by `by`; they begin again where what makes them is restarted.
    fn follows(&mut self, what: (&'static str, u32), number: u64, by: u64) {
        let Some(last) = self.last.insert(what, number) else { return };
        if number <= last {
            // Both hands share one count, and a restarted process counts from the start.
            return;
        }
        let (name, which) = what;
        let of = if name == "camera" { format!("camera {which}, field") } else { name.to_owned() };
        let missing = (number - last).saturating_sub(1) / by;
        self.gaps.check(missing == 0, || format!("{of}: {number} follows {last}"));
        self.gaps.add(missing.saturating_sub(1), String::new);
    }

    fn path(&mut self, what: &str, instants: &Instants) {
        let Instants { exposed, read_out, blobs_out, taken, tracked, stepped } = *instants;
        self.instants(what, &[exposed, read_out]);
        self.instants(what, &[exposed, blobs_out, taken, tracked, stepped]);
    }

    /// Instants of one item, without those that were not reached, in the order of cause.
    fn instants(&mut self, what: &str, instants: &[Nanos]) {
        let reached: Vec<Nanos> = instants.iter().copied().filter(|at| *at > 0).collect();
        self.clocks.check(reached.is_sorted(), || format!("{what}: instants {reached:?} ns go back"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::blobs::BlobField;
    use protocol::handles::HandleState;
    use protocol::steps::StepRecord;
    use recording::Note;

    fn field(camera: u32, field: u64, instants: [Nanos; 3]) -> Item {
        let [exposed_ns, read_out_ns, blobs_out_ns] = instants;
        Item::Blobs(Box::new(BlobField {
            camera,
            field,
            exposed_ns,
            read_out_ns,
            blobs_out_ns,
            ..Zeroable::zeroed()
        }))
    }

    #[test]
    fn what_is_in_order_is_only_counted() {
        let mut checker = Checker::default();
        for n in 0..10 {
            checker.take(100 + n, &field((n % 2) as u32, 7 + n / 2, [1 + n, 2 + n, 3 + n]));
            let hand = HandleState { seq: n, instrument: (n % 2) as u32, ..Zeroable::zeroed() };
            checker.take(100 + n, &Item::Handle(hand));
        }
        let Checker { order, clocks, gaps, .. } = checker;
        assert_eq!([order.problems, clocks.problems, gaps.problems], [0; 3], "{gaps:?}");
        assert_eq!([order.compared, clocks.compared, gaps.compared], [20, 20, 16]);
    }

    #[test]
    fn what_is_missing_late_or_reversed_is_named() {
        let mut checker = Checker::default();
        checker.take(1_000_000_000, &field(1, 7, [1, 2, 3]));
        checker.take(1_100_000_000, &field(1, 11, [5, 4, 6]));
        checker.take(400_000_000, &field(1, 12, [0, 0, 6]));
        let note = Note {
            instant_ns: 0,
            kind: NoteKind::Loss,
            process: None,
            count: 4,
            text: "4 blocks lost".into(),
        };
        checker.take(1, &Item::Note(note));
        assert_eq!((checker.gaps.problems, checker.clocks.problems, checker.order.problems), (7, 1, 1));
        assert!(checker.gaps.first[0].contains("camera 1, field: 11 follows 7"), "{:?}", checker.gaps);
        assert!(checker.clocks.first[0].contains("field 11"), "{:?}", checker.clocks);
        assert!(checker.order.first[0].contains("700 ms after"), "{:?}", checker.order);
    }

    #[test]
    fn a_count_that_begins_anew_is_no_gap() {
        let mut checker = Checker::default();
        for step in [1, 2, 3, 1, 2] {
            checker.take(step, &Item::Step(StepRecord { step, ..Zeroable::zeroed() }));
        }
        assert_eq!(checker.gaps.problems, 0);
    }
}
