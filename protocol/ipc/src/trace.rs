//! The trace of a run: what each process did with which field, from when to when.
//!
//! A process that traces keeps its newest spans in a ring in its own memory, which is made when it starts
//! ([`ring`]): in the loop nothing is allocated, locked or formatted, and nothing waits for a reader. Where
//! no trace is wanted no clock is read either. When the process ends in order it writes the ring into the
//! instance's private directory ([`part`]), the launcher puts the parts together ([`json`]), and the
//! directory goes with the run: nothing is left over, however it ends.

pub mod json;
pub mod part;
mod ring;

use crate::clock::now;
use bytemuck::{Pod, Zeroable};
use part::{TracePart, part_file};
use protocol::health::Process;
use protocol::phases::{Phase, PhaseClock, Phases};
use protocol::time::Nanos;
use ring::Ring;
use rustix::process::{Pid, getppid};
use std::path::{Path, PathBuf};

/// Spans of a second for which there is room: the simulation, which has the most, has 5,400 (five for each of
/// its thousand substeps).
pub const SPANS_PER_SECOND: u32 = 8192;
/// Longest trace, s: 118 MB in each process.
pub const MAX_SECONDS: u32 = 600;
/// The camera of a span that is of no single one.
const NO_CAMERA: u16 = u16::MAX;

/// The option by which the launcher has a process trace.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub struct TraceArgs {
    /// Keep so many spans for the launcher's trace.
    #[arg(long, value_name = "SPANS", hide = true, value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_SECONDS * SPANS_PER_SECOND)))]
    pub trace_spans: Option<u32>,
}

/// What a process did from one instant to another.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct Span {
    /// When it began, ns.
    pub start_ns: Nanos,
    /// Number of the field.
    pub field: u64,
    /// How long it took, ns; at most 4.29 s.
    pub duration_ns: u32,
    /// [`Phase`].
    phase: u16,
    /// Id of the camera, or [`NO_CAMERA`].
    camera: u16,
}

impl Span {
    /// Its phase; `None` of a span of another version.
    pub fn phase(&self) -> Option<Phase> {
        Phase::from_wire(self.phase)
    }

    /// The camera whose field it is, if it is of one.
    pub fn camera(&self) -> Option<u16> {
        (self.camera != NO_CAMERA).then_some(self.camera)
    }

    /// When it ended, ns.
    pub fn end_ns(&self) -> Nanos {
        self.start_ns.saturating_add(self.duration_ns.into())
    }
}

/// Whose field a span is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct About {
    field: u64,
    camera: u16,
}

impl About {
    /// A field of all cameras together.
    pub fn field(field: u64) -> Self {
        About { field, camera: NO_CAMERA }
    }

    /// A field of one camera.
    pub fn camera(field: u64, camera: u32) -> Self {
        About { field, camera: camera.try_into().unwrap_or(NO_CAMERA) }
    }
}

/// The spans of this process, if it traces.
#[derive(Debug)]
pub struct Trace {
    on: Option<Box<Tracer>>,
}

/// What a process that traces keeps.
#[derive(Debug)]
struct Tracer {
    ring: Ring,
    process: Process,
    /// Where its part goes.
    file: PathBuf,
    /// The launcher, which reads it there; `None` once it has ended.
    launcher: Option<Pid>,
}

impl Trace {
    /// Makes the ring, if one is wanted; `directory` is where it is left in the end.
    pub fn start(process: Process, args: TraceArgs, directory: &Path) -> Self {
        let on = args.trace_spans.map(|spans| {
            let file = part_file(directory, process, std::process::id());
            Box::new(Tracer { ring: Ring::new(spans as usize), process, file, launcher: getppid() })
        });
        Trace { on }
    }

    /// The beginning of a span: the present instant, or 0 where nothing is traced.
    #[inline]
    pub fn begin(&self) -> Nanos {
        if self.on.is_some() { now() } else { 0 }
    }

    /// Notes a span from `begun` until now, where the next one may begin; returns that instant, or 0 where
    /// nothing is traced.
    #[inline]
    pub fn end(&mut self, phase: Phase, about: About, begun: Nanos) -> Nanos {
        let Some(on) = &mut self.on else { return 0 };
        let at = now();
        on.ring.push(span(phase, about, [begun, at]));
        at
    }

    /// Notes a span between two instants that were taken anyway.
    #[inline]
    pub fn note(&mut self, phase: Phase, about: About, from_to: [Nanos; 2]) {
        if let Some(on) = &mut self.on {
            on.ring.push(span(phase, about, from_to));
        }
    }

    /// Notes the phases of a computation, which begins now; `None` where nothing is traced.
    #[inline]
    pub fn laps(&mut self, about: About) -> Option<Laps<'_>> {
        let on = self.on.as_mut()?;
        Some(Laps { ring: &mut on.ring, about, lap_ns: now() })
    }

    /// Leaves the spans to the launcher. If the launcher has ended, no process would remove them.
    pub(crate) fn leave(&mut self) {
        let Some(on) = self.on.take() else { return };
        if on.launcher != getppid() {
            return;
        }
        if let Err(problem) = part::write(&on.file, on.process, &on.ring) {
            tracing::warn!("the spans of this process are missing in the trace: {problem}");
        }
    }

    /// What is kept, for a process that writes its trace itself; `None` where nothing is traced.
    pub fn part(&self) -> Option<TracePart> {
        let on = self.on.as_ref()?;
        Some(TracePart::of(on.process, std::process::id(), &on.ring))
    }
}

#[inline]
fn span(phase: Phase, About { field, camera }: About, [from, to]: [Nanos; 2]) -> Span {
    let duration_ns = u32::try_from(to.saturating_sub(from)).unwrap_or(u32::MAX);
    Span { start_ns: from, field, duration_ns, phase: phase as u16, camera }
}

/// Notes phases that follow each other without a gap, by one reading of the clock each.
#[derive(Debug)]
pub struct Laps<'a> {
    ring: &'a mut Ring,
    about: About,
    /// When the last one ended.
    lap_ns: Nanos,
}

impl Phases for Laps<'_> {
    #[inline]
    fn ended(&mut self, phase: Phase) {
        let at = now();
        self.ring.push(span(phase, self.about, [self.lap_ns, at]));
        self.lap_ns = at;
    }
}

impl PhaseClock for Laps<'_> {
    #[inline]
    fn read(&mut self) -> Nanos {
        now()
    }

    #[inline]
    fn lap(&mut self, phase: Phase, from_to: [Nanos; 2]) {
        self.ring.push(span(phase, self.about, from_to));
    }
}

#[cfg(test)]
mod tests;
