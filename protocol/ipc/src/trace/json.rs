//! The parts of a trace as one file in the Trace Event Format, which ui.perfetto.dev and chrome://tracing
//! open: a track for each process, one more for the graphics device, a slice for each span, and arrows
//! that lead a field from stop to stop. Times are µs of `CLOCK_MONOTONIC`, as the instants of recordings and logs.

use super::Span;
use super::part::TracePart;
use protocol::health::Process;
use protocol::phases::Phase;
use protocol::time::Nanos;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::io::{self, Write};

/// Between two stops of one field less time lies than this, ns. Numbers that come again after more, as after
/// a restart of the attempt, are those of another field.
const SAME_FIELD_NS: u64 = 1_000_000_000;
/// Tracks of the graphics device have ids that no thread of Linux has.
const GPU_TRACK: u64 = 1 << 23;
/// Offset that distinguishes the flows of a field number that came again.
const NEXT_ROUND: u64 = 1 << 40;

/// A process whose spans are not there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Missing {
    /// Which.
    pub process: Process,
    /// Its operating-system id.
    pub pid: u32,
    /// From its first to its last sign of life, ns.
    pub from_to: [Nanos; 2],
}

impl Missing {
    /// For a person; `origin` is the instant from which is counted.
    pub fn text(&self, origin: Nanos) -> String {
        let [from_s, to_s] = self.from_to.map(|at| at.saturating_sub(origin) as f64 * 1e-9);
        let name = self.process.name();
        format!(
            "{name} (process {}) ended without writing its spans, from {from_s:.1} to {to_s:.1} s",
            self.pid
        )
    }
}

/// Everything that a trace is made of.
#[derive(Debug, Clone, Default)]
pub struct FieldTrace {
    /// The parts of the processes.
    pub parts: Vec<TracePart>,
    /// Processes that left none.
    pub missing: Vec<Missing>,
    /// Length of the trace at most, s: what is older than this at its end is left out.
    pub seconds: f64,
    /// When the run began, ns.
    pub origin: Nanos,
}

/// What a trace holds.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Figures {
    /// From its first span to the end of its last, s.
    pub held_s: f64,
    /// Spans.
    pub spans: usize,
    /// Processes.
    pub processes: usize,
    /// Fields that are followed over two stops or more.
    pub fields: usize,
    /// Of these, the ones that are followed to their picture.
    pub to_picture: usize,
    /// Spans from before the trace were left out, or lost.
    pub is_cut: bool,
}

impl Figures {
    /// For a person.
    pub fn text(&self) -> String {
        let Figures { held_s, spans, processes, fields, to_picture, is_cut } = self;
        let held = if *is_cut { format!("the last {held_s:.1} s") } else { format!("{held_s:.1} s") };
        format!(
            "the trace holds {held}: {spans} spans of {processes} processes, {fields} fields, {to_picture} of them \
             to their picture"
        )
    }
}

/// A span with its track.
#[derive(Clone, Copy)]
struct Placed<'a> {
    span: &'a Span,
    phase: Phase,
    pid: u32,
}

impl Placed<'_> {
    fn track(&self) -> u64 {
        u64::from(self.pid) + if self.phase.is_on_gpu() { GPU_TRACK } else { 0 }
    }
}

/// A stop of a field, and the flow that leads there.
struct Stop {
    /// Its place among the spans.
    place: usize,
    flow: u64,
    /// `s` where the flow begins, `t` on the way, `f` at its end.
    mark: char,
}

impl FieldTrace {
    /// True if no process has left a span.
    pub fn is_empty(&self) -> bool {
        self.parts.iter().all(|part| part.spans.is_empty())
    }

    /// Writes the file.
    ///
    /// # Errors
    /// Those of `to`.
    pub fn write(&self, to: &mut impl Write) -> io::Result<Figures> {
        let (placed, begin_ns) = self.placed();
        let (stops, mut figures) = flows(&placed);
        let end_ns = placed.iter().map(|p| p.span.end_ns()).max().unwrap_or(0);
        let first_ns = placed.iter().map(|p| p.span.start_ns).min().unwrap_or(end_ns);
        figures.held_s = (end_ns - first_ns) as f64 * 1e-9;
        figures.spans = placed.len();
        figures.processes = placed.iter().map(|p| p.pid).collect::<BTreeSet<_>>().len();
        let is_cut = |part: &TracePart| part.is_wrapped() || part.spans.iter().any(|s| s.start_ns < begin_ns);
        figures.is_cut = self.parts.iter().any(is_cut);
        let about = json!({
            "clock": "CLOCK_MONOTONIC",
            "held": figures.text(),
            "missing": self.missing.iter().map(|m| m.text(self.origin)).collect::<Vec<_>>(),
            "vitreo": env!("CARGO_PKG_VERSION"),
        });
        write!(to, "{{\"displayTimeUnit\":\"ms\",\"otherData\":{about},\"traceEvents\":[")?;
        let mut events = Events { to, first: true };
        self.write_names(&mut events, begin_ns)?;
        let mut stops = stops.iter().peekable();
        for (place, placed) in placed.iter().enumerate() {
            events.slice(placed)?;
            while let Some(stop) = stops.next_if(|stop| stop.place == place) {
                events.arrow(placed, stop)?;
            }
        }
        writeln!(to, "\n]}}")?;
        Ok(figures)
    }

    /// The spans of the trace's time, by track, the outer of two that begin together first; and when
    /// that time began, ns.
    fn placed(&self) -> (Vec<Placed<'_>>, Nanos) {
        let spans = self.parts.iter().flat_map(|part| part.spans.iter().map(|span| (part.pid, span)));
        let known = spans.filter_map(|(pid, span)| Some(Placed { span, phase: span.phase()?, pid }));
        let mut placed: Vec<_> = known.collect();
        let end_ns = placed.iter().map(|p| p.span.end_ns()).max().unwrap_or(0);
        let begin_ns = end_ns.saturating_sub((self.seconds * 1e9) as u64);
        placed.retain(|p| p.span.start_ns >= begin_ns);
        placed.sort_by_key(|p| (p.track(), p.span.start_ns, std::cmp::Reverse(p.span.duration_ns)));
        (placed, begin_ns)
    }

    /// Names of the tracks, in the order of the data path, with what is missing of them.
    fn write_names(&self, events: &mut Events<impl Write>, begin_ns: Nanos) -> io::Result<()> {
        let order = |process: Process| Process::ALL.iter().position(|p| *p == process);
        let name = |pid: u32, track: u64, what: &str, args: Value| json!({"ph": "M", "pid": pid, "tid": track, "name": what, "args": args});
        let mut tracks: Vec<_> = self.parts.iter().map(|part| (part.process, part.pid)).collect();
        tracks.extend(self.missing.iter().map(|m| (m.process, m.pid)));
        for (process, pid) in tracks {
            let (track, gpu) = (u64::from(pid), u64::from(pid) + GPU_TRACK);
            events.value(&name(pid, track, "process_name", json!({"name": process.name()})))?;
            events.value(&name(pid, track, "process_sort_index", json!({"sort_index": order(process)})))?;
            events.value(&name(pid, track, "thread_name", json!({"name": process.name()})))?;
            if process == Process::Renderer {
                events.value(&name(pid, gpu, "thread_name", json!({"name": "graphics device"})))?;
            }
        }
        for part in self.parts.iter().filter(|part| part.is_wrapped()) {
            let first_ns = part.spans.first().map_or(0, |span| span.start_ns);
            if first_ns > begin_ns {
                let labels = format!("spans before {} µs are lost", micros(first_ns));
                events.value(&name(
                    part.pid,
                    part.pid.into(),
                    "process_labels",
                    json!({"labels": labels}),
                ))?;
            }
        }
        for missing in &self.missing {
            let labels = missing.text(self.origin);
            events.value(&name(
                missing.pid,
                missing.pid.into(),
                "process_labels",
                json!({"labels": labels}),
            ))?;
            events.instant(missing.pid, missing.from_to[1], &labels)?;
        }
        Ok(())
    }
}

/// How spans become flows: one for each field, from stop to stop in their order of time. The stops are in the
/// order of `placed`.
fn flows(placed: &[Placed]) -> (Vec<Stop>, Figures) {
    let mut places: Vec<usize> = (0..placed.len()).filter(|&i| placed[i].phase.is_stop()).collect();
    places.sort_by_key(|&i| (placed[i].span.field, placed[i].span.start_ns));
    let (mut stops, mut figures, mut before) = (Vec::with_capacity(places.len()), Figures::default(), None);
    let start_ns = |i: &usize| placed[*i].span.start_ns;
    let joined = |a: &usize, b: &usize| {
        placed[*a].span.field == placed[*b].span.field && start_ns(b) - start_ns(a) < SAME_FIELD_NS
    };
    for flow in places.chunk_by(joined) {
        let field = placed[flow[0]].span.field;
        let round = before.filter(|(number, _)| *number == field).map_or(0, |(_, round)| round + 1);
        before = Some((field, round));
        if flow.len() < 2 {
            continue;
        }
        figures.fields += 1;
        figures.to_picture += usize::from(flow.iter().any(|&i| placed[i].phase == Phase::Picture));
        stops.extend(flow.iter().enumerate().map(|(k, &place)| Stop {
            place,
            flow: field.wrapping_add(NEXT_ROUND.wrapping_mul(round)),
            mark: if k == 0 {
                's'
            } else if k + 1 == flow.len() {
                'f'
            } else {
                't'
            },
        }));
    }
    stops.sort_by_key(|stop| stop.place);
    (stops, figures)
}

/// The list of events while it is written.
struct Events<'a, W> {
    to: &'a mut W,
    first: bool,
}

impl<W: Write> Events<'_, W> {
    fn separate(&mut self) -> io::Result<()> {
        self.to.write_all(if std::mem::take(&mut self.first) { b"\n" } else { b",\n" })
    }

    fn value(&mut self, event: &Value) -> io::Result<()> {
        self.separate()?;
        write!(self.to, "{event}")
    }

    fn slice(&mut self, placed: &Placed) -> io::Result<()> {
        self.separate()?;
        let Placed { span, phase, pid } = placed;
        let (ts, dur) = (micros(span.start_ns), micros(span.duration_ns.into()));
        // Names are of our own table: nothing in them is to be escaped.
        write!(
            self.to,
            r#"{{"ph":"X","pid":{pid},"tid":{},"ts":{ts},"dur":{dur},"name":"{}","args":{{"field":{}"#,
            placed.track(),
            phase.name(),
            span.field
        )?;
        if let Some(camera) = span.camera() {
            write!(self.to, r#","camera":{camera}"#)?;
        }
        self.to.write_all(b"}}")
    }

    fn arrow(&mut self, placed: &Placed, stop: &Stop) -> io::Result<()> {
        self.separate()?;
        // Of the end: the slice about this instant, not the next one.
        let bind = if stop.mark == 'f' { r#","bp":"e""# } else { "" };
        write!(
            self.to,
            r#"{{"ph":"{}","pid":{},"tid":{},"ts":{},"cat":"field","name":"field","id":{}{bind}}}"#,
            stop.mark,
            placed.pid,
            placed.track(),
            micros(placed.span.start_ns),
            stop.flow
        )
    }

    fn instant(&mut self, pid: u32, at: Nanos, text: &str) -> io::Result<()> {
        // Whole microseconds are precise enough for a death.
        let at = at / 1000;
        self.value(&json!({"ph": "i", "s": "p", "pid": pid, "tid": pid, "ts": at, "name": text}))
    }
}

/// Nanoseconds as µs, to the nanosecond.
fn micros(ns: Nanos) -> String {
    format!("{}.{:03}", ns / 1000, ns % 1000)
}

#[cfg(test)]
mod tests;
