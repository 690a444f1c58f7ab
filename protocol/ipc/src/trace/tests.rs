//! The trace of one process: what is noted, what is left to the launcher, and that nothing is where none is
//! wanted.

use super::part::{TracePart, take_all};
use super::*;
use proptest::prelude::*;

fn trace(spans: Option<u32>, directory: &Path) -> Trace {
    Trace::start(Process::Tracker, TraceArgs { trace_spans: spans }, directory)
}

#[test]
fn spans_lie_between_the_readings_of_the_clock_and_phases_follow_without_a_gap() {
    let folder = tempfile::tempdir().unwrap();
    let mut trace = trace(Some(100), folder.path());
    let (about, before) = (About::field(7), now());
    let begun = trace.begin();
    let mut laps = trace.laps(about).unwrap();
    [Phase::Observe, Phase::Predict, Phase::Associate].into_iter().for_each(|phase| laps.ended(phase));
    trace.end(Phase::Track, About::camera(7, 2), begun);
    let part = trace.part().unwrap();
    let names: Vec<_> = part.spans.iter().map(|s| s.phase().unwrap().name()).collect();
    assert_eq!(names, ["observe", "predict", "associate", "track"]);
    let [observe, predict, associate, track] = part.spans[..] else { panic!("{part:?}") };
    assert_eq!([observe.end_ns(), predict.end_ns()], [predict.start_ns, associate.start_ns]);
    assert!(before <= track.start_ns && track.start_ns <= observe.start_ns);
    assert!(associate.end_ns() <= track.end_ns() && track.end_ns() <= now());
    assert_eq!((track.field, track.camera(), observe.camera()), (7, Some(2), None));
}

#[test]
fn a_process_that_does_not_trace_reads_no_clock_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut trace = trace(None, folder.path());
    let about = About::field(1);
    assert_eq!((trace.begin(), trace.end(Phase::Track, about, 0)), (0, 0));
    trace.note(Phase::Track, about, [1, 2]);
    assert!(trace.laps(about).is_none() && trace.part().is_none());
    trace.leave();
    assert_eq!(take_all(folder.path()).unwrap(), []);
}

#[test]
fn what_is_left_is_taken_once_and_nothing_remains() {
    let folder = tempfile::tempdir().unwrap();
    let mut trace = trace(Some(3), folder.path());
    (0..5).for_each(|field| trace.note(Phase::Track, About::field(field), [field, field + 1]));
    let kept = trace.part().unwrap();
    trace.leave();
    std::fs::write(folder.path().join("simcore-1.trace"), "half of a head").unwrap();
    std::fs::write(folder.path().join("tracker.log"), "not of the trace").unwrap();
    assert_eq!(take_all(folder.path()).unwrap(), std::slice::from_ref(&kept));
    let fields: Vec<u64> = kept.spans.iter().map(|span| span.field).collect();
    assert_eq!((fields, kept.recorded, kept.is_wrapped()), (vec![2, 3, 4], 5, true));
    assert_eq!(take_all(folder.path()).unwrap(), []);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "the log alone");
}

#[test]
fn a_process_whose_launcher_is_gone_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut trace = trace(Some(3), folder.path());
    trace.note(Phase::Track, About::field(0), [0, 1]);
    trace.on.as_mut().unwrap().launcher = Pid::from_raw(i32::MAX);
    trace.leave();
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_span_that_is_longer_than_its_number_holds_is_as_long_as_that() {
    let long = span(Phase::Step, About::field(1), [5, 5 + (1 << 40)]);
    assert_eq!(long.end_ns(), 5 + u64::from(u32::MAX));
    assert_eq!(span(Phase::Step, About::field(1), [9, 5]).duration_ns, 0, "a clock never goes back");
    assert_eq!(About::camera(1, u32::MAX), About::field(1));
}

proptest! {
    #[test]
    fn parts_are_read_as_they_were_written(fields in prop::collection::vec(any::<u64>(), 0..50), lost: u32) {
        let spans = fields.iter().map(|&field| span(Phase::Scan, About::camera(field, 1), [field, u64::MAX]));
        let spans: Vec<Span> = spans.collect();
        let recorded = spans.len() as u64 + u64::from(lost);
        let part = TracePart { process: Process::FpgaModel, pid: 9, recorded, spans };
        prop_assert_eq!(TracePart::parse(&part.to_bytes()).unwrap(), part);
    }

    #[test]
    fn no_bytes_make_a_reader_fail(bytes in prop::collection::vec(any::<u8>(), 0..200), cut in 0usize..120) {
        let _ = TracePart::parse(&bytes);
        let spans = vec![span(Phase::Scan, About::field(1), [1, 2]); 3];
        let whole = TracePart { process: Process::Desk, pid: 9, recorded: 3, spans }.to_bytes();
        let cut = cut.min(whole.len());
        prop_assert_eq!(TracePart::parse(&whole[..cut]).is_ok(), cut == whole.len());
    }
}
