//! `vitreo run --trace-out`: every process has its track, spans nest, and a field is led from its camera to its
//! picture; what is missing is reported, and nothing is left over.

use protocol::health::{Process, STATE_RUNNING};
use protocol::phases::Phase;
use protocol::steps::StepRecord;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use vitreo_tests::{Observer, Running, instance_name, interrupt, json, kill, next, vitreo};

/// A trace that was read.
struct Read {
    events: Vec<Value>,
    about: Value,
}

/// The slices of one track.
type Track<'a> = Vec<&'a Value>;

impl Read {
    fn of(file: &Path) -> Self {
        let mut all = json(file);
        let events = all["traceEvents"].as_array().expect("a list of events").clone();
        Read { events, about: all["otherData"].take() }
    }

    /// Names of processes by id.
    fn processes(&self) -> BTreeMap<u64, String> {
        let named = self.events.iter().filter(|e| e["name"] == "process_name");
        named.map(|e| (id(e, "pid"), e["args"]["name"].as_str().expect("a name").to_owned())).collect()
    }

    fn slices(&self) -> impl Iterator<Item = &Value> {
        self.events.iter().filter(|e| e["ph"] == "X")
    }

    /// Slices of this name in processes of this one.
    fn named(&self, process: Process, name: &str) -> Vec<&Value> {
        let processes = self.processes();
        let of = |e: &&Value| e["name"] == name && processes[&id(e, "pid")] == process.name();
        self.slices().filter(of).collect()
    }

    /// Phases of the processes of the run that no span has.
    fn absent(&self, without: &[Phase]) -> Vec<&'static str> {
        let there: BTreeSet<String> = self.processes().into_values().collect();
        let due = Phase::ALL.iter().filter(|p| there.contains(p.process().name()) && !without.contains(p));
        due.filter(|p| self.named(p.process(), p.name()).is_empty()).map(|p| p.name()).collect()
    }

    /// By flow: the processes that it leads through, in their order, and the instants, µs.
    fn flows(&self) -> Vec<Vec<(String, f64)>> {
        let processes = self.processes();
        let mut flows = BTreeMap::<u64, Vec<&Value>>::new();
        for event in self.events.iter().filter(|e| e["cat"] == "field") {
            flows.entry(id(event, "id")).or_default().push(event);
        }
        let stop = |e: &&Value| (processes[&id(e, "pid")].clone(), number(e, "ts"));
        let mut all = Vec::new();
        for events in flows.values_mut() {
            events.sort_by(|a, b| number(a, "ts").total_cmp(&number(b, "ts")));
            let marks: String = events.iter().filter_map(|e| e["ph"].as_str()).collect();
            assert!(marks.starts_with('s') && marks.ends_with('f'), "{marks}");
            assert!(marks[1..marks.len() - 1].chars().all(|c| c == 't'), "{marks}");
            all.push(events.iter().map(stop).collect());
        }
        all
    }

    /// On each track a slice lies in another one or beside it, and each arrow begins on a slice.
    fn is_sound(&self) {
        let mut tracks = BTreeMap::<u64, Track>::new();
        for slice in self.slices() {
            assert!(slice["args"]["field"].is_u64(), "{slice}");
            tracks.entry(id(slice, "tid")).or_default().push(slice);
        }
        for (track, slices) in &mut tracks {
            slices.sort_by(|a, b| {
                number(a, "ts")
                    .total_cmp(&number(b, "ts"))
                    .then(number(b, "dur").total_cmp(&number(a, "dur")))
            });
            let mut open: Vec<(f64, &Value)> = Vec::new();
            for slice in slices {
                let (from, to) = (number(slice, "ts"), number(slice, "ts") + number(slice, "dur"));
                // Sums of numbers of 10¹² µs are exact to a quarter of a nanosecond.
                open.retain(|(end, _)| *end > from + 4e-4);
                if let Some((end, outer)) = open.last() {
                    assert!(to <= end + 4e-4, "on track {track} {slice} reaches out of {outer}");
                }
                open.push((to, slice));
            }
        }
        let begins: BTreeSet<(u64, String)> =
            self.slices().map(|e| (id(e, "tid"), e["ts"].to_string())).collect();
        for arrow in self.events.iter().filter(|e| e["cat"] == "field") {
            assert!(begins.contains(&(id(arrow, "tid"), arrow["ts"].to_string())), "{arrow} is on no slice");
        }
    }
}

fn id(event: &Value, key: &str) -> u64 {
    event[key].as_u64().unwrap_or_else(|| panic!("{key} in {event}"))
}

fn number(event: &Value, key: &str) -> f64 {
    event[key].as_f64().unwrap_or_else(|| panic!("{key} in {event}"))
}

/// What was left of an instance.
fn left_over(name: &str) -> bool {
    ipc::instance_directory(name).expect("a valid name").exists()
}

#[test]
fn every_process_has_its_track_and_a_field_is_led_to_its_picture() {
    if let Err(e) = renderer::gpu::Gpu::headless() {
        return println!("skipped: {e}");
    }
    let (folder, name) = (tempfile::tempdir().expect("folder"), instance_name());
    let path = |file: &str| folder.path().join(file).display().to_string();
    let (trace, report) = (path("trace.json"), path("report.json"));
    let run = ["run", "--headless", "--duration", "3", "--instance", &name, "--report", &report];
    let told = vitreo(&[&run[..], &["--trace-out", &trace]].concat()).expect_code(0).stderr;
    let read = Read::of(Path::new(&trace));
    read.is_sound();
    let names: BTreeSet<String> = read.processes().into_values().collect();
    assert_eq!(
        names.iter().collect::<Vec<_>>(),
        ["fpga-model", "renderer", "simcore", "tracker", "virtual-rig"]
    );
    // What is made without pixels; and what only some devices report.
    let without = [Phase::MakeBlobs, Phase::SendBlobs, Phase::GpuShadow, Phase::GpuPicture, Phase::GpuFocus];
    assert_eq!(read.absent(&without), Vec::<&str>::new());
    let report = json(Path::new(&report));
    for (channel, process, phase) in [
        ("blobs", Process::FpgaModel, Phase::SendScanned),
        ("poses", Process::Tracker, Phase::Track),
        ("steps", Process::Simcore, Phase::Step),
        ("frames", Process::Renderer, Phase::Picture),
    ] {
        let (spans, counted) = (read.named(process, phase.name()).len() as u64, &report["received"][channel]);
        println!("{channel}: {spans} spans, {counted} received");
        assert!(spans >= counted.as_u64().expect("a count") && spans > 0, "{channel}: {spans} of {counted}");
    }
    let flows = read.flows();
    let way = ["virtual-rig", "fpga-model", "tracker", "simcore", "renderer"];
    let whole = |flow: &&Vec<(String, f64)>| {
        let first = |name: &str| flow.iter().find(|(process, _)| process == name).map(|(_, at)| *at);
        let instants: Option<Vec<f64>> = way.iter().map(|name| first(name)).collect();
        instants.is_some_and(|instants| instants.is_sorted())
    };
    println!("{} fields, {} from camera to picture; {told}", flows.len(), flows.iter().filter(whole).count());
    assert!(flows.iter().any(|flow| whole(&flow)), "{flows:?}");
    assert!(told.contains("the trace holds") && told.contains("5 processes"), "{told}");
    assert!(!left_over(&name), "the parts went with the run");
    let before = std::fs::read(&trace).expect("the trace");
    let refused = vitreo(&["run", "--no-picture", "--duration", "1", "--trace-out", &trace]).expect_code(1);
    assert!(refused.stderr.contains("--force"), "{}", refused.stderr);
    assert_eq!(std::fs::read(&trace).expect("the trace"), before);
}

#[test]
fn a_process_that_was_killed_is_missing_and_said_to_be() {
    let (folder, name) = (tempfile::tempdir().expect("folder"), instance_name());
    let trace = folder.path().join("trace.json");
    let run = ["run", "--no-picture", "--direct", "--duration", "90", "--instance", &name];
    let traced = ["--trace-seconds", "180", "--trace-out", &trace.display().to_string()];
    let running = Running::start(&[&run[..], &traced].concat());
    let mut observer = Observer::join(&name);
    let mut steps = observer.receiver::<StepRecord>();
    let health = observer.health(Process::Tracker, |h| h.state == STATE_RUNNING);
    let before = next(&mut steps, |s| s.step >= 60);
    kill(health.pid);
    let reborn = observer.health(Process::Tracker, |h| h.pid != health.pid && h.state == STATE_RUNNING);
    next(&mut steps, |s| s.instants.exposed > before.instants.exposed + 1_000_000_000);
    drop((steps, observer));
    vitreo(&["ctl", "quit", "--instance", &name]).expect_code(0);
    let told = running.finish().expect_code(0).stderr;
    let missing = format!("tracker (process {}) ended without writing its spans", health.pid);
    assert!(told.contains(&missing), "{told}");
    let read = Read::of(&trace);
    read.is_sound();
    assert!(read.about["missing"][0].as_str().is_some_and(|text| text.contains(&missing)), "{}", read.about);
    assert!(read.events.iter().any(|e| e["ph"] == "i" && id(e, "pid") == u64::from(health.pid)));
    let trackers: BTreeSet<u64> =
        read.named(Process::Tracker, "track").iter().map(|span| id(span, "pid")).collect();
    assert_eq!(trackers, BTreeSet::from([u64::from(reborn.pid)]), "the one that lived to the end");
    // The simulation lived through both.
    let steps = read.named(Process::Simcore, "step");
    assert!(number(steps[0], "ts") < before.instants.stepped as f64 * 1e-3);
    let without = [Phase::Paint];
    assert_eq!(read.absent(&without), Vec::<&str>::new());
    assert!(!left_over(&name));
}

#[test]
fn a_run_that_is_interrupted_has_its_trace_and_keeps_to_its_length() {
    let (folder, name) = (tempfile::tempdir().expect("folder"), instance_name());
    let trace = folder.path().join("trace.json");
    let run = ["run", "--no-picture", "--direct", "--instance", &name, "--trace-seconds", "1"];
    let running = Running::start(&[&run[..], &["--trace-out", &trace.display().to_string()]].concat());
    let observer = Observer::join(&name);
    let mut steps = observer.receiver::<StepRecord>();
    next(&mut steps, |s| s.step >= 120);
    interrupt(running.pid());
    drop((steps, observer));
    let told = running.finish().expect_code(0).stderr;
    assert!(told.contains("the trace holds the last "), "{told}");
    let read = Read::of(&trace);
    read.is_sound();
    let from = read.slices().map(|slice| number(slice, "ts")).fold(f64::MAX, f64::min);
    let to = read.slices().map(|slice| number(slice, "ts") + number(slice, "dur")).fold(0.0, f64::max);
    assert!((0.0..=1.0e6).contains(&(to - from)) && to > from, "{} µs", to - from);
    assert!(!left_over(&name));
}

#[test]
fn a_desk_has_its_track_too() {
    let (folder, name) = (tempfile::tempdir().expect("folder"), instance_name());
    let trace = folder.path().join("trace.json");
    let inputs = "tests/data/inputs/navigation-1.txt";
    let play = ["play", "navigation", "--inputs", inputs, "--no-picture", "--instance", &name];
    let running = Running::start(&[&play[..], &["--trace-out", &trace.display().to_string()]].concat());
    let observer = Observer::join(&name);
    let mut steps = observer.receiver::<StepRecord>();
    next(&mut steps, |s| s.step >= 30);
    drop((steps, observer));
    vitreo(&["ctl", "quit", "--instance", &name]).expect_code(0);
    running.finish().expect_code(0);
    let read = Read::of(&trace);
    read.is_sound();
    assert_eq!(read.processes().into_values().collect::<BTreeSet<_>>().len(), 2);
    assert_eq!(read.absent(&[]), Vec::<&str>::new());
    let led = |flow: &&Vec<(String, f64)>| flow[0].0 == "desk" && flow.iter().any(|(to, _)| to == "simcore");
    assert!(read.flows().iter().filter(led).count() >= 25);
}

#[test]
fn a_length_without_a_trace_and_one_out_of_range_are_refused() {
    for (words, expected) in [
        (&["--trace-seconds", "5"][..], "--trace-out"),
        (&["--trace-out", "t.json", "--trace-seconds", "0"], "from 1 to 600"),
        (&["--trace-out", "t.json", "--trace-seconds", "601"], "from 1 to 600"),
    ] {
        let refused =
            vitreo(&[&["run", "--no-picture", "--duration", "1"][..], words].concat()).expect_code(2);
        assert!(refused.stderr.contains(expected), "{}", refused.stderr);
    }
}
