//! The file of a trace: valid JSON whatever it is made of, slices that nest, arrows along the way of a field.

use super::*;
use crate::trace::{About, span};
use proptest::prelude::*;

/// A part of spans: phase, field, from, to.
fn part(process: Process, pid: u32, spans: &[(Phase, u64, u64, u64)]) -> TracePart {
    let spans: Vec<Span> =
        spans.iter().map(|&(phase, field, from, to)| span(phase, About::field(field), [from, to])).collect();
    TracePart { process, pid, recorded: spans.len() as u64, spans }
}

fn written(trace: &FieldTrace) -> (Vec<Value>, Value, Figures) {
    let mut bytes = Vec::new();
    let figures = trace.write(&mut bytes).unwrap();
    let mut all: Value = serde_json::from_slice(&bytes).expect("valid JSON");
    let events = all["traceEvents"].take();
    (events.as_array().expect("a list").clone(), all["otherData"].take(), figures)
}

/// A run of `fields` fields, 20 ms apart, from the cameras to the picture.
fn run(fields: u64) -> FieldTrace {
    let at = |field: u64, us: u64| 5_000_000_000 + field * 20_000_000 + us * 1000;
    let of = |spans: &[(Phase, u64, u64)]| -> Vec<(Phase, u64, u64, u64)> {
        let one = |field| {
            spans.iter().map(move |&(phase, from, to)| (phase, field, at(field, from), at(field, to)))
        };
        (0..fields).flat_map(one).collect()
    };
    let parts = vec![
        part(Process::FpgaModel, 20, &of(&[(Phase::Scan, 100, 900), (Phase::SendScanned, 9000, 9010)])),
        part(Process::Tracker, 30, &of(&[(Phase::Associate, 9100, 9150), (Phase::Track, 9100, 9200)])),
        part(Process::Simcore, 40, &of(&[(Phase::Tissue, 9300, 9600), (Phase::Step, 9300, 9700)])),
        part(
            Process::Renderer,
            50,
            &of(&[
                (Phase::Latch, 9800, 9810),
                (Phase::GpuPicture, 9900, 15_000),
                (Phase::Picture, 9750, 16_000),
            ]),
        ),
    ];
    FieldTrace { parts, missing: Vec::new(), seconds: 30.0, origin: 5_000_000_000 }
}

#[test]
fn a_field_is_led_from_the_camera_to_its_picture() {
    let (events, about, figures) = written(&run(3));
    let slice = |name: &str| {
        events.iter().find(|e| e["ph"] == "X" && e["name"] == name && e["args"]["field"] == 1).unwrap()
    };
    assert_eq!(slice("tissue")["ts"].as_f64(), Some(5_029_300.0));
    assert_eq!((slice("tissue")["dur"].as_f64(), &slice("tissue")["pid"]), (Some(300.0), &40.into()));
    assert_ne!(slice("both channels")["tid"], slice("picture")["tid"], "the device has a track of its own");
    let way: Vec<_> = events.iter().filter(|e| e["cat"] == "field" && e["id"] == 1).collect();
    let marks: Vec<_> = way.iter().map(|e| (e["ph"].as_str().unwrap(), e["pid"].as_u64().unwrap())).collect();
    assert_eq!(marks, [("s", 20), ("t", 30), ("t", 40), ("t", 50), ("f", 50)]);
    assert!(way.iter().all(|e| e["ph"] != "f" || e["bp"] == "e"));
    assert_eq!((figures.fields, figures.to_picture, figures.processes), (3, 3, 4));
    assert_eq!(about["held"], figures.text());
    assert!(
        figures.text().starts_with("the trace holds 0.1 s: 27 spans of 4 processes"),
        "{}",
        figures.text()
    );
}

#[test]
fn tracks_are_named_in_the_order_of_the_data_path() {
    let (events, _, _) = written(&run(1));
    let named = |what: &str, key: &str| -> Vec<Value> {
        events.iter().filter(|e| e["name"] == what).map(|e| e["args"][key].clone()).collect()
    };
    assert_eq!(named("process_name", "name"), ["fpga-model", "tracker", "simcore", "renderer"]);
    assert_eq!(named("process_sort_index", "sort_index"), [1, 2, 3, 4]);
    assert!(named("thread_name", "name").contains(&"graphics device".into()));
}

#[test]
fn what_is_older_than_the_trace_is_left_out_on_every_track() {
    let (events, _, figures) = written(&FieldTrace { seconds: 0.5, ..run(100) });
    let fields: BTreeSet<u64> = events.iter().filter_map(|e| e["args"]["field"].as_u64()).collect();
    assert_eq!((fields.first(), fields.len()), (Some(&75), 25));
    assert!(figures.is_cut && figures.text().contains("the last 0.5 s"), "{}", figures.text());
}

#[test]
fn a_ring_that_was_too_small_says_from_when_on_its_spans_are_there() {
    let mut trace = run(10);
    let simulation = &mut trace.parts[2];
    simulation.spans.drain(..8);
    let (events, _, figures) = written(&trace);
    let label = events.iter().find(|e| e["name"] == "process_labels").expect("a label");
    assert_eq!(
        (&label["pid"], &label["args"]["labels"]),
        (&40.into(), &"spans before 5089300.000 µs are lost".into())
    );
    assert!(figures.is_cut);
}

#[test]
fn a_process_that_left_nothing_is_named_with_its_time() {
    let missing = Missing { process: Process::Tracker, pid: 31, from_to: [5_500_000_000, 7_000_000_000] };
    let (events, about, _) = written(&FieldTrace { missing: vec![missing], ..run(1) });
    let told = "tracker (process 31) ended without writing its spans, from 0.5 to 2.0 s";
    assert_eq!(about["missing"], json!([told]));
    let named = |name: &str| events.iter().find(|e| e["pid"] == 31 && e["name"] == name).unwrap();
    assert_eq!(named("process_name")["args"]["name"], "tracker");
    assert_eq!((&named(told)["ph"], &named(told)["ts"]), (&"i".into(), &7_000_000.into()));
}

#[test]
fn a_number_that_comes_again_is_another_field() {
    let spans = |at: u64| [(Phase::Scan, 3, at, at + 10), (Phase::Assemble, 3, at + 50, at + 60)];
    let parts = vec![part(Process::Tracker, 1, &[spans(1_000), spans(3_000_000_000)].concat())];
    let (events, _, figures) = written(&FieldTrace { parts, seconds: 30.0, ..FieldTrace::default() });
    let ids: BTreeSet<u64> = events.iter().filter_map(|e| e["id"].as_u64()).collect();
    assert_eq!((ids.len(), figures.fields), (2, 2));
}

proptest! {
    #[test]
    fn any_spans_make_a_valid_file(
        spans in prop::collection::vec((any::<u16>(), any::<u64>(), any::<u64>(), any::<u64>()), 0..60),
        seconds in 0.0..100.0f64, lost: u32, origin: u64,
    ) {
        let place = |code: u16| Phase::ALL[usize::from(code) % Phase::ALL.len()];
        let spans: Vec<_> = spans.into_iter().map(|(code, f, a, b)| (place(code), f % 4, a, b)).collect();
        let mut part = part(Process::Simcore, 4, &spans);
        part.recorded += u64::from(lost);
        let missing = vec![Missing { process: Process::Desk, pid: 5, from_to: [origin, u64::MAX] }];
        let (events, _, figures) = written(&FieldTrace { parts: vec![part], missing, seconds, origin });
        prop_assert_eq!(events.iter().filter(|e| e["ph"] == "X").count(), figures.spans);
        for mark in ["s", "f"] {
            prop_assert_eq!(events.iter().filter(|e| e["ph"] == mark).count(), figures.fields);
        }
    }
}
