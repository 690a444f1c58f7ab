//! What a replay writes: poses, the blob stream, a report.

use crate::film::claim;
use crate::verify::Verdict;
use anyhow::Context;
use blob_stream::poses_csv::{DisplayClock, PosesCsv};
use diagnosis::{Due, Judged, Tracking, TrackingFigures, Warning, Watch, with_judged};
use outputs::{OutputFile, Outputs};
use protocol::blobs::BlobField;
use protocol::matches::MatchFrame;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use rig::Rig;
use serde::Serialize;
use settings::commands::ReplayArgs;
use std::io::Write;
use std::path::PathBuf;

/// Figures of a replay.
#[derive(Debug, Default, Serialize)]
pub struct Figures {
    /// The recording.
    pub file: String,
    /// Camera-fields that the tracker was given.
    pub camera_fields: u64,
    /// Tracker frames it made of them.
    pub frames: u64,
    /// Steps of the simulation.
    pub steps: u64,
    /// Camera-fields that the tracker refused: twice, out of order, unknown camera.
    pub fields_refused: u64,
    /// Time that passed in the recording, s.
    pub stream_s: f64,
    /// Time that the replay took, s.
    pub wall_s: f64,
    /// Hash of the last step's state.
    pub state_hash: String,
    /// How well bodies were tracked.
    pub tracking: TrackingFigures,
    /// Made at a desk, without cameras: nothing was tracked.
    #[serde(skip)]
    pub desk: bool,
    /// The body that was tracked in the least share of frames, and that share.
    #[serde(skip)]
    pub least_tracked: (&'static str, f64),
    /// What was wrong for longer than a moment, with its likely cause and what helps.
    pub warnings: Vec<Warning>,
    /// The recording does not end well.
    pub damage: Option<String>,
    /// It ends within a record, as after a crash.
    pub cut: bool,
    /// The recorder did not close it in order.
    pub unclosed: bool,
    /// What the recording lacks first, and where.
    pub lost: Option<String>,
    /// The comparison with the recording, with `--verify`.
    pub verify: Option<Verdict>,
}

impl Figures {
    /// Why not everything was verified; empty where it was.
    pub fn reasons(&self) -> Vec<String> {
        let without_frame = self.tracking.frames_due.saturating_sub(self.tracking.frames);
        let lost = self.lost.as_ref().map(|lost| format!("the recording has gaps; the first: {lost}"));
        let blind = self.camera_fields == 0 && !self.desk;
        let poses = self.verify.as_ref().map_or(0, |v| v.poses.recorded);
        let reasons = [
            (blind && poses > 0).then(|| "no camera-fields were recorded".into()),
            lost,
            (without_frame > 0 && !self.desk)
                .then(|| format!("{without_frame} fields have no tracker frame")),
            self.damage.clone().filter(|damage| self.lost.as_ref().is_none_or(|lost| !lost.contains(damage))),
            (self.unclosed && self.damage.is_none()).then(|| "the recording was not closed properly".into()),
        ];
        let left_out = self.verify.as_ref().map(Verdict::left_out).unwrap_or_default();
        left_out.into_iter().chain(reasons.into_iter().flatten()).collect()
    }
}

/// The files being written.
pub struct Products {
    poses: Option<PosesCsv<OutputFile>>,
    display: Option<DisplayClock>,
    blobs: Option<OutputFile>,
    report: Option<PathBuf>,
    outputs: Outputs,
    tracking: Tracking,
    watch: Watch,
    judged: Option<Judged>,
    processing_ns: u64,
    /// From one field of the cameras to the next, ns.
    period_ns: u64,
    /// Figures for the report.
    pub figures: Figures,
    span: Option<[Nanos; 2]>,
}

impl Products {
    /// Begins the files.
    ///
    /// # Errors
    /// Where a file is refused.
    pub fn open(args: &ReplayArgs, rig: &Rig) -> anyhow::Result<Self> {
        let mut outputs = Outputs::new(args.force.force).reading_all(recording::files_of(&args.file));
        for path in [&args.poses, &args.blobs, &args.report].into_iter().flatten() {
            outputs.claim(path)?;
        }
        claim(&args.drawing, args.video.as_deref(), &mut outputs)?;
        let poses = args.poses.as_deref().map(|path| outputs.create(path)).transpose()?;
        let lead_ns = (args.display_lead_ms * 1e6) as u64;
        Ok(Products {
            poses: poses.map(PosesCsv::new).transpose()?,
            display: args.display_hz.map(|hz| DisplayClock::new(hz, lead_ns)),
            blobs: args.blobs.as_deref().map(|path| outputs.create(path)).transpose()?,
            report: args.report.clone(),
            outputs,
            tracking: Tracking::new(rig),
            watch: Watch::default(),
            judged: None,
            processing_ns: args.processing_us * 1000,
            period_ns: rig.field_period_ns(),
            figures: Figures { file: args.file.display().to_string(), ..Figures::default() },
            span: None,
        })
    }

    /// The names of the files, of which the pictures are written elsewhere.
    pub fn outputs(&self) -> Outputs {
        self.outputs.clone()
    }

    /// Takes the count of frames that should have been from who saw all fields, also those that went into
    /// no frame.
    pub fn count_by(&mut self, due: Due) {
        self.tracking.count_by(due);
    }

    /// A camera-field goes to the tracker.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn field(&mut self, field: &BlobField, shown: bool) -> anyhow::Result<()> {
        self.figures.camera_fields += 1;
        self.tracking.note_field(field);
        if let (Some(blobs), true) = (&mut self.blobs, shown) {
            writeln!(blobs, "{}", blob_stream::write_line(field)).context("blob stream")?;
        }
        Ok(())
    }

    /// The tracker made a frame, and matched blobs in it.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn frame(
        &mut self,
        frame: &TrackerFrame,
        matches: Option<&MatchFrame>,
        shown: bool,
    ) -> anyhow::Result<()> {
        self.figures.frames += 1;
        self.figures.fields_refused = u64::from(frame.fields_refused);
        let exposed = frame.instants.exposed;
        let [start, end] = self.span.unwrap_or([exposed; 2]);
        self.span = Some([start.min(exposed), end.max(exposed)]);
        let tracked = !self.figures.desk && {
            matches.into_iter().for_each(|m| self.tracking.note_matches(m));
            self.tracking.note_frame(frame)
        };
        if tracked {
            let at_s = exposed.saturating_sub(start.min(exposed)) as f64 * 1e-9;
            self.watch.note(at_s, self.tracking.findings());
        }
        let out_ns = frame.instants.blobs_out.max(exposed) + self.processing_ns;
        let Some(csv) = &mut self.poses else { return Ok(()) };
        if let Some(display) = &mut self.display {
            let show =
                |f: &TrackerFrame, latched, at| if shown { csv.predicted(f, latched, at) } else { Ok(()) };
            display.advance(frame, out_ns, show).context("poses")?;
        }
        if shown {
            csv.measured(frame, out_ns).context("poses")?;
        }
        Ok(())
    }

    /// What the judgement of the rig says.
    pub fn judged(&mut self, judged: Option<Judged>) {
        self.judged = judged;
    }

    /// The simulation made a step.
    pub fn step(&mut self, state_hash: u64) {
        self.figures.steps += 1;
        self.figures.state_hash = format!("{state_hash:016x}");
    }

    /// Writes what is left and closes the files.
    ///
    /// # Errors
    /// Where a file cannot be written.
    pub fn finish(mut self) -> anyhow::Result<Figures> {
        if let Some(mut csv) = self.poses.take() {
            if let Some(display) = &mut self.display {
                // A display goes on showing the last frame until the next one would be due.
                let until = display.newest_out_ns().map_or(0, |out| out + self.period_ns);
                display.show_until(until, |f, latched, at| csv.predicted(f, latched, at)).context("poses")?;
            }
            csv.into_inner().finish()?;
        }
        if let Some(blobs) = self.blobs.take() {
            blobs.finish()?;
        }
        let [start, end] = self.span.unwrap_or([0; 2]);
        self.figures.stream_s = (end - start) as f64 * 1e-9;
        self.figures.tracking = self.tracking.figures();
        self.figures.least_tracked = self.tracking.least_share();
        self.figures.warnings = with_judged(self.watch.warnings().to_vec(), self.judged.take());
        let reasons = self.figures.reasons();
        if let Some(verdict) = &mut self.figures.verify {
            verdict.reasons = reasons;
        }
        if let Some(path) = &self.report {
            let text = serde_json::to_string_pretty(&self.figures)?;
            self.outputs.write(path, text + "\n")?;
        }
        Ok(self.figures)
    }
}
