//! Live cameras: their pictures, and the blobs that are found in them, read as `vitreo run --cameras` reads them.

use crate::pictures::Look;
use anyhow::{Context, Result, anyhow};
use bytemuck::Zeroable;
use cameras::process::capture::{Taken, watch};
use fpga_model::camera_extractor::CameraExtractor;
use fpga_model::colours::file::ColourFile;
use fpga_model::input::Picture;
use fpga_model::input::whole::{Frames, frame_of};
use ipc::logging::inform;
use protocol::blobs::BlobField;
use protocol::fields::{FieldHeader, FieldPicture};
use rig::Rig;
use settings::commands::cameras::{Stream, Streams};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};

/// Live cameras in place of a recorded stream.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct LiveArgs {
    /// Live cameras in the order of the rig, instead of a stream: v4l2:/dev/videoN, genicam:NAME, y4m:PIPE, with settings
    /// as for vitreo run --cameras. Their blobs are found by colours.toml of the folder.
    #[arg(long, value_name = "SPEC,...", value_delimiter = ',', conflicts_with = "from")]
    pub cameras: Vec<Stream>,
    /// Watch live cameras for S seconds.
    #[arg(long, value_name = "S", default_value_t = SECONDS, value_parser = seconds, allow_negative_numbers = true)]
    pub seconds: f64,
}

/// Half a minute is what a stream should last.
pub const SECONDS: f64 = 30.0;
/// Longest time that live cameras are watched, s.
const LONGEST_S: f64 = 600.0;

/// Parses `--seconds`.
pub(crate) fn seconds(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|s| (1.0..=LONGEST_S).contains(s));
    number.ok_or_else(|| format!("expected 1 to {LONGEST_S} s"))
}

/// Which pictures are looked at: every Nth, and so many of each camera.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Choice {
    pub(crate) every: u64,
    pub(crate) most: usize,
}

/// A whole picture that was chosen.
struct Chosen {
    camera: u32,
    number: u64,
    picture: Picture,
}

/// Hands chosen pictures of all cameras to `look`, which may take its time: the cameras are read meanwhile.
///
/// # Errors
/// Those of the cameras and of `look`.
pub(crate) fn pictures(rig: &Rig, cameras: &[Stream], choice: Choice, look: &mut Look<'_>) -> Result<()> {
    let Choice { every, most } = choice;
    let seconds = (every * most as u64) as f64 / pictures_per_s(rig);
    inform(&format!("taking {most} pictures of each camera in {seconds:.0} s"));
    let (streams, stop) = (Streams(cameras.to_vec()), Arc::<AtomicBool>::default());
    let (to, from) = channel();
    std::thread::scope(|scope| {
        let reader = scope.spawn(|| choose(rig, &streams, &stop, choice, to));
        let mut looked = Ok(());
        for Chosen { camera, number, picture } in from {
            let name = format!("camera {camera}, picture {number}");
            looked = look(camera, &format!("{:04}", number / every), &name, &picture);
            if looked.is_err() {
                stop.store(true, Ordering::Relaxed);
                break;
            }
        }
        let read = reader.join().map_err(|_| anyhow!("a defect: the thread that reads the cameras panicked"));
        looked.and(read?)
    })
}

/// Whole pictures a second of the fastest camera.
fn pictures_per_s(rig: &Rig) -> f64 {
    let interlaced = rig.sensors().iter().any(|sensor| sensor.has_parity(0));
    if interlaced { rig.field_hz / 2.0 } else { rig.field_hz }
}

/// Reads the cameras until all have brought their pictures, and sends these.
fn choose(
    rig: &Rig,
    streams: &Streams,
    stop: &Arc<AtomicBool>,
    choice: Choice,
    to: Sender<Chosen>,
) -> Result<()> {
    let last = choice.every * (choice.most as u64 - 1);
    let mut frames: Vec<(Frames, bool)> = rig.cameras.iter().map(|_| (Frames::default(), false)).collect();
    watch(rig, streams, stop, &mut |Taken { place, header, mut picture }| {
        let (own, is_done) = &mut frames[place];
        let number = frame_of(&header);
        *is_done |= number > last;
        if !*is_done && number.is_multiple_of(choice.every) && own.take(&header, &mut picture).is_some() {
            *is_done = number == last;
            // Nobody receives where `look` has failed; the reading is being stopped then.
            let _ = to.send(Chosen { camera: header.camera, number, picture });
        }
        let all = frames.iter().all(|(_, is_done)| *is_done);
        Ok(if all { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
    })
}

/// The blobs of all cameras over some seconds, found by `colours` or the shipped ones, in the order of their read-out.
///
/// # Errors
/// Those of the cameras, and colours that cannot be read.
pub(crate) fn blobs(
    rig: &Rig,
    cameras: &[Stream],
    seconds: f64,
    colours: Option<&Path>,
) -> Result<Vec<BlobField>> {
    let colours = ColourFile::load_or_shipped(colours)?;
    let extractor = |camera| CameraExtractor::finding(rig, camera, &colours);
    let extractors: Result<Vec<_>, _> = rig.cameras().iter().map(extractor).collect();
    let (mut extractors, mut fields) = (extractors.context("a camera of the rig")?, Vec::new());
    inform(&format!("watching the cameras for {seconds:.0} s"));
    let (streams, mut ends_ns) = (Streams(cameras.to_vec()), None);
    watch(rig, &streams, &Arc::default(), &mut |Taken { place, header, picture }| {
        let end = *ends_ns.get_or_insert(header.read_out_ns() + (seconds * 1e9) as u64);
        fields.push(found(&mut extractors[place], &header, &picture));
        Ok(if header.read_out_ns() >= end { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
    })?;
    fields.sort_by_key(|field| field.blobs_out_ns);
    Ok(fields)
}

/// The blobs of a field.
fn found(extractor: &mut CameraExtractor, header: &FieldHeader, picture: &Picture) -> BlobField {
    let mut field = BlobField::zeroed();
    let Picture { width, height, luma, blue, red, .. } = picture;
    let planes =
        FieldPicture { width: *width, height: *height, luma: &luma[..], blue: &blue[..], red: &red[..] };
    field.blobs_out_ns = extractor.extract(header, &planes, &mut field).max(header.read_out_ns());
    field
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rig of one small camera, and a file of so many of its fields as its source: luma 30 + k in field k.
    fn source(folder: &Path, fields: u8, parity: u32) -> (Rig, Vec<Stream>) {
        let mut rig = Rig::load_or_shipped(None).unwrap();
        rig.frame = None;
        rig.cameras.truncate(1);
        (rig.cameras[0].width, rig.cameras[0].height) = (16, 32);
        let frame = |k: u8| [&b"FRAME\n"[..], &[30 + k; 256], &[128; 256]].concat();
        let frames: Vec<u8> = (0..fields).flat_map(frame).collect();
        let path = folder.join("a.y4m");
        std::fs::write(&path, [&b"YUV4MPEG2 W16 H16 F50:1 Ip C422\n"[..], &frames].concat()).unwrap();
        (rig, vec![format!("y4m:{}?parity={parity}", path.display()).parse().unwrap()])
    }

    #[test]
    fn two_fields_of_a_live_camera_make_a_picture() {
        let folder = tempfile::tempdir().unwrap();
        for parity in [0, 1] {
            let (rig, cameras) = source(folder.path(), 13, parity);
            let mut seen = Vec::new();
            pictures(&rig, &cameras, Choice { every: 2, most: 3 }, &mut |camera, view, name, picture| {
                assert!(camera == 0 && name.starts_with("camera 0, picture "), "{name}");
                assert_eq!([picture.width, picture.height], [16, 32]);
                seen.push((view.to_owned(), [picture.luma[0], picture.luma[16]]));
                Ok(())
            })
            .unwrap();
            // A machine that is busy elsewhere may cost fields, and with them pictures.
            assert!((1..=3).contains(&seen.len()), "{seen:?}");
            for (view, [even, odd]) in seen {
                assert_eq!(even.abs_diff(odd), 1, "{view}");
                assert!(view != "0000" || [even, odd] == [30 + parity as u8, 31 - parity as u8]);
            }
        }
    }

    #[test]
    fn a_look_that_fails_ends_the_reading() {
        let folder = tempfile::tempdir().unwrap();
        let (rig, mut cameras) = source(folder.path(), 100, 0);
        let choice = Choice { every: 1, most: 50 };
        let told = pictures(&rig, &cameras, choice, &mut |_, _, _, _| Err(anyhow!("too small"))).unwrap_err();
        assert_eq!(told.to_string(), "too small");
        cameras.push(cameras[0].clone());
        let told = pictures(&rig, &cameras, choice, &mut |_, _, _, _| Ok(())).unwrap_err().to_string();
        assert!(told.contains("--cameras: expected one for each of 1 cameras, found 2"), "{told}");
    }

    #[test]
    fn seconds_are_within_reason() {
        assert_eq!(seconds("30"), Ok(30.0));
        for text in ["0", "-1", "1e9", "nan", "half"] {
            assert_eq!(seconds(text), Err("expected 1 to 600 s".into()), "{text}");
        }
    }
}
