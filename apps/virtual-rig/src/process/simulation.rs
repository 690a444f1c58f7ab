//! Simulation of the cameras: exposure of fields, and their output with the controls.
//!
//! Field `k` is exposed at `t0 + k·period` (or by its camera's own clock). Its pixels are
//! synthesised and published ahead, with the instants at which a real camera would send them; the
//! camera hardware keeps to those. Blobs that are made without pixels are held back here. A machine
//! that falls behind by a field leaves fields out and counts them; nothing queues up.

use super::controls::ControlSample;
use super::output::{FieldTiming, Output};
use super::surgeon::ScriptedSurgeon;
use super::{Source, VirtualRigShell};
use crate::cameras::{Cameras, Path};
use crate::config::{Config, LateCamera};
use crate::faults::FaultInjector;
use crate::faults::spec::FaultSpec;
use crate::faults::tally::FaultLog;
use crate::schedule::{Action, Schedule};
use anyhow::{Context, Result};
use ipc::clock::now;
use ipc::logging::message;
use ipc::trace::About;
use outputs::OutputError;
use protocol::health::{STATE_DEGRADED, STATE_RUNNING};
use protocol::phases::Phase;
use rig::Rig;

/// Consecutive fields in time after which the machine counts as fast enough again.
const RECOVERED_AFTER: u64 = 50;
/// Time that the camera hardware has after the last field is due before the end is reported, ns.
const DRAIN_NS: u64 = 5_000_000;

/// Simulates the cameras until the process is stopped.
pub(super) fn run(config: &Config, rig: &Rig, surgeon: ScriptedSurgeon) -> Result<()> {
    let path = if config.cameras.direct { Path::Direct } else { Path::Pixels };
    let faults = match &config.cameras.faults {
        Some(text) => FaultInjector::new(FaultSpec::load(text)?, rig, config.cameras.seed)?,
        None => FaultInjector::none(rig),
    };
    let log = config.cameras.fault_log.as_deref();
    let fault_log = log.map(|path| FaultLog::create(path, config.force.force)).transpose()?;
    let cameras = Cameras::with_faults(rig, path, config.cameras.seed, faults)?;
    let shell = VirtualRigShell::open(config, rig, surgeon)?;
    let mut simulation = Simulation {
        output: Output::open(&shell.instance, path, cameras.payload_bytes())?,
        schedule: Schedule::of(&cameras),
        cameras,
        controls: None,
        last_due_ns: 0,
        late: config.late_camera,
        fault_log,
        unlogged: None,
        in_time: 0,
    };
    if let Some(time_ns) = shell.resumed_at {
        simulation.schedule.go_on_after(time_ns);
    }
    let simulation = shell.run(simulation)?;
    let mut summary = String::new();
    simulation.cameras.tally.summary(&mut summary);
    if !summary.is_empty() {
        message(tracing::Level::INFO, &summary);
    }
    simulation.unlogged.map_or(Ok(()), |problem| Err(problem).context("the fault log is not complete"))
}

/// The cameras, their schedule and output.
struct Simulation {
    cameras: Cameras,
    schedule: Schedule,
    output: Output,
    /// Controls of the newest exposure, until they are sent.
    controls: Option<ControlSample>,
    /// When the last exposed field is due, ns after the start.
    last_due_ns: u64,
    /// Camera with an additional delay.
    late: Option<LateCamera>,
    fault_log: Option<FaultLog>,
    /// Why no more faults are logged.
    unlogged: Option<OutputError>,
    /// Consecutive fields exposed in time.
    in_time: u64,
}

impl Simulation {
    /// The next action `elapsed_ns` after the start, with no exposure from `end_ns` on.
    fn next_action(&self, elapsed_ns: u64, end_ns: u64) -> Action {
        let send = self.output.blobs.due_ns().into_iter().chain(self.controls.map(|c| c.due_ns)).min();
        self.schedule.next(elapsed_ns, send, end_ns)
    }
}

impl Source for Simulation {
    /// Sends what is due, then exposes fields until something has to be waited for.
    fn advance(&mut self, rig: &mut VirtualRigShell) -> Result<u64> {
        rig.send_due(self)?;
        loop {
            let elapsed_ns = rig.timeline.elapsed(now());
            match self.next_action(elapsed_ns, rig.end_ns()) {
                // A published field has its instants: none is exposed during a pause.
                Action::Expose(_) if rig.timeline.is_paused() => return Ok(0),
                Action::Expose(group) => rig.expose_group(self, group, elapsed_ns)?,
                Action::Wait(until_ns) => return Ok(until_ns),
                Action::Over => return rig.finish(self.last_due_ns + DRAIN_NS),
            }
        }
    }

    fn restart(&mut self) {
        self.output.blobs.clear();
        self.schedule.reset();
        (self.controls, self.last_due_ns) = (None, 0);
    }
}

impl VirtualRigShell {
    /// End of the exposures, ns after the start.
    fn end_ns(&self) -> u64 {
        let after = |s: f64| ((self.surgeon.motion.period_s() + s) * 1e9) as u64;
        self.config.after_round.map_or(u64::MAX, after).min(self.duration_ns)
    }

    /// Exposes the next field of every camera of a group. The leading group's field also samples the
    /// controls and feeds back perception.
    fn expose_group(&mut self, simulation: &mut Simulation, group: usize, elapsed_ns: u64) -> Result<()> {
        let missed = simulation.schedule.leave_out_missed(group, elapsed_ns);
        self.count_missed(simulation, missed, group)?;
        let number = simulation.schedule.exposed(group);
        for k in 0..simulation.schedule.0[group].cameras.len() {
            let camera = simulation.schedule.0[group].cameras[k];
            simulation.last_due_ns = self.expose(simulation, camera, number)?.max(simulation.last_due_ns);
        }
        if group == simulation.schedule.leading() {
            let exposed_ns = simulation.schedule.0[group].clock.exposed_ns(number);
            let due_ns = exposed_ns + simulation.schedule.0[group].out_after_ns + self.shell.delay_ns();
            let controls = ControlSample::at(&mut self.surgeon.motion, exposed_ns, number, due_ns);
            simulation.controls = Some(controls);
            self.keeper.keep_time(exposed_ns);
            if let Some(perception) = &mut self.perception
                && perception.show(&mut self.surgeon.motion, exposed_ns)?
            {
                self.keep();
            }
        }
        self.report_faults(simulation)
    }

    /// Exposes field `number` of camera `i` and puts it out. Returns when it is due at the
    /// earliest, ns after the start.
    fn expose(&mut self, simulation: &mut Simulation, i: usize, number: u64) -> Result<u64> {
        let Simulation { cameras, output, late, .. } = simulation;
        let id = cameras.id(i);
        let delivery = cameras.delivery(i, number);
        let late_ns = late.filter(|l| l.camera == id).map_or(0, |l| l.delay_ns) + delivery.delay_ns;
        let due_ns =
            cameras.clock(i).exposed_ns(number) + cameras.out_after_ns(i) + late_ns + self.shell.delay_ns();
        let (about, begun) = (About::camera(number, id), self.shell.trace.begin());
        let mut exposure = cameras.expose(i, &mut self.surgeon.motion, number);
        let exposed = self.shell.trace.end(Phase::Expose, about, begun);
        if delivery.dropped {
            return Ok(due_ns);
        }
        let timing = FieldTiming { start_ns: self.timeline.start(), late_ns, due_ns };
        if !output.put(&mut exposure, &timing, &mut self.blobs)? {
            tracing::debug!(field = number, camera = id, "no room for the blobs of a field");
            self.shell.report.lost += 1;
        }
        self.shell.trace.end(output.phase(), about, exposed);
        self.shell.report.sent = self.blobs.sent() + self.controls.sent() + output.sent();
        Ok(due_ns)
    }

    /// Sends the controls and blobs that are due. The blobs' instants count from the start until
    /// here, because a pause may move it.
    fn send_due(&mut self, simulation: &mut Simulation) -> Result<()> {
        let elapsed_ns = self.timeline.elapsed(now());
        if let Some(controls) = simulation.controls.take_if(|c| c.due_ns <= elapsed_ns) {
            self.send_controls(&controls)?;
        }
        while let Some(mut lease) = simulation.output.blobs.take(elapsed_ns) {
            let field = lease.block();
            field.exposed_ns += self.timeline.start();
            field.read_out_ns += self.timeline.start();
            self.send_lease(lease)?;
        }
        Ok(())
    }

    /// Counts the `missed` fields of each camera of a group, and reports a machine that is too
    /// slow.
    fn count_missed(&mut self, simulation: &mut Simulation, missed: u64, group: usize) -> Result<()> {
        let state = self.shell.report.state;
        if missed > 0 {
            // The first of them.
            let field = simulation.schedule.0[group].next - missed;
            tracing::debug!(field, fields = missed, "the machine is too slow: fields are skipped");
            self.shell.report.lost += missed * simulation.schedule.0[group].cameras.len() as u64;
            simulation.in_time = 0;
            if state == STATE_RUNNING {
                self.enter(STATE_DEGRADED, "machine too slow: fields are skipped")?;
            }
        } else {
            simulation.in_time += 1;
            if simulation.in_time == RECOVERED_AFTER && state == STATE_DEGRADED {
                self.enter(STATE_RUNNING, self.surgeon.note)?;
            }
        }
        Ok(())
    }

    /// Logs the new fault events and puts the counts into the next heartbeat.
    fn report_faults(&mut self, simulation: &mut Simulation) -> Result<()> {
        let tally = &mut simulation.cameras.tally;
        if tally.waiting().is_empty() {
            return Ok(());
        }
        if let Some(Err(problem)) = simulation.fault_log.as_mut().map(|log| log.write(tally.waiting())) {
            tracing::warn!("{problem}; no more faults are logged");
            (simulation.fault_log, simulation.unlogged) = (None, Some(problem));
        }
        tally.clear_waiting();
        self.text.clear();
        tally.summary(&mut self.text);
        self.report_text();
        Ok(())
    }
}
