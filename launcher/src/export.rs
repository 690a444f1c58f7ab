//! `vitreo export`: the contents of a recording as CSV, JSON lines or the rig file, as recorded.

use crate::poses_csv::PosesCsv;
use crate::progress::bytes_bar;
use anyhow::{Context, bail};
use blob_stream::write_line;
use ipc::logging::message;
use protocol::time::Nanos;
use recording::{Item, Recording};
use std::fs::File;
use std::io::{BufWriter, ErrorKind, Write, stdout};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use tracing::Level;

/// Arguments of `vitreo export`.
#[derive(Debug, clap::Args)]
pub struct ExportArgs {
    /// The recording.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    #[command(flatten)]
    what: What,
    /// Where `--csv` goes; standard output if not given.
    #[arg(short, long, value_name = "OUT.csv", requires = "csv")]
    pub output: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
#[group(required = true, multiple = true)]
struct What {
    /// Write the recorded poses.
    #[arg(long, value_name = "OUT.csv")]
    poses: Option<PathBuf>,
    /// Write the blob stream.
    #[arg(long, value_name = "OUT.jsonl")]
    blobs: Option<PathBuf>,
    /// Write the rig file.
    #[arg(long, value_name = "RIG.json")]
    rig: Option<PathBuf>,
    /// Write a topic as a table: handles, pedal, steps, events, frames, notes, checkpoints, pictures.
    #[arg(long, value_name = "TOPIC", value_parser = TABLES)]
    csv: Option<String>,
}

const TABLES: [&str; 8] =
    ["handles", "pedal", "steps", "events", "frames", "notes", "checkpoints", "pictures"];

type Out = BufWriter<Box<dyn Write>>;

/// Where each kind of item goes.
struct Outputs {
    poses: Option<PosesCsv<Out>>,
    blobs: Option<Out>,
    table: Option<(String, Out)>,
    counts: [u64; 3],
}

/// Runs it.
pub fn run(args: &ExportArgs) -> anyhow::Result<ExitCode> {
    export(args).or_else(|error| match error.downcast_ref::<std::io::Error>() {
        // Whoever reads the table has seen enough of it.
        Some(e) if e.kind() == ErrorKind::BrokenPipe => Ok(ExitCode::SUCCESS),
        _ => Err(error),
    })
}

fn export(args: &ExportArgs) -> anyhow::Result<ExitCode> {
    let recording = Recording::open(&args.file)?;
    if let Some(rig) = &args.what.rig {
        std::fs::write(rig, &recording.provenance().rig_json).with_context(|| rig.display().to_string())?;
    }
    let mut outputs = Outputs::open(args)?;
    let bar = bytes_bar(recording.bytes(), "export");
    let mut items = recording.items();
    let mut damage = None;
    while let Some(item) = items.next() {
        match item {
            Ok((log_time, item)) => outputs.take(log_time, &item)?,
            Err(error) => damage = Some(damage.unwrap_or(error)),
        }
        bar.set_position(items.bytes_read());
    }
    bar.finish_and_clear();
    outputs.finish(&args.file)?;
    // What could be read has been written; the loss is told and shows in the exit code.
    let Some(error) = damage else { return Ok(ExitCode::SUCCESS) };
    message(Level::WARN, &format!("{error}"));
    Ok(ExitCode::from(crate::exit::LOSS))
}

fn create(path: &Path) -> anyhow::Result<Out> {
    let file = File::create(path).with_context(|| path.display().to_string())?;
    Ok(BufWriter::new(Box::new(file)))
}

impl Outputs {
    fn open(args: &ExportArgs) -> anyhow::Result<Self> {
        let poses = args.what.poses.as_deref().map(create).transpose()?;
        let poses = poses.map(PosesCsv::new).transpose()?;
        let blobs = args.what.blobs.as_deref().map(create).transpose()?;
        let table = match &args.what.csv {
            None => None,
            Some(topic) => {
                let out: Out = match &args.output {
                    Some(path) => create(path)?,
                    None => BufWriter::new(Box::new(stdout())),
                };
                let mut out = out;
                writeln!(out, "log_time_ns,{}", header(topic))?;
                Some((topic.clone(), out))
            }
        };
        Ok(Outputs { poses, blobs, table, counts: [0; 3] })
    }

    fn take(&mut self, log_time: Nanos, item: &Item) -> anyhow::Result<()> {
        match (item, &mut self.poses, &mut self.blobs) {
            (Item::Poses(frame), Some(poses), _) => {
                poses.measured(frame, frame.instants.tracked)?;
                self.counts[0] += 1;
            }
            (Item::Blobs(field), _, Some(blobs)) => {
                writeln!(blobs, "{}", write_line(field))?;
                self.counts[1] += 1;
            }
            _ => {}
        }
        if let Some((_, out)) = self.table.as_mut().filter(|(topic, _)| item.topic() == topic) {
            writeln!(out, "{log_time},{}", row(item))?;
            self.counts[2] += 1;
        }
        Ok(())
    }

    fn finish(self, file: &Path) -> anyhow::Result<()> {
        let file = file.display();
        if let Some(poses) = self.poses {
            poses.finish()?;
            if self.counts[0] == 0 {
                bail!(
                    "{file} holds no poses; `vitreo replay {file} --lockstep --poses OUT.csv` computes them"
                );
            }
        }
        if let Some(mut blobs) = self.blobs {
            blobs.flush()?;
        }
        if let Some((topic, mut out)) = self.table {
            out.flush()?;
            if self.counts[2] == 0 {
                message(Level::WARN, &format!("{file} holds nothing on topic {topic}"));
            }
        }
        Ok(())
    }
}

fn header(topic: &str) -> &'static str {
    match topic {
        "handles" => "seq,field,instant_ns,instrument,tool,jaw_rad",
        "pedal" => "seq,instant_ns,axis0,axis1,buttons,mode",
        "steps" => {
            "step,field,frame,exposed,read_out,blobs_out,taken,tracked,stepped,handles_below,pedals_below,\
             advanced_ns,state_hash,collision_ns,tissue_ns,transfer_ns,misc_ns,inputs_refused,frames_lost"
        }
        "events" => {
            "seq,field,exposed_ns,kind,severity,instrument,subject,value,limit,x_in_eye_mm,y_in_eye_mm,z_in_eye_mm"
        }
        "frames" => {
            "frame,field,scene_field,exposed,read_out,blobs_out,taken,tracked,stepped,frame_start,latched,\
             drawn,displayed,predicted_to,missed,tier,width_px,height_px,flags"
        }
        "notes" => "instant_ns,kind,process,count,text",
        "checkpoints" => "step,field,handles_below,pedals_below,state_hash,bytes",
        _ => "frame,field,displayed,bytes",
    }
}

fn joined<T: std::fmt::Display>(cells: &[T]) -> String {
    cells.iter().map(T::to_string).collect::<Vec<_>>().join(",")
}

fn instants(i: &protocol::time::Instants) -> String {
    joined(&[i.exposed, i.read_out, i.blobs_out, i.taken, i.tracked, i.stepped])
}

/// The cells of [`header`].
fn row(item: &Item) -> String {
    match item {
        Item::Handle(h) => {
            format!("{},{},{},{},{},{}", h.seq, h.field, h.instant_ns, h.instrument, h.tool, h.jaw_rad)
        }
        Item::Pedal(p) => {
            format!("{},{},{},{},{}", p.seq, p.instant_ns, joined(&p.axes), p.buttons, p.mode)
        }
        Item::Step(s) => {
            let t = s.times;
            let first = joined(&[s.step, s.field, s.frame]);
            let inputs = joined(&[s.handles_below, s.pedals_below, s.advanced_ns]);
            let times = joined(&[t.collision_ns, t.tissue_ns, t.transfer_ns, t.misc_ns]);
            let losses = joined(&[s.inputs_refused, s.frames_lost]);
            format!("{first},{},{inputs},{:016x},{times},{losses}", instants(&s.instants), s.state_hash)
        }
        Item::Event(e) => {
            let codes = joined(&[e.kind, e.severity, e.instrument, e.subject]);
            let place = joined(&e.position_in_eye_mm);
            format!("{},{},{},{codes},{},{},{place}", e.seq, e.field, e.exposed_ns, e.value, e.limit)
        }
        Item::Frame(f) => {
            let first = joined(&[f.frame, f.field, f.scene_field]);
            let own = joined(&[f.frame_start, f.latched, f.drawn, f.displayed, f.predicted_to, f.missed]);
            let figures = joined(&[f.tier, f.width_px, f.height_px, f.flags]);
            format!("{first},{},{own},{figures}", instants(&f.instants))
        }
        Item::Note(n) => {
            let process = n.process.map_or("", |p| p.name());
            format!("{},{:?},{process},{},{}", n.instant_ns, n.kind, n.count, quoted(&n.text))
        }
        Item::Checkpoint(c, _) => {
            let inputs = joined(&[c.step, c.field, c.handles_below, c.pedals_below]);
            format!("{inputs},{:016x},{}", c.state_hash, c.bytes)
        }
        Item::Picture(p, _) => joined(&[p.frame, p.field, p.displayed, p.bytes]),
        Item::Blobs(_) | Item::Poses(_) => String::new(),
    }
}

/// A text cell after RFC 4180.
fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('"', "\"\""))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use recording::{Note, NoteKind};

    #[test]
    fn every_table_has_as_many_cells_as_its_header() {
        let note =
            Note { instant_ns: 1, kind: NoteKind::Loss, process: None, count: 2, text: "a \"b\"".into() };
        let items = [
            Item::Handle(Zeroable::zeroed()),
            Item::Pedal(Zeroable::zeroed()),
            Item::Step(Zeroable::zeroed()),
            Item::Event(Zeroable::zeroed()),
            Item::Frame(Zeroable::zeroed()),
            Item::Note(note),
            Item::Checkpoint(Zeroable::zeroed(), Vec::new()),
            Item::Picture(Zeroable::zeroed(), Vec::new()),
        ];
        for item in items {
            assert!(TABLES.contains(&item.topic()));
            let cells = |text: &str| text.split(',').count();
            assert_eq!(cells(&row(&item)), cells(header(item.topic())), "{}", item.topic());
        }
        assert_eq!(quoted("a \"b\""), "\"a \"\"b\"\"\"");
    }
}
