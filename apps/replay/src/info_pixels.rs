//! `vitreo info` of a recording of pixels: its cameras, where their pictures came from, and what they were set to.

use crate::info::NOT_CLOSED;
use ipc::logging::warn;
use outputs::exit::LOSS;
use outputs::println;
use recording::PixelsReader;
use serde::Serialize;
use settings::commands::InfoArgs;
use std::process::ExitCode;

/// One of its cameras.
#[derive(Debug, Serialize)]
struct Camera {
    camera: u32,
    /// As `--cameras` took it, with the settings that were asked for.
    source: Option<String>,
    /// What it was set to, in the order of time.
    settings: Vec<String>,
    fields: u64,
}

/// What a recording of pixels holds.
#[derive(Debug, Serialize)]
struct Contents {
    file: String,
    bytes: u64,
    source: &'static str,
    /// The file ends in order.
    finished: bool,
    field_hz: f64,
    /// From the first field's exposure to the last one's, s.
    duration_s: f64,
    cameras: Vec<Camera>,
    damage: Option<String>,
}

impl Contents {
    /// Reads the whole file.
    fn read(args: &InfoArgs) -> anyhow::Result<Self> {
        let mut reader = PixelsReader::open(&args.file, None)?;
        let (ids, sources) = (reader.head.cameras.clone(), reader.head.sources.clone());
        let camera = |(i, id): (usize, &u32)| Camera {
            camera: *id,
            source: sources.get(i).cloned(),
            settings: Vec::new(),
            fields: 0,
        };
        let mut cameras: Vec<Camera> = ids.iter().enumerate().map(camera).collect();
        let (mut samples, mut span, mut damage) = (Vec::new(), None, None);
        loop {
            match reader.next(&mut samples) {
                Ok(Some(header)) => {
                    let own = cameras.iter_mut().filter(|camera| camera.camera == header.camera);
                    own.for_each(|camera| camera.fields += 1);
                    let [first, last] = span.unwrap_or([header.exposed_ns; 2]);
                    span = Some([header.exposed_ns.min(first), header.exposed_ns.max(last)]);
                }
                Ok(None) => break,
                Err(error) => {
                    damage = Some(error.to_string());
                    break;
                }
            }
        }
        for camera in &mut cameras {
            camera.settings = reader.settings.remove(&camera.camera).unwrap_or_default();
        }
        Ok(Contents {
            file: args.file.display().to_string(),
            bytes: std::fs::metadata(&args.file)?.len(),
            source: "pixels",
            finished: !reader.is_cut && damage.is_none(),
            field_hz: reader.head.field_hz,
            duration_s: span.map_or(0.0, |[first, last]| (last - first) as f64 * 1e-9),
            cameras,
            damage,
        })
    }

    fn print(&self) {
        let state = match (&self.damage, self.finished) {
            (Some(damage), _) => damage,
            (None, true) => "complete",
            (None, false) => NOT_CLOSED,
        };
        println!("{}", self.file);
        println!("  {:.1} MiB, {}, {state}", self.bytes as f64 / f64::from(1 << 20), self.source);
        println!("  {:.2} s, {} fields a second", self.duration_s, self.field_hz);
        for Camera { camera, source, settings, fields } in &self.cameras {
            let source = source.as_ref().map_or(String::new(), |source| format!(" of {source}"));
            println!("  camera {camera}: {fields} fields{source}");
            settings.iter().for_each(|set| println!("    set to: {set}"));
        }
    }
}

/// Runs it. A file that is damaged or was not closed is described as far as it can be read, with exit code 3.
///
/// # Errors
/// Where the file cannot be read as a recording of pixels.
pub(crate) fn run(args: &InfoArgs) -> anyhow::Result<ExitCode> {
    let contents = Contents::read(args)?;
    match args.json {
        true => println!("{}", serde_json::to_string_pretty(&contents)?),
        false => contents.print(),
    }
    if contents.damage.is_none() && !contents.finished {
        warn(&format!("{}: {NOT_CLOSED}", contents.file));
    }
    Ok(ExitCode::from(if contents.finished { 0 } else { LOSS }))
}
