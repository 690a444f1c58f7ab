//! `vitreo export`: the contents of a recording as CSV, JSON lines or the rig file, as recorded.

mod matches;
mod poses;
mod tum;

use anyhow::bail;
use blob_stream::poses_csv::PosesCsv;
use blob_stream::write_line;
use bytemuck::pod_read_unaligned;
use ipc::logging::warn;
use outputs::progress::bytes_bar;
use outputs::{OutputFile, STDOUT, no_formula};
use protocol::matches::MatchFrame;
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use protocol::wire::{Kind, Layout, Role};
use recording::{Item, Note, Provenance, Recording};
use settings::commands::{ExportArgs, What};
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;
use tum::Trajectories;

/// Where each kind of item goes.
struct Tables {
    poses: Option<PosesCsv<OutputFile>>,
    blobs: Option<OutputFile>,
    trajectories: Option<Trajectories>,
    table: Option<(String, OutputFile)>,
    counts: [u64; 3],
}

/// Runs it.
///
/// # Errors
/// Where the recording cannot be read, or a file exists already or cannot be written.
pub fn run(args: &ExportArgs) -> anyhow::Result<ExitCode> {
    let recording = Recording::open(&args.file)?;
    let mut outputs = outputs::Outputs::new(args.force.force).reading_all(recording::files_of(&args.file));
    let mut tables = Tables::open(args, recording.provenance(), &mut outputs)?;
    if let Some(rig) = &args.what.rig {
        outputs.write(rig, &recording.provenance().rig_json)?;
    }
    let bar = bytes_bar(recording.bytes(), "export");
    let mut items = recording.items();
    let mut damage = None;
    while let Some(item) = items.next() {
        match item {
            Ok((log_time, item)) => tables.take(log_time, &item)?,
            Err(error) => damage = Some(damage.unwrap_or(error)),
        }
        bar.set_position(items.bytes_read());
    }
    bar.finish_and_clear();
    tables.finish(&args.file)?;
    // What could be read has been written; the loss is reported and shows in the exit code.
    let Some(error) = damage else { return Ok(ExitCode::SUCCESS) };
    warn(&format!("{error}"));
    Ok(ExitCode::from(outputs::exit::LOSS))
}

impl Tables {
    fn open(
        args: &ExportArgs,
        provenance: &Provenance,
        outputs: &mut outputs::Outputs,
    ) -> anyhow::Result<Self> {
        let to = args.what.csv.as_ref().map(|_| args.output.as_deref().unwrap_or(Path::new(STDOUT)));
        let What { poses, blobs, rig, csv, tum } = &args.what;
        for path in [poses, blobs, rig].into_iter().filter_map(|p| p.as_deref()).chain(to) {
            outputs.claim(path)?;
        }
        let body = args.body.as_deref();
        let trajectories =
            tum.as_deref().map(|to| Trajectories::open(to, body, provenance, outputs)).transpose()?;
        let poses = poses.as_deref().map(|path| outputs.create(path)).transpose()?;
        let poses = poses.map(PosesCsv::new).transpose()?;
        let blobs = blobs.as_deref().map(|path| outputs.create(path)).transpose()?;
        let mut table = None;
        if let Some((topic, to)) = csv.as_ref().zip(to) {
            let mut out = outputs.create(to)?;
            writeln!(out, "log_time_ns,{}", header(topic))?;
            table = Some((topic.clone(), out));
        }
        Ok(Tables { poses, blobs, trajectories, table, counts: [0; 3] })
    }

    fn take(&mut self, log_time: Nanos, item: &Item) -> anyhow::Result<()> {
        if let (Item::Poses(frame), Some(trajectories)) = (item, &mut self.trajectories) {
            trajectories.take(frame)?;
        }
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
            for row in rows(item) {
                writeln!(out, "{log_time},{row}")?;
                self.counts[2] += 1;
            }
        }
        Ok(())
    }

    fn finish(self, file: &Path) -> anyhow::Result<()> {
        let file = file.display();
        if let Some(poses) = self.poses {
            let whole = poses.into_inner();
            if self.counts[0] == 0 {
                bail!(
                    "{file} contains no poses; `vitreo replay {} --lockstep --poses OUT.csv` computes them",
                    outputs::shell_word(&file)
                );
            }
            whole.finish()?;
        }
        if let Some(blobs) = self.blobs {
            blobs.finish()?;
        }
        let empty = self.trajectories.map(Trajectories::finish).transpose()?.unwrap_or_default();
        if !empty.is_empty() {
            warn(&format!("{file} contains no measured pose of {}", empty.join(", ")));
        }
        if let Some((topic, out)) = self.table {
            out.finish()?;
            if self.counts[2] == 0 {
                warn(&format!("{file} contains nothing on topic {topic}"));
            }
        }
        Ok(())
    }
}

/// Names of a table's columns after the log time.
fn header(topic: &str) -> String {
    match topic {
        MatchFrame::CHANNEL => return matches::HEADER.into(),
        TrackerFrame::CHANNEL => return poses::header(),
        _ => {}
    }
    let Some(layout) = Item::layout(topic) else { return "instant_ns,kind,process,count,text".into() };
    let mut names = Vec::new();
    columns(layout, &mut names);
    names.join(",")
}

/// Appends the names of a block's columns; those of a struct within stand in its place.
fn columns(layout: &Layout, names: &mut Vec<&'static str>) {
    for field in layout.recorded() {
        match (field.columns, field.kind) {
            (Some(own), _) => names.extend(own.split(',').filter(|name| !name.is_empty())),
            (None, Kind::Struct(inner)) => columns(inner, names),
            (None, _) => names.push(field.name),
        }
    }
}

/// The rows of an item, each after the log time.
fn rows(item: &Item) -> Vec<String> {
    match item {
        Item::Matches(matches) => matches::rows(matches),
        Item::Poses(frame) => poses::rows(frame),
        _ => vec![row(item)],
    }
}

/// The cells of an item's row after the log time; one with several rows has cells of its own numbers alone.
pub fn row(item: &Item) -> String {
    if let Item::Note(note) = item {
        return row_of_note(note);
    }
    let Some(block) = item.block() else { return String::new() };
    let mut out = Vec::new();
    cells(block.layout, block.bytes, &mut out);
    out.join(",")
}

/// The cells of a note, of which one is text.
fn row_of_note(note: &Note) -> String {
    let process = note.process.map_or("", |p| p.name());
    let [instant, count] = [note.instant_ns, note.count].map(|n| n.to_string());
    let cells = [&instant, &format!("{:?}", note.kind), process, &count, &no_formula(&note.text)];
    let mut row = csv::WriterBuilder::new().terminator(csv::Terminator::Any(b'\n')).from_writer(Vec::new());
    row.write_record(cells).expect("memory takes it");
    let row = row.into_inner().expect("memory takes it");
    String::from_utf8(row).expect("of texts").trim_end_matches('\n').to_owned()
}

/// Appends the cells of a block, in the order of [`columns`].
fn cells(layout: &Layout, block: &[u8], out: &mut Vec<String>) {
    for field in layout.recorded().filter(|f| f.columns != Some("")) {
        let bytes = field.bytes(block);
        match (field.kind, field.role) {
            (Kind::Struct(inner), _) => cells(inner, bytes, out),
            (Kind::Array(element, _), _) => {
                out.extend(bytes.chunks_exact(element.size()).map(|one| number(element, one)));
            }
            (_, Role::Hash) => out.push(format!("{:016x}", pod_read_unaligned::<u64>(bytes))),
            (kind, _) => out.push(number(&kind, bytes)),
        }
    }
}

fn number(kind: &Kind, bytes: &[u8]) -> String {
    match kind {
        Kind::F32 => pod_read_unaligned::<f32>(bytes).to_string(),
        Kind::F64 => pod_read_unaligned::<f64>(bytes).to_string(),
        Kind::U64 => pod_read_unaligned::<u64>(bytes).to_string(),
        Kind::U32 => pod_read_unaligned::<u32>(bytes).to_string(),
        _ => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::message::fnv1a;
    use settings::commands::TABLES;

    /// Topic, header, rows and FNV-1a of the rows in two recordings.
    type FormerTable = (&'static str, &'static str, [(usize, u64); 2]);

    /// The tables of two recordings as the first version printed them, cell by cell and without the
    /// table of fields.
    const FORMER: [FormerTable; 8] = [
        (
            "handles",
            "seq,field,instant_ns,instrument,tool,jaw_rad",
            [(200, 0xff86d073a27b3288), (300, 0xeef8d9b947e95846)],
        ),
        (
            "pedal",
            "seq,instant_ns,axis0,axis1,buttons,mode",
            [(20, 0x7fb65ba5c5038bfa), (30, 0xe1782482b77555e5)],
        ),
        (
            "steps",
            "step,field,frame,exposed,read_out,blobs_out,taken,tracked,stepped,handles_below,pedals_below,advanced_ns,state_hash,collision_ns,tissue_ns,transfer_ns,misc_ns,inputs_refused,frames_lost",
            [(100, 0xc652f16de901aea3), (150, 0x5d3230b87829363d)],
        ),
        (
            "events",
            "seq,field,exposed_ns,kind,severity,instrument,subject,value,limit,x_in_eye_mm,y_in_eye_mm,z_in_eye_mm",
            [(0, 0xdfaa51bbd62b0912), (6, 0x00e4f8c9a1608208)],
        ),
        (
            "frames",
            "frame,field,scene_field,exposed,read_out,blobs_out,taken,tracked,stepped,frame_start,latched,drawn,displayed,predicted_to,missed,tier,width_px,height_px,flags",
            [(0, 0xbea3061b9f3016f2), (0, 0xbea3061b9f3016f2)],
        ),
        ("notes", "instant_ns,kind,process,count,text", [(0, 0xf63b8ee512069103), (0, 0xf63b8ee512069103)]),
        (
            "checkpoints",
            "step,field,handles_below,pedals_below,state_hash,bytes",
            [(1, 0xb70ba9412f799f59), (1, 0x77cdb111cb6a58f9)],
        ),
        ("pictures", "frame,field,displayed,bytes", [(0, 0x927c3eada4764874), (0, 0x927c3eada4764874)]),
    ];

    #[test]
    fn tables_are_those_of_the_first_version() {
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data");
        for (topic, columns, figures) in FORMER {
            assert!(TABLES.contains(&topic));
            for (file, (rows, hash)) in ["corpus/peel.mcap", "corpus/peeling.mcap"].iter().zip(figures) {
                let mut table = format!("log_time_ns,{}\n", header(topic));
                assert_eq!(table, format!("log_time_ns,{columns}\n"));
                for item in Recording::open(&data.join(file)).unwrap().items() {
                    let (log_time, item) = item.unwrap();
                    if item.topic() == topic {
                        table += &format!("{log_time},{}\n", row(&item));
                    }
                }
                assert_eq!(
                    (table.lines().count() - 1, fnv1a(table.as_bytes())),
                    (rows, hash),
                    "{topic} of {file}"
                );
            }
        }
    }

    #[test]
    fn every_row_has_as_many_cells_as_its_header() {
        let items = [
            Item::Step(Zeroable::zeroed()),
            Item::Frame(Zeroable::zeroed()),
            Item::Picture(Zeroable::zeroed(), Vec::new()),
        ];
        for item in items {
            let cells = |text: &str| text.split(',').count();
            assert_eq!(cells(&row(&item)), cells(&header(item.topic())), "{}", item.topic());
        }
    }
}
