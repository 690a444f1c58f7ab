//! `vitreo cameras SPEC,…`: a line a second for each camera, and a picture of each.

use super::CamerasArgs;
use super::clips::{CLIPS, Clips};
use super::pixels::Pixels;
use super::watch::Watch;
use crate::process::capture::Capture;
use anyhow::{Context, Result, bail, ensure};
use bytemuck::Zeroable;
use fpga_model::camera_extractor::CameraExtractor;
use fpga_model::colours::file::ColourFile;
use fpga_model::input::overlay::{draw, png};
use fpga_model::input::{Interlace, Picture};
use fpga_model::pixels;
use ipc::Bell;
use ipc::clock::{now, sleep_until};
use outputs::exit::WrongUse;
use outputs::{Names, Outputs};
use protocol::blobs::BlobField;
use protocol::fields::{FieldHeader, FieldPicture};
use protocol::time::Nanos;
use rig::Rig;
use rig::sensor::Scan;
use scene::{DEFAULT_SCENE, SceneFile};
use settings::commands::cameras::Cameras;
use std::io::{IsTerminal, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use surgeon::motion::MotionSource;
use virtual_rig::cameras::{Cameras as Virtual, Path as Way};

/// Time between two looks, and between two lines, ns.
const LOOK_NS: u64 = 2_000_000;
const LINE_NS: u64 = 1_000_000_000;
/// Longest wait for a camera's picture for a snapshot, ns.
const SNAPSHOT_NS: u64 = 10_000_000_000;
/// Files of a snapshot.
const PICTURES: Names = &[["camera-", ".png"]];
/// Of the motion of the virtual cameras.
const SEED: u64 = 1;

/// What one camera shows.
struct Look {
    name: String,
    /// Id of the camera in the rig, and its source as it was given.
    camera: u32,
    source: String,
    extractor: CameraExtractor,
    planes: FieldPicture,
    /// From field to field as the rig says, ns.
    period_ns: u64,
    blobs: Box<BlobField>,
    watch: Watch,
    /// Rows of a snapshot for each line.
    lines: u32,
    /// The newest picture, where one is wanted.
    snapshot: Option<Picture>,
}

/// Where all fields are kept.
enum Fields {
    Clips(Clips),
    Pixels(Box<Pixels>),
}

impl Fields {
    fn begin(to: &Path, looks: &[Look], rig: &Rig, outputs: &mut Outputs) -> Result<Self> {
        if to.extension().is_some_and(|ending| ending == "mcap") {
            let sources = looks.iter().map(|look| look.source.clone()).collect();
            return Ok(Fields::Pixels(Box::new(Pixels::begin(to, sources, rig, outputs)?)));
        }
        outputs.claim_folder(to, CLIPS)?;
        Clips::begin(to, looks.iter().map(Look::hz), outputs).map(Fields::Clips)
    }

    /// Ends them, and returns them as `--cameras` takes them.
    fn finish(self) -> Result<String> {
        match self {
            Fields::Clips(clips) => Ok(clips.finish()?.join(",")),
            Fields::Pixels(pixels) => pixels.finish(),
        }
    }
}

impl Look {
    /// Fields a second as the rig says.
    fn hz(&self) -> f64 {
        1e9 / self.period_ns as f64
    }
}

/// What is kept of the pictures.
struct Kept {
    snapshot: bool,
    fields: Option<Fields>,
}

impl Kept {
    fn any(&self) -> bool {
        self.snapshot || self.fields.is_some()
    }

    /// Keeps what a camera was set to.
    fn set(&mut self, look: &Look, settings: &str) -> Result<()> {
        match &mut self.fields {
            Some(Fields::Pixels(pixels)) => pixels.set(look.camera, settings),
            _ => Ok(()),
        }
    }

    /// Keeps a field of camera `i`.
    fn take(&mut self, i: usize, look: &mut Look, header: &FieldHeader, picture: Picture) -> Result<()> {
        match &mut self.fields {
            Some(Fields::Clips(clips)) => clips.keep(i, header.field, header.parity, &picture)?,
            Some(Fields::Pixels(pixels)) => pixels.keep(header, &picture)?,
            None => {}
        }
        if self.snapshot {
            look.snapshot = Some(picture);
        }
        Ok(())
    }
}

/// Where the pictures come from.
enum Source {
    /// Sources that are read.
    Feeds(Capture),
    /// Those that vitreo invents, with the number of each camera's next field.
    Virtual { cameras: Box<Virtual>, surgeon: Box<MotionSource>, numbers: Vec<u64>, start_ns: Nanos },
}

/// Shows the cameras until Ctrl-C, the end of their files or of the time, or until all are in the snapshot.
///
/// # Errors
/// Where the rig or a source is refused, a camera brings nothing for the snapshot, or it cannot be written.
pub fn run(args: &CamerasArgs, cameras: &Cameras) -> Result<()> {
    let rig = Rig::load_or_shipped(args.rig.rig.as_deref())?;
    let colours = ColourFile::load_or_shipped(args.extraction.colours.as_deref()).context("--colours")?;
    let read = args.rig.rig.iter().chain(&args.extraction.colours);
    let mut outputs = Outputs::new(args.force.force).reading_all(read);
    let bell = Bell::new()?;
    let stop = Arc::<AtomicBool>::default();
    let mut looks = looks(&rig, cameras, &colours)?;
    if let Some(folder) = &args.snapshot {
        outputs.claim_folder(folder, PICTURES)?;
    }
    let mut kept = Kept { snapshot: args.snapshot.is_some(), fields: None };
    if let Some(to) = &args.record_fields {
        kept.fields = Some(Fields::begin(to, &looks, &rig, &mut outputs)?);
    }
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    // Last: what comes from now on is read at once.
    let mut source = Source::open(&rig, cameras, &bell, &stop)?;
    let (begun, mut lined) = (now(), now());
    let ends = args.duration.map(|s| begun + (s * 1e9) as u64);
    let wants = kept.snapshot;
    let mut shown = Shown { in_place: std::io::stdout().is_terminal(), lines: 0 };
    loop {
        let at = now();
        source.take(&mut looks, at, &mut kept)?;
        let all_there = wants && looks.iter().all(|look| look.snapshot.is_some());
        let is_over = stop.load(Ordering::Relaxed) || ends.is_some_and(|end| at >= end) || source.is_over();
        if at >= lined + LINE_NS || all_there || is_over {
            shown.show(&source.lines(&mut looks, at))?;
            lined = at;
        }
        let given_up = wants && at >= begun + SNAPSHOT_NS;
        if all_there || is_over || given_up {
            break;
        }
        sleep_until(at + LOOK_NS);
    }
    stop.store(true, Ordering::Relaxed);
    if let Some(fields) = kept.fields {
        outputs::println!("kept: {}", fields.finish()?);
    }
    args.snapshot.as_ref().map_or(Ok(()), |folder| save(&looks, folder, &mut outputs))
}

impl Source {
    fn open(rig: &Rig, cameras: &Cameras, bell: &Bell, stop: &Arc<AtomicBool>) -> Result<Self> {
        match cameras {
            Cameras::Program(program) => {
                bail!(WrongUse(format!(
                    "{}: expected v4l2:DEVICE, genicam:NAME, y4m:PATH, mcap:FILE or virtual; pictures of a \
                     program cannot be shown",
                    program.display()
                )))
            }
            Cameras::Virtual => {
                let scene = SceneFile::load(DEFAULT_SCENE)?;
                let surgeon = Box::new(MotionSource::new(&scene, rig, None, SEED));
                let cameras = Box::new(Virtual::new(rig, Way::Pixels, SEED)?);
                Ok(Source::Virtual { numbers: vec![0; cameras.len()], cameras, surgeon, start_ns: now() })
            }
            Cameras::Streams(streams) => {
                let streams = streams.spread(rig.cameras.len());
                Ok(Source::Feeds(Capture::start(rig, &streams, bell, stop)?))
            }
        }
    }

    /// Takes what has come.
    fn take(&mut self, looks: &mut [Look], at: Nanos, kept: &mut Kept) -> Result<()> {
        match self {
            Source::Feeds(capture) => {
                capture.listen(at, kept.fields.is_some())?;
                capture.publish(at, |i, settings, field| {
                    let look = &mut looks[i];
                    let mut payload = vec![0; field.header.bytes()];
                    field.write(&mut payload);
                    look.note(&field.header, &payload, at);
                    kept.set(look, settings)?;
                    if kept.any() { kept.take(i, look, &field.header, field.whole()) } else { Ok(()) }
                })
            }
            Source::Virtual { cameras, surgeon, numbers, start_ns } => {
                for (i, (look, number)) in looks.iter_mut().zip(numbers).enumerate() {
                    if at < *start_ns + *number * look.period_ns {
                        continue;
                    }
                    let mut exposure = cameras.expose(i, surgeon, *number);
                    let header = exposure.header();
                    let mut payload = vec![0; header.bytes()];
                    exposure.paint(&mut payload);
                    look.note(&header, &payload, at);
                    if kept.any() {
                        let picture = look.picture();
                        kept.take(i, look, &header, picture)?;
                    }
                    *number += 1;
                }
                Ok(())
            }
        }
    }

    fn is_over(&self) -> bool {
        matches!(self, Source::Feeds(capture) if capture.is_over())
    }

    /// A line for each camera.
    fn lines(&self, looks: &mut [Look], at: Nanos) -> Vec<String> {
        let line = |(i, look): (usize, &mut Look)| {
            let (lost, trouble) = match self {
                Source::Virtual { .. } => (0, None),
                Source::Feeds(capture) => {
                    let (feed, clock) = &capture.feeds[i];
                    let lost = feed.tally.lost + feed.tally.late + feed.tally.surplus;
                    (lost, feed.trouble(clock.is_some(), at))
                }
            };
            let text = look.watch.line(look.hz(), lost, trouble.as_ref().map(|t| t.text.as_str()));
            format!("{}: {text}", look.name)
        };
        looks.iter_mut().enumerate().map(line).collect()
    }
}

/// What the cameras that were named will show.
fn looks(rig: &Rig, cameras: &Cameras, colours: &ColourFile) -> Result<Vec<Look>> {
    let all = rig.cameras();
    let names: Vec<String> = match cameras {
        Cameras::Streams(streams) => streams.spread(all.len()).iter().map(ToString::to_string).collect(),
        other => vec![other.to_string(); all.len()],
    };
    let look = |(camera, source): (&rig::camera::Camera, String)| {
        let sensor = rig.sensor(camera.id);
        Ok(Look {
            name: format!("camera {} ({source})", camera.id),
            camera: camera.id,
            source,
            extractor: CameraExtractor::finding(rig, camera, colours)?,
            planes: FieldPicture::of_size(sensor.field_size()?),
            period_ns: sensor.period_ns,
            blobs: Box::new(BlobField::zeroed()),
            watch: Watch::default(),
            lines: if sensor.scan == Scan::Interlaced { 2 } else { 1 },
            snapshot: None,
        })
    };
    all.iter().zip(names).map(look).collect()
}

impl Look {
    fn note(&mut self, header: &FieldHeader, payload: &[u8], at: Nanos) {
        let found = self.extractor.extract_payload(header, payload, &mut self.blobs);
        let Some(lines) = found.and_then(|_| pixels::decode(header, payload, &mut self.planes)) else {
            return;
        };
        let luma = &self.planes.luma[..lines * self.planes.width];
        self.watch.note(luma, self.blobs.blobs().len(), at);
    }

    /// The newest field as a picture.
    fn picture(&self) -> Picture {
        let FieldPicture { width, height, luma, blue, red } = self.planes.clone();
        Picture { width, height, luma, blue, red, as_read: Vec::new() }
    }
}

/// Lines in the place of those before, where standard output is a terminal.
struct Shown {
    in_place: bool,
    lines: usize,
}

impl Shown {
    fn show(&mut self, lines: &[String]) -> Result<()> {
        let mut out = std::io::stdout().lock();
        if self.in_place && self.lines > 0 {
            write!(out, "\x1b[{}A", self.lines)?;
        }
        let clear = if self.in_place { "\x1b[2K" } else { "" };
        for line in lines {
            writeln!(out, "{clear}{}", outputs::printable(line))?;
        }
        self.lines = lines.len();
        Ok(out.flush()?)
    }
}

/// Writes the pictures. A camera without a picture is an error, after the others are written.
fn save(looks: &[Look], folder: &Path, outputs: &mut Outputs) -> Result<()> {
    let mut missing = Vec::new();
    for (i, look) in looks.iter().enumerate() {
        let Some(picture) = &look.snapshot else {
            missing.push(look.name.as_str());
            continue;
        };
        let file = folder.join(format!("camera-{i}.png"));
        let image = draw(&picture.view(Interlace::Progressive, 0), std::iter::empty(), look.lines);
        outputs.write(&file, png(&image)?)?;
        outputs::println!("{} is written", file.display());
    }
    ensure!(missing.is_empty(), "no picture from {} arrived", missing.join(" and "));
    Ok(())
}
