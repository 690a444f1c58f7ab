//! The end of a run: ends the processes and the recording, and computes the report.

use super::{Attempt, Session};
use crate::children::realtime_allowed;
use crate::machine::Machine;
use crate::run::controls;
use crate::run::monitor::CHANNELS;
use crate::run::options::{RunArgs, View};
use crate::run::report::{
    FORMAT, Incident, ProcessFigures, Report, Setup, Versions, paper_table_4, step_profile,
};
use crate::run::supervisor::Slot;
use blob_stream::live::LiveFigures;
use bytemuck::Zeroable;
use diagnosis::Warning;
use ipc::clock::now;
use ipc::trace::json::FieldTrace;
use protocol::blobs::BlobField;
use protocol::deliveries::{DELIVERIES_FILE, Deliveries, Delivery};
use protocol::file::{MAX_SETTINGS_BYTES, read_text};
use protocol::health::{Health, Process};
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use recording::Provenance;
use settings::commands::processes::AUTO;
use std::collections::BTreeMap;

/// Results of a run.
pub struct Closed {
    /// Report with all figures.
    pub report: Report,
    /// All attempts.
    pub attempts: Vec<Attempt>,
    /// Trace of the fields, if requested.
    pub trace: Option<FieldTrace>,
}

impl Session<'_> {
    /// Ends the processes and the recording, and computes the report.
    pub async fn close(mut self, ended_by: String) -> Closed {
        let at = now();
        self.note_own_cpu(at);
        let load = self.load.load(self.own_cores());
        let ends = self.supervisor.end().await;
        for what in ends.killed.into_iter().chain(ends.failed.iter().cloned()) {
            self.incidents.push(Incident { at_s: self.elapsed_s(at), what });
        }
        // Receives the messages that were sent during the shutdown. A channel that fails now has none left.
        let _ = self.receive();
        let recording = self.end_attempt().await;
        let slots = &self.supervisor.slots;
        let renderer = slots.iter().find(|s| s.process == Process::Renderer);
        let words = renderer.and_then(|s| s.health).map(|h| h.text()).unwrap_or_default();
        let mut processes: Vec<ProcessFigures> = slots.iter().map(process_figures).collect();
        processes.sort_by_key(|p| Process::ALL.iter().position(|q| q.name() == p.process));
        processes.push(self.own_figures());
        let stages = self.consumers.latencies.judge(self.budgets);
        let report = Report {
            format: FORMAT,
            budgets_kept: stages.iter().all(|s| !s.broken),
            ended_by,
            duration_s: self.elapsed_s(at),
            setup: setup(&self.args, self.view, &self.provenance),
            machine: Machine::detect(),
            versions: Versions::of_this_build(),
            stages,
            load,
            warm_up_left_out: self.consumers.latencies.warm_up,
            paper_table_4: paper_table_4(&self.consumers.latencies),
            step_profile: step_profile(&self.consumers.latencies),
            picture: self.consumers.monitor.picture(words),
            tracking: self.consumers.tracking.figures(),
            least_tracked: self.consumers.tracking.least_share(),
            warnings: self.warnings(),
            silences: self.consumers.silence.of_processes(),
            blob_stream: LiveFigures::left_in(self.instance.directory()),
            processes,
            restarts: slots.iter().map(|s| (s.process.name(), s.restarts)).collect(),
            incidents: std::mem::take(&mut self.incidents),
            unfinished: ends.failed,
            lost: self.lost(),
            overwritten: self.consumers.lost_before,
            frames_withheld: self.consumers.tracking.due().frames_withheld(),
            states_lost: self.states_lost,
            received: CHANNELS.into_iter().zip(self.consumers.monitor.traffic.map(|t| t.count)).collect(),
            events: self.consumers.monitor.events.clone(),
            removed: self.consumers.monitor.removed,
            recording,
            cameras: self.deliveries(),
            controls: controls::figures(&self.args, self.instance.directory()),
        };
        let foreign_rig = self.args.real.given().is_some() || self.args.real.driver().is_some();
        let (options, directory) = (&self.args.outputs.trace, self.instance.directory());
        let trace = self.traced.collect(options, directory, self.started_ns, foreign_rig);
        Closed { report, attempts: self.attempts, trace }
    }

    /// Persistent problems, including silences of a live stream.
    fn warnings(&self) -> Vec<Warning> {
        [self.consumers.watch.warnings(), &self.consumers.silence.of_stream()].concat()
    }

    /// Average number of processors that all processes of the run used together.
    fn own_cores(&self) -> f64 {
        self.own_cpu.share() + self.supervisor.slots.iter().map(|s| s.cpu.share()).sum::<f64>()
    }

    /// Number of missing blocks by channel.
    fn lost(&self) -> BTreeMap<&'static str, u64> {
        let (mut lost, due) = (self.tap.lost(), self.consumers.tracking.due());
        let unpublished =
            [(BlobField::CHANNEL, due.fields_skipped()), (TrackerFrame::CHANNEL, due.frames_missing())];
        // Overwritten messages are missing in the count of received messages as well.
        for (channel, count) in unpublished.into_iter().filter(|(_, count)| *count > 0) {
            let known = lost.entry(channel).or_default();
            *known = count.max(*known);
        }
        lost
    }

    /// Delivery of the pictures of live streams; empty if there are none.
    fn deliveries(&self) -> Vec<Delivery> {
        let file = self.instance.directory().join(DELIVERIES_FILE);
        let left = self.args.real.streams().and_then(|_| read_text(&file, MAX_SETTINGS_BYTES).ok());
        let left = left.and_then(|text| serde_json::from_str::<Deliveries>(&text).ok());
        left.unwrap_or_default().cameras
    }

    fn own_figures(&self) -> ProcessFigures {
        let received = self.consumers.monitor.traffic.iter().map(|t| t.count).sum();
        ProcessFigures {
            process: "launcher",
            restarts: 0,
            cpu_percent: self.own_cpu.share() * 100.0,
            received,
            sent: 0,
            lost: self.consumers.lost_before,
            refused: 0,
            text: String::new(),
        }
    }
}

fn process_figures(slot: &Slot) -> ProcessFigures {
    let health = slot.health.unwrap_or_else(Health::zeroed);
    ProcessFigures {
        process: slot.process.name(),
        restarts: slot.restarts,
        cpu_percent: slot.cpu.share() * 100.0,
        received: health.received,
        sent: health.sent,
        lost: health.lost,
        refused: health.refused,
        text: health.text(),
    }
}

fn setup(args: &RunArgs, view: View, provenance: &Provenance) -> Setup {
    let path = |p: &std::path::Path| p.display().to_string();
    let source = match (&args.desk, &args.virtual_rig.blobs, &args.virtual_rig.motion) {
        (Some(desk), ..) => match &desk.inputs {
            Some(file) => format!("inputs of {}", path(file)),
            None => format!("desk, {}", desk.input.as_deref().unwrap_or(AUTO)),
        },
        (_, Some(blobs), _) => format!("blob stream {}", path(blobs)),
        _ if args.real.driver().is_some() => {
            format!("drivers: {}", args.real.external.as_ref().map_or_else(String::new, ToString::to_string))
        }
        (_, _, Some(motion)) => format!("script with the hand of {}", path(motion)),
        _ => args.real.given().map_or_else(|| "script".into(), |cameras| format!("cameras {cameras}")),
    };
    let delays = args.trial.inject_delay.iter().map(|(stage, ms)| (stage.name(), *ms));
    Setup {
        instance: args.instance.clone(),
        scene: provenance.scene_name.clone(),
        rig: match &args.rig_of {
            Some(recording) => format!("of {}", path(recording)),
            None => args.rig.rig.as_deref().map_or("shipped".into(), path),
        },
        seed: args.virtual_rig.seed,
        source,
        colours: args.extraction.colours.as_deref().map_or("shipped".into(), path),
        view: match view {
            View::Window => "window",
            View::Headless => "headless",
            View::None => "none",
        },
        realtime: realtime_allowed(),
        injected_delays_ms: delays.collect::<BTreeMap<_, _>>(),
    }
}
