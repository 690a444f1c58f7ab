//! The rig of a recording of pixels that replaces the cameras of a run (`--cameras mcap:FILE`).

use super::cameras::check_sources;
use super::options::RunArgs;
use crate::memory_file::MemoryFile;
use anyhow::{Context, bail, ensure};
use protocol::file::MAX_SETTINGS_BYTES;
use recording::PixelsReader;
use rig::Rig;
use settings::commands::cameras::{StreamKind, Streams};
use std::path::Path;

/// Relative difference up to which two field rates count as equal.
const SAME_RATE: f64 = 0.01;

/// Cameras of a recording.
struct Recorded {
    rig: Rig,
    /// Ids of the recorded cameras.
    cameras: Vec<u32>,
}

impl RunArgs {
    /// Fills in the rig of the recording if no other is given. The rig is a file that exists as long as the
    /// second value.
    ///
    /// # Errors
    /// If the recording cannot be read or has no valid rig.
    pub fn with_rig_of_recording(&self) -> anyhow::Result<(Self, Option<MemoryFile>)> {
        let mut args = self.clone();
        let Some(streams) = self.real.streams().filter(|_| self.rig.rig.is_none()) else {
            return Ok((args, None));
        };
        let Some(file) = recordings(streams).next() else { return Ok((args, None)) };
        check_sources(streams)?;
        let held = MemoryFile::new(&read(file)?.rig.to_json())?;
        (args.rig.rig, args.rig_of) = (Some(held.name().into()), Some(file.into()));
        Ok((args, Some(held)))
    }
}

/// Checks that the cameras of the recordings are those of the rig.
///
/// # Errors
/// If they differ, or a recording cannot be read.
pub fn check(streams: &Streams, rig: &Rig) -> anyhow::Result<()> {
    for file in recordings(streams) {
        if let Some(difference) = difference(rig, &read(file)?) {
            let name = file.display();
            bail!(
                "--cameras mcap:{name}: {difference}; without --rig, the run uses the rig of the recording"
            );
        }
    }
    Ok(())
}

fn recordings(streams: &Streams) -> impl Iterator<Item = &Path> {
    streams.0.iter().filter(|stream| stream.kind == StreamKind::Mcap).map(|stream| &*stream.path)
}

fn read(file: &Path) -> anyhow::Result<Recorded> {
    let name = file.display();
    let head = PixelsReader::open(file, None).context("--cameras")?.head;
    ensure!(head.rig_json.len() as u64 <= MAX_SETTINGS_BYTES, "{name}: its rig is longer than any rig file");
    let rig = Rig::parse(&head.rig_json, &format!("the rig of {name}"))?;
    Ok(Recorded { rig, cameras: head.cameras })
}

/// The first difference between the cameras of a rig and those of a recording, as text.
fn difference(rig: &Rig, recorded: &Recorded) -> Option<String> {
    let ids: Vec<u32> = rig.cameras.iter().map(|camera| camera.id).collect();
    if let Some(id) = ids.iter().find(|id| !recorded.cameras.contains(id)) {
        return Some(format!(
            "has the cameras {:?}; camera {id} of the rig is not among them",
            recorded.cameras
        ));
    }
    if let Some(id) = recorded.cameras.iter().find(|id| !ids.contains(id)) {
        return Some(format!("has camera {id}; the rig has the cameras {ids:?}"));
    }
    ids.into_iter().find_map(|id| {
        let (own, other) = (rig.sensor(id), recorded.rig.sensor(id));
        let ([w, h], [x, y]) = (own.size_px, other.size_px);
        let hz = [own, other].map(|sensor| 1e9 / sensor.period_ns as f64);
        let differs = |what: String, of_rig: String| {
            Some(format!("camera {id} was recorded {what}, and the rig has {of_rig}"))
        };
        if [w, h] != [x, y] {
            differs(format!("with {x}×{y} px"), format!("{w}×{h} px"))
        } else if own.scan != other.scan {
            differs(format!("as {}", other.scan.name()), own.scan.name().into())
        } else if (hz[1] / hz[0] - 1.0).abs() > SAME_RATE {
            differs(format!("at {:.2} Hz", hz[1]), format!("{:.2} Hz", hz[0]))
        } else {
            None
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use recording::{PixelsHead, PixelsWriter};
    use std::fs::File;

    fn shipped() -> Rig {
        Rig::load_or_shipped(None).unwrap()
    }

    #[test]
    fn what_cameras_are_is_compared_and_named() {
        let told = |change: fn(&mut Rig, &mut Vec<u32>)| {
            let (mut rig, mut cameras) = (shipped(), vec![0, 1, 2]);
            change(&mut rig, &mut cameras);
            difference(&shipped(), &Recorded { rig, cameras }).unwrap_or_default()
        };
        assert_eq!(told(|_, _| {}), "");
        // The positions of the cameras are those of the given rig.
        assert_eq!(told(|rig, _| rig.cameras[1].t[0] += 5.0), "");
        assert!(told(|_, cameras| _ = cameras.pop()).contains("camera 2 of the rig is not among them"));
        assert!(
            told(|_, cameras| cameras.push(3)).contains("has camera 3; the rig has the cameras [0, 1, 2]")
        );
        assert!(told(|rig, _| rig.cameras[2].width = 640).contains("camera 2 was recorded with 640×"));
        let rate = told(|rig, _| rig.field_hz = 200.0);
        assert!(rate.contains("camera 0 was recorded at 200.00 Hz, and the rig has 50.00 Hz"), "{rate}");
    }

    #[test]
    fn a_recording_brings_its_rig_unless_another_is_given() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut args = RunArgs::default();
        args.real.cameras = Some(format!("mcap:{}", path.display()).parse().unwrap());
        assert!(args.with_rig_of_recording().unwrap_err().to_string().contains("a.mcap"));
        let mut own = shipped();
        own.cameras[0].t[0] += 1.0;
        let head = PixelsHead {
            rig_json: own.to_json(),
            cameras: vec![0, 1, 2],
            field_hz: 50.0,
            realtime_offset_ns: 0,
            sources: Vec::new(),
        };
        PixelsWriter::on(File::create(&path).unwrap(), &path, &head).unwrap().finish().unwrap();
        let (with, held) = args.with_rig_of_recording().unwrap();
        let rig = Rig::load(with.rig.rig.as_deref().unwrap()).unwrap();
        assert!(held.is_some() && rig == own && with.rig_of == Some(path));
        args.rig.rig = Some("r.json".into());
        let (with, held) = args.with_rig_of_recording().unwrap();
        assert!(held.is_none() && with.rig.rig == args.rig.rig);
    }
}
