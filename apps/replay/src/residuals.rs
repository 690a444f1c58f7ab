//! `vitreo residuals`: how far blobs lie from the fitted markers, by camera and marker.

mod chart;

use crate::likely_cause::{self, OfLast};
use crate::matched;
use anyhow::{Context, bail};
use calibration::causes::{Judgement, judge};
use diagnosis::{ResidualRow, ResidualTable};
use ipc::logging::{inform, warn};
use outputs::exit::LOSS;
use outputs::progress::files_bar;
use outputs::{Outputs, println};
use plots::{Format, bytes};
use protocol::blobs::BlobField;
use protocol::message::Message;
use recording::{Item, Recording};
use rig::Rig;
use serde::Serialize;
use settings::commands::ResidualsArgs;
use std::ops::ControlFlow;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// How much of a recording is judged for causes, ns: more needs memory, and shows no more.
const CAUSES_NS: u64 = 60_000_000_000;
/// Longest time that a search is given, s: more is no bound, and no clock counts so far.
const LONGEST_S: f64 = 1e6;

/// What is printed as JSON.
#[derive(Serialize)]
struct Figures<'a> {
    file: String,
    /// True where the matches were recorded; else this tracker found them in the recorded blobs.
    recorded: bool,
    frames: u64,
    residuals: &'a [ResidualRow],
    causes: Option<&'a Judgement>,
    /// What the end of a run says of them; none where nothing is to be said.
    likely_cause: Option<String>,
    damage: Option<String>,
}

impl Figures<'_> {
    /// For people.
    fn print(&self) {
        let how = if self.recorded { "as recorded" } else { "tracked again from the recorded blobs" };
        let frames = self.frames;
        println!(
            "{frames} tracker frames, {how}; px of the frame; with exact predictions, 5 % of NIS exceed 5.99"
        );
        lines(self.residuals).iter().for_each(|line| println!("{line}"));
        self.causes.iter().for_each(|judgement| println!("{}", judgement.text()));
    }
}

/// Runs it.
///
/// # Errors
/// Where the recording cannot be read or holds no residuals, or the picture cannot be written.
pub fn run(args: &ResidualsArgs) -> anyhow::Result<ExitCode> {
    let recording = Recording::open(&args.file)?;
    let rig = rig_of(&recording)?;
    if let Some(last_s) = args.last {
        return of_last(args, &recording, &rig, last_s);
    }
    let mut outputs = Outputs::new(args.force.force).reading_all(recording::files_of(&args.file));
    let format = args.plot.as_deref().map(Format::of).transpose()?;
    args.plot.iter().try_for_each(|plot| outputs.claim(plot))?;
    let (mut table, mut grid, mut frames) = (ResidualTable::default(), chart::Grid::new(&rig), 0);
    let outcome = matched::run(&recording, &rig, "residuals", |found| {
        frames += 1;
        table.note(found.matches);
        grid.note(found.matches);
        Ok(ControlFlow::Continue(()))
    })?;
    let rows = table.rows();
    // Where nothing is tracked, the causes may still say why.
    if rows.is_empty() && !args.causes {
        bail!("{}: no blob of {frames} tracker frames measured a pose", args.file.display());
    }
    let causes = args.causes.then(|| causes(&recording, &rig, args.within));
    let figures = Figures {
        file: args.file.display().to_string(),
        recorded: outcome.recorded,
        frames,
        residuals: &rows,
        causes: causes.as_ref(),
        likely_cause: causes.as_ref().and_then(|judgement| judgement.paragraph(0.0)),
        damage: outcome.damage.as_ref().map(ToString::to_string),
    };
    if args.json {
        println!("{}", serde_json::to_string_pretty(&figures)?);
    } else {
        figures.print();
    }
    if let (Some(plot), Some(format)) = (&args.plot, format) {
        outputs.write(plot, bytes(&chart::Chart::new(&rig, &rows, &grid), format)?)?;
        inform(&format!("{}: residuals of {} cameras", plot.display(), rig.cameras.len()));
    }
    let Some(damage) = outcome.damage else { return Ok(ExitCode::SUCCESS) };
    warn(&damage.to_string());
    Ok(ExitCode::from(LOSS))
}

/// The causes of the last seconds alone.
fn of_last(args: &ResidualsArgs, recording: &Recording, rig: &Rig, last_s: f64) -> anyhow::Result<ExitCode> {
    let found = shown(args.within, |go_on| likely_cause::of_last(recording, rig, last_s, go_on))?;
    let OfLast { judgement, starts_s } = &found;
    if args.json {
        let judged = found.judged();
        let figures = serde_json::json!({
            "file": args.file.display().to_string(),
            "starts_s": starts_s,
            "causes": judgement,
            "likely_cause": found.paragraph(),
            "warning": judged.as_ref().map(|judged| &judged.warning),
            "too_little": judgement.shortage(),
            "cameras": judged.as_ref().map(|judged| &judged.cameras),
        });
        println!("{}", serde_json::to_string_pretty(&figures)?);
    } else {
        println!("of the blobs from {starts_s:.1} s on: {}", judgement.text());
    }
    Ok(ExitCode::SUCCESS)
}

/// Judges the first minute of a recording's blobs.
fn causes(recording: &Recording, rig: &Rig, within_s: Option<f64>) -> Judgement {
    let mut fields: Vec<BlobField> = Vec::new();
    for item in recording.items_of(&[BlobField::CHANNEL]).flatten() {
        let Item::Blobs(field) = item.1 else { continue };
        let begin = fields.first().map_or(field.exposed_ns, |f| f.exposed_ns);
        if field.exposed_ns.saturating_sub(begin) > CAUSES_NS {
            break;
        }
        fields.push(*field);
    }
    shown(within_s, |go_on| judge(rig, &fields, go_on))
}

/// A search for causes, with a bar that shows how far it is, and within its time.
fn shown<T>(within_s: Option<f64>, search: impl FnOnce(&(dyn Fn(usize, usize) -> bool + Sync)) -> T) -> T {
    let until = within_s.map(|s| Instant::now() + Duration::from_secs_f64(s.min(LONGEST_S)));
    let bar = files_bar(0, "causes");
    let found = search(&|done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
        until.is_none_or(|until| Instant::now() < until)
    });
    bar.finish_and_clear();
    found
}

/// The rig of a recording with cameras.
///
/// # Errors
/// If the rig is not usable, or the recording was made at a desk.
pub fn rig_of(recording: &Recording) -> anyhow::Result<Rig> {
    let provenance = recording.provenance();
    if provenance.config.contains_key(recording::DESK) {
        bail!("a desk recording without cameras: nothing was tracked");
    }
    let rig = Rig::parse(&provenance.rig_json, "of the recording")?;
    tracker::rig_check::check(&rig).context("the recording's rig is not usable")?;
    Ok(rig)
}

/// The table for people.
fn lines(rows: &[ResidualRow]) -> Vec<String> {
    let mut out = vec![format!(
        "{:<6} {:<6} {:>6} {:>8} {:>8} {:>8} {:>8} {:>8} {:>8} {:>10}",
        "camera", "body", "marker", "n", "mean x", "mean y", "RMS x", "RMS y", "largest", "NIS > 5.99"
    )];
    for r in rows {
        out.push(format!(
            "{:<6} {:<6} {:>6} {:>8} {:>+8.3} {:>+8.3} {:>8.3} {:>8.3} {:>8.2} {:>8.1} %",
            r.camera,
            r.body,
            r.marker,
            r.count,
            r.mean_px[0],
            r.mean_px[1],
            r.rms_px[0],
            r.rms_px[1],
            r.largest_px,
            100.0 * r.nis_above_share
        ));
    }
    out
}
