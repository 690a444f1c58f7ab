//! `vitreo residuals`: how far blobs lie from the fitted markers, by camera and marker.

mod chart;

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

/// How much of a recording is judged for causes, ns: more needs memory, and shows no more.
const CAUSES_NS: u64 = 60_000_000_000;

/// What is printed as JSON.
#[derive(Serialize)]
struct Figures<'a> {
    file: String,
    /// True where the matches were recorded; else this tracker found them in the recorded blobs.
    recorded: bool,
    frames: u64,
    residuals: &'a [ResidualRow],
    causes: Option<&'a Judgement>,
    damage: Option<String>,
}

impl Figures<'_> {
    /// For people.
    fn print(&self) {
        let how = if self.recorded { "as recorded" } else { "as this tracker finds them in the blobs" };
        let frames = self.frames;
        println!(
            "{frames} tracker frames, {how}; px of the frame, NIS above 5.99 is 5 % where predictions hold"
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
    let causes = args.causes.then(|| causes(&recording, &rig));
    let figures = Figures {
        file: args.file.display().to_string(),
        recorded: outcome.recorded,
        frames,
        residuals: &rows,
        causes: causes.as_ref(),
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

/// Judges the first minute of a recording's blobs.
fn causes(recording: &Recording, rig: &Rig) -> Judgement {
    let mut fields: Vec<BlobField> = Vec::new();
    for item in recording.items_of(&[BlobField::CHANNEL]).flatten() {
        let Item::Blobs(field) = item.1 else { continue };
        let begin = fields.first().map_or(field.exposed_ns, |f| f.exposed_ns);
        if field.exposed_ns.saturating_sub(begin) > CAUSES_NS {
            break;
        }
        fields.push(*field);
    }
    let bar = files_bar(0, "causes");
    let judgement = judge(rig, &fields, |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    judgement
}

/// The rig of a recording with cameras.
///
/// # Errors
/// Where it cannot work, or the recording was made at a desk.
pub fn rig_of(recording: &Recording) -> anyhow::Result<Rig> {
    let provenance = recording.provenance();
    if provenance.config.contains_key(recording::DESK) {
        bail!("made at a desk, without cameras: nothing was tracked");
    }
    let rig = Rig::parse(&provenance.rig_json, "of the recording")?;
    tracker::rig_check::check(&rig).context("the recording's rig cannot work")?;
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
