//! A camera played from a script: its buffers, its driver's errors, and its coming and going.

use super::*;
use crate::device::{Stamp, StampClock};
use crate::process::line::Line;
use fpga_model::input::packed::Packing;
use rig::Rig;
use std::collections::VecDeque;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{channel, sync_channel};

const MS: u64 = 1_000_000;
const P: u64 = 20 * MS;
/// The instant at which every buffer is looked at: their stamps are before it.
const NOW: Nanos = 900_000 * MS;
/// `V4L2_FIELD_INTERLACED` and `V4L2_FIELD_ALTERNATE`'s two.
const INTERLACED: u32 = 4;
const TOP: u32 = 2;
const BOTTOM: u32 = 3;

/// What a scripted driver does next.
#[derive(Clone)]
enum Act {
    /// A buffer of one luma: stamp, sequence, field, bytes that are missing.
    Bring(u8, Nanos, u32, u32, usize),
    /// A buffer that the driver marks as damaged.
    Damage(u32),
    /// An error by its number.
    Fail(i32),
    /// Nothing comes in time.
    Nothing,
    /// The end of the script: the process ends.
    Stop,
}

/// A camera that follows a script, one of each opening.
struct Script {
    acts: VecDeque<Act>,
    layout: Layout,
    stop: Arc<AtomicBool>,
    bytes: Vec<u8>,
}

struct Scripts {
    openings: VecDeque<Option<Vec<Act>>>,
    lines: u32,
    stop: Arc<AtomicBool>,
}

impl Open for Scripts {
    fn open(&mut self) -> Result<Box<dyn Device>> {
        let Some(opening) = self.openings.pop_front() else {
            self.stop.store(true, Ordering::Relaxed);
            return Err(Absent.into());
        };
        let acts = opening.ok_or(Absent)?.into();
        let layout = Layout::of(Packing::Yuyv, 32, self.lines, 0)?;
        Ok(Box::new(Script { acts, layout, stop: Arc::clone(&self.stop), bytes: Vec::new() }))
    }
}

impl Device for Script {
    fn layout(&self) -> Layout {
        self.layout
    }

    fn notes(&self) -> (String, Option<String>) {
        ("gain 4".into(), None)
    }

    fn next(&mut self, _wait_ms: i64) -> io::Result<Option<Buffer<'_>>> {
        let (luma, ns, sequence, field, missing, damage) = match self.acts.pop_front() {
            Some(Act::Bring(luma, ns, sequence, field, missing)) => {
                (luma, ns, sequence, field, missing, None)
            }
            Some(Act::Damage(sequence)) => (
                99,
                NOW - 800 * MS + u64::from(sequence) * 2 * P,
                sequence,
                INTERLACED,
                0,
                Some("lacks packets"),
            ),
            Some(Act::Fail(number)) => return Err(io::Error::from_raw_os_error(number)),
            Some(Act::Nothing) => return Ok(None),
            Some(Act::Stop) | None => {
                self.stop.store(true, Ordering::Relaxed);
                return Ok(None);
            }
        };
        self.bytes = [luma, 128].repeat(self.layout.bytes() / 2);
        self.bytes.truncate(self.layout.bytes() - missing);
        let stamp = Stamp { ns, clock: StampClock::Monotonic, is_start: false };
        Ok(Some(Buffer { bytes: &self.bytes, stamp, sequence, field, damage }))
    }
}

/// Messages about a camera with frames of 32 × 16 px that delivers buffers of `lines` lines.
fn told(openings: &[Option<&[Act]>], lines: u32) -> Vec<Told> {
    told_of(openings, lines, false)
}

fn told_of(openings: &[Option<&[Act]>], lines: u32, is_triggered: bool) -> Vec<Told> {
    let mut rig = Rig::load_or_shipped(None).expect("the shipped rig");
    (rig.cameras[0].width, rig.cameras[0].height) = (32, 16);
    let stop = Arc::<AtomicBool>::default();
    let openings = openings.iter().map(|acts| acts.map(<[Act]>::to_vec)).collect();
    let opener = Box::new(Scripts { openings, lines, stop: Arc::clone(&stop) });
    let (outbox, inbox) = sync_channel(1_000);
    let (_spare, spares) = channel();
    let (sensor, bell) = (rig.sensors()[0], ipc::Bell::new().expect("a bell"));
    let role = Role { frame_px: [32, 16], scan: sensor.scan };
    let clock = || (NOW, 0);
    let rope = bell.rope();
    let line = Line { outbox, spare: spares, rope, stop };
    LiveReader { opener, role, sensor, period_ns: P, clock, is_triggered, line }.run();
    inbox.try_iter().collect()
}

/// In words: `o`pened, a picture as its luma, `c`losed, and texts of refusals.
fn words(told: &[Told]) -> Vec<String> {
    let word = |t: &Told| match t {
        Told::Opened { settings, .. } => format!("opened, {settings}"),
        Told::Picture(p) => {
            let lost = p.taken.map_or(0, |t| t.lost);
            let first = if p.is_first { ", first" } else { "" };
            let odd = if p.taken.is_some_and(|t| t.is_odd) { ", odd" } else { "" };
            let lost = if lost > 0 { format!(", {lost} lost") } else { String::new() };
            format!("picture {}{first}{lost}{odd}", p.picture.luma[0])
        }
        Told::Closed => "gone".into(),
        Told::Refused(why) => format!("refused: {why}"),
        Told::Over(_) => "over".into(),
    };
    told.iter().map(word).collect()
}

#[test]
fn frames_come_with_their_instants_and_what_was_lost() {
    let bring = |luma, sequence| {
        Act::Bring(luma, NOW - 800 * MS + u64::from(sequence) * 2 * P, sequence, INTERLACED, 0)
    };
    let acts =
        [bring(40, 0), Act::Nothing, bring(41, 1), bring(42, 4), Act::Damage(5), bring(43, 6), Act::Stop];
    let told = told(&[Some(&acts)], 16);
    assert_eq!(
        words(&told),
        [
            "opened, gain 4",
            "picture 40, first",
            "picture 41",
            "picture 42, 2 lost",
            "refused: delivered a picture that lacks packets; it is dropped",
            "picture 43, 1 lost",
        ]
    );
    let Told::Picture(last) = &told[3] else { panic!("a picture") };
    let taken = last.taken.expect("stamped");
    assert_eq!((taken.read_out_ns, taken.jitter_ns), (NOW - 800 * MS + 8 * P, Some(0)));
    assert_eq!((last.arrived_ns, last.parts), (NOW, Parts::woven(0)));
}

#[test]
fn fields_that_come_one_by_one_have_the_parity_that_their_buffer_says() {
    let bring = |k: u64| {
        let field = if k.is_multiple_of(2) { TOP } else { BOTTOM };
        Act::Bring(40, NOW - 500 * MS + k * P, k as u32 / 2, field, 0)
    };
    let acts: Vec<Act> = (0..5).map(bring).chain([Act::Stop]).collect();
    let parities = told(&[Some(&acts)], 8).into_iter().filter_map(|t| match t {
        Told::Picture(p) => {
            assert_eq!(p.taken.map(|t| t.lost), Some(0), "two fields share their count");
            p.parts.all()[0].parity
        }
        _ => None,
    });
    assert_eq!(parities.collect::<Vec<u32>>(), [0, 1, 0, 1, 0]);
}

#[test]
fn a_camera_that_is_unplugged_is_told_once_and_taken_up_again() {
    let bring = |luma| Act::Bring(luma, NOW - P, 7, INTERLACED, 0);
    for number in [5, 19] {
        let first = [bring(40), Act::Fail(4), Act::Fail(number)];
        let again = [bring(50), Act::Stop];
        let told = told(&[None, None, Some(&first), None, Some(&again)], 16);
        assert_eq!(
            words(&told),
            ["gone", "opened, gain 4", "picture 40, first", "gone", "opened, gain 4", "picture 50, first"]
        );
    }
}

#[test]
fn a_camera_that_brings_nothing_is_opened_again_unless_it_waits_for_a_trigger() {
    let silent = vec![Act::Nothing; ROUNDS_SILENT as usize + 1];
    let after = |acts: &[Act]| [acts, &[Act::Bring(40, NOW - P, 7, INTERLACED, 0), Act::Stop]].concat();
    let [late, shorter] = [after(&silent), after(&silent[1..])];
    let both = ["opened, gain 4", "opened, gain 4", "picture 40, first"];
    assert_eq!(words(&told(&[Some(&late), Some(&after(&[]))], 16)), both);
    assert_eq!(words(&told(&[Some(&shorter)], 16)), both[1..]);
    assert_eq!(words(&told_of(&[Some(&late)], 16, true)), both[1..]);
}

#[test]
fn stamps_that_jump_do_not_carry_the_pictures_along() {
    let at = |k: u64| NOW - 800 * MS + k * 2 * P;
    let bring = |k: u64, ns| Act::Bring(40, ns, k as u32, INTERLACED, 0);
    let hour = 3_600_000 * MS;
    let acts = [
        bring(0, at(0)),
        bring(1, at(1)),
        bring(2, at(2) + hour),
        bring(3, at(0) - 3 * P),
        bring(4, 0),
        Act::Stop,
    ];
    let told = told(&[Some(&acts)], 16);
    assert_eq!(
        words(&told)[1..],
        ["picture 40, first", "picture 40", "picture 40, odd", "picture 40, odd", "picture 40, odd"]
    );
    for pictured in told.iter().filter_map(|t| if let Told::Picture(p) = t { p.taken } else { None }) {
        assert!((at(0)..=NOW).contains(&pictured.read_out_ns), "{pictured:?}");
    }
}

#[test]
fn buffers_that_do_not_fit_are_refused_and_the_reader_lives_on() {
    let bring = |field, missing| Act::Bring(40, NOW - P, 1, field, missing);
    let short = [bring(INTERLACED, 100), bring(INTERLACED, 0), Act::Stop];
    let words_of = |acts: &[Act], lines| words(&told(&[Some(acts)], lines));
    let short = words_of(&short, 16);
    assert!(short[1].contains("dropped: expected 1024 bytes of samples, found 924"), "{short:?}");
    assert_eq!(short[2], "picture 40, first, 1 lost");
    let other = words_of(&[bring(INTERLACED, 0)], 12);
    assert!(
        other[1].contains("interlaced frames of 32×12 px; the rig expects frames of 32×16 px"),
        "{other:?}"
    );
    let failing = words_of(&[Act::Fail(22)], 16);
    assert!(failing[1].contains("refused: fails: Invalid argument"), "{failing:?}");
}
